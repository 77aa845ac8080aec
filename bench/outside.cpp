// Plays the three cases of bench/peers/calculix.py with deform() on the same meshes, to compare our dents with CalculiX's.
//   crumple_outside FOLDER [--commit NAME] -o CSV
// in: bar.mesh, block.mesh and tube.mesh in FOLDER, written by `calculix.py --meshes FOLDER`. out: one row for each figure,
// with the names of bench/peers/calculix.csv. `at`: the place x in a profile of the dent, or the crush at which a force acts,
// m. Sweeps: exactly this number in each sub-step; 0: the default tolerance decides. bar    the bar of bar.h, and its closed
// form block  a box of 0.22 m, whose edges pass between two rows of nodes, pushes down by 0.04 m in a second and then
// disappears;
//        without friction (free), or with a coefficient of 100 (stuck)
// tube   a plate pushes down by 0.05 m in the same way, stuck
// The base of block and tube is anchored. Both come to rest before they are measured.
#include <algorithm>
#include <cstdio>
#include <cstring>
#include <exception>
#include <stdexcept>
#include <string>

#include "bake/make_tets.h"
#include "machine.h"
#include "reference/bar.h"

namespace {

using namespace crumple;

constexpr double tick_seconds = 1.0 / 60;
constexpr int push_ticks = 60;
constexpr float near = 1e-5f;  // m

// sweeps: exactly this number in each sub-step; 0: the default tolerance decides.
Parameters parameters_of(float yield, int sweeps) {
  Parameters out;
  if (sweeps > 0) out.iterations = uint16_t(sweeps), out.tolerance = 0;
  for (Material& material : out.region) {  // the law of bench/peers/calculix.py: hardening is linear, without end
    material.young_modulus = 15e6f;
    material.yield_strain = yield;
    material.hardening = 0.045f;
    material.hardening_strain = 1000;
    material.densification = 0;
  }
  return out;
}

// The nodes at the bottom.
std::vector<uint8_t> base(const TetMesh& mesh) {
  std::vector<uint8_t> held;
  for (const Vec3& x : mesh.node) held.push_back(x.z() < near);
  return held;
}

class Report {
 public:
  Report(const std::string& csv, const std::string& commit) : file_(std::fopen(csv.c_str(), "w"), std::fclose) {
    if (!file_) throw std::runtime_error(csv + ": cannot be written; name a folder that exists and can be written.");
    about_ = '"' + machine() + "\"," + commit;
    std::fprintf(file_.get(), "machine,commit,case,nodes,tets,nu,yield,hardening,sides,sweeps,quantity,at,value,unit,hash\n");
  }
  void begin(const char* name, const TetMesh& mesh, const Parameters& parameters, const char* sides) {
    char text[200];
    const Material& m = parameters.region[0];
    std::snprintf(text, sizeof text, "%s,%zu,%zu,%g,%g,%g,%s,%d", name, mesh.node.size(), mesh.tet.size(),
                  double(m.poisson_ratio), double(m.yield_strain), double(m.hardening), sides,
                  parameters.tolerance > 0 ? 0 : parameters.iterations);
    case_ = text;
  }
  void add(const char* quantity, double value, const char* unit, const DeformableState& body, const char* at = "") {
    std::fprintf(file_.get(), "%s,%s,%s,%s,%.5g,%s,%016llx\n", about_.c_str(), case_.c_str(), quantity, at, value, unit,
                 static_cast<unsigned long long>(hash(body)));
    if (!*at) std::fprintf(stderr, "%s: %s %.5g %s\n", case_.c_str(), quantity, value, unit);
  }
  void add(const char* quantity, double at, double value, const char* unit, const DeformableState& body) {
    char text[40];
    std::snprintf(text, sizeof text, "%.5g", at);
    add(quantity, value, unit, body, text);
  }

 private:
  std::unique_ptr<FILE, int (*)(FILE*)> file_;
  std::string about_, case_;
};

void pull(const TetMesh& bar, float yield, int sweeps, Report& report) {
  const Parameters parameters = parameters_of(yield, sweeps);
  report.begin("bar", bar, parameters, "free");
  const PulledBar pulled = pull_bar(bar, 1, parameters);
  report.add("force at 0.2 m", pulled.force, "N", pulled.body);
  report.add("residual elongation", pulled.set, "m", pulled.body);
  report.add("closed form", closed_form_set(parameters.region[0]), "m", pulled.body);
}

// Pushes down by `depth` within push_ticks and reports the force on the way. The obstacle stays on the body.
double push_down(const HeldMesh& mesh, const Parameters& parameters, double depth, Obstacle& obstacle, Scratch& scratch,
                 DeformableState& body, Report& report) {
  Motion motion;
  obstacle.velocity.z() = -depth / push_ticks / tick_seconds;
  double work = 0, last = 0;
  for (int k = 1; k <= push_ticks; ++k) {
    deform({mesh.model(), parameters, fixed_mass(), {&obstacle, 1}, tick_seconds}, scratch, body, motion);
    obstacle.pose = advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, tick_seconds);
    const double force = -body.force.z();
    report.add("force at", depth * k / push_ticks, force, "N", body);
    work += depth / push_ticks * (last + force) / 2;
    last = force;
  }
  return work / depth;
}

void indent(const TetMesh& block, float yield, const char* sides, int sweeps, Report& report) {
  constexpr float top = 0.2f, middle = 0.2f, depth = 0.04f;
  const HeldMesh mesh(block, base(block), 100);
  const Parameters parameters = parameters_of(yield, sweeps);
  report.begin("block", block, parameters, sides);
  const ScratchHandle scratch = make_scratch();
  DeformableState body = make_body(mesh.model());
  Obstacle box;
  make_box({0.11f, 0.11f, 0.1f}, box);
  box.friction = std::strcmp(sides, "stuck") == 0 ? 100 : 0;
  box.pose.position = {middle, middle, double(top) + 0.1};
  push_down(mesh, parameters, double(depth), box, *scratch, body, report);
  report.add("force at 0.04 m", -body.force.z(), "N", body);
  come_to_rest(mesh, parameters, *scratch, body);
  double highest = -1, dent = 0;
  for (size_t i = 0; i < block.node.size(); ++i) {
    const Vec3& x = block.node[i];
    if (top - x.z() > near || std::abs(x.y() - middle) > near || x.x() > middle + near) continue;
    const double rise = double(body.node[i].z() - x.z());
    report.add("released_m", double(x.x() - middle), rise, "m", body);
    highest = std::max(highest, rise);
    if (middle - x.x() < near) dent = -rise;
  }
  report.add("residual dent at the middle", dent, "m", body);
  report.add("highest point of the middle line", highest, "m", body);
}

void crush(const TetMesh& tube, float yield, int sweeps, Report& report) {
  constexpr float top = 0.4f;
  const HeldMesh mesh(tube, base(tube), 100);
  const Parameters parameters = parameters_of(yield, sweeps);
  report.begin("tube", tube, parameters, "stuck");
  const ScratchHandle scratch = make_scratch();
  DeformableState body = make_body(mesh.model());
  Obstacle plate;
  make_box({0.2f, 0.2f, 0.1f}, plate);
  plate.friction = 100;
  plate.pose.position = {0.05, 0.05, double(top) + 0.1};
  report.add("mean force over 0.05 m", push_down(mesh, parameters, 0.05, plate, *scratch, body, report), "N", body);
  come_to_rest(mesh, parameters, *scratch, body);
  double shortening = 0;
  int count = 0;
  for (size_t i = 0; i < tube.node.size(); ++i) {
    if (top - tube.node[i].z() > near) continue;
    shortening += double(top - body.node[i].z());
    ++count;
  }
  report.add("residual shortening", shortening / count, "m", body);
}

void compare(const std::filesystem::path& folder, Report& report) {
  std::vector<std::string> said;
  const auto mesh = [&](const char* name) { return import_tets(folder / name, Eigen::Affine3d::Identity(), said); };
  const TetMesh bar = mesh("bar.mesh"), block = mesh("block.mesh"), tube = mesh("tube.mesh");
  for (int sweeps : {4, 8, 16, 32, 64}) pull(bar, 0.02f, sweeps, report);
  for (float yield : {0.009f, 0.03f}) {
    for (int sweeps : {0, 40}) {
      pull(bar, yield, sweeps, report);
      for (const char* sides : {"free", "stuck"}) indent(block, yield, sides, sweeps, report);
      crush(tube, yield, sweeps, report);
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  try {
    std::string folder, csv, commit = "unknown";
    for (int i = 1; i < argc; ++i) {
      const std::string word = argv[i];
      std::string& value = word == "-o" ? csv : word == "--commit" ? commit : folder;
      if (&value == &folder)
        folder = word;
      else if (++i < argc)
        value = argv[i];
    }
    if (folder.empty() || csv.empty()) {
      std::fprintf(stderr, "usage: crumple_outside FOLDER [--commit NAME] -o CSV\n  FOLDER   of calculix.py --meshes\n");
      return 2;
    }
    Report report(csv, commit);
    compare(folder, report);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple_outside: %s\n", error.what());
    return 1;
  }
}

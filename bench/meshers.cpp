// Compares the solver on several meshes of one car:
//   crumple_meshers FIRST.car OTHER.car ...
// in: baked cars with the same surface, or nearly; out: a table in Markdown, a row for each. Crashes at 50 km/h into a wall and
// a pole of 300 mm give the time of a tick (processor time of one thread; best and median of three runs, which take turns), the
// error (RMS over nodes after 12 ticks against 300 sweeps a sub-step, as a share of the largest displacement), and the energy
// found as a share of what the car brought. Dents: RMS of the difference between the displacements of its vertices and those of
// the first car, as a share of the largest; only of cars with the same vertices. Crush: mean over the vertices of the front,
// which are within 20 mm of the nose at rest, half a second after a wall at that speed.
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "bake/load_car.h"
#include "car/car.h"
#include "rooms.h"
#include "sim/deform.h"
#include "sim/skin.h"

namespace {

using namespace crumple;

constexpr int runs = 3, ticks = 12, converged = 300;
constexpr double speeds[] = {16, 32, 48, 57};  // km/h

enum class Scene { wall, pole };

struct Played {
  std::vector<Vec3> node, vertex;  // now
  double ms = 0;                   // a tick with contact
  double energy = 0;               // found over brought
};

// sweeps: 0: as many as the default takes.
Played play(const Car& car, Scene scene, double kmh, int count, int sweeps) {
  const Model& model = car.model;
  const Mass mass{double(model.mass), model.inertia.cast<double>(), model.center_of_mass.cast<double>(), true};
  float nose = -1e9f;
  for (const Vec3& node : model.node) nose = std::max(nose, node.x());
  Obstacle obstacle;
  scene == Scene::pole ? make_capsule(0.15f, 3, obstacle) : make_box({0.5f, 5, 5}, obstacle);
  obstacle.pose.position.x() = double(nose) + (scene == Scene::pole ? 0.15 : 0.5) + 0.02;
  Parameters parameters;
  if (sweeps > 0) parameters.iterations = uint16_t(sweeps), parameters.tolerance = 0;
  DeformableState state = make_body(model);
  Motion motion;
  motion.velocity.x() = kmh / 3.6;
  const double brought = kinetic_energy(motion, mass);
  const ScratchHandle scratch = make_scratch();
  tbb::task_arena one(1);
  Played out;
  int touched = 0;
  for (int k = 0; k < count; ++k) {
    StepResult result;
    const double seconds = seconds_of(
        [&] {
          one.execute([&] { result = deform({model, parameters, mass, {&obstacle, 1}, 1.0 / 60}, *scratch, state, motion); });
        },
        thread_seconds);
    if (result.contacts == 0) continue;
    out.ms += 1e3 * seconds;
    ++touched;
  }
  out.ms /= std::max(touched, 1);
  out.energy = (kinetic_energy(motion, mass) + state.absorbed + state.stored) / brought;
  out.node = state.node;
  out.vertex.resize(model.vertex.size());
  skin(model, state, out.vertex);
  return out;
}

// In percent.
double difference(std::span<const Vec3> rest, const std::vector<Vec3>& a, const std::vector<Vec3>& b) {
  double squares = 0, largest = 0;
  for (size_t i = 0; i < rest.size(); ++i) {
    squares += double((a[i] - b[i]).squaredNorm());
    largest = std::max(largest, double((b[i] - rest[i]).norm()));
  }
  return 100 * std::sqrt(squares / double(rest.size())) / largest;
}

double front_crush(const Model& model, const std::vector<Vec3>& vertex) {
  float nose = -1e9f;
  for (const Vec3& each : model.vertex) nose = std::max(nose, each.x());
  double sum = 0;
  int count = 0;
  for (size_t v = 0; v < vertex.size(); ++v) {
    if (model.vertex[v].x() < nose - 0.02f) continue;
    sum += double(model.vertex[v].x() - vertex[v].x());
    ++count;
  }
  return sum / count;
}

struct Mesh {
  std::string name;
  std::shared_ptr<const Car> car;
  std::vector<double> ms[2] = {};
  Played crash[2] = {};
};

void print(const Mesh& row, const Mesh& first) {
  const Model& model = row.car->model;
  const bool same =
      std::equal(model.vertex.begin(), model.vertex.end(), first.car->model.vertex.begin(), first.car->model.vertex.end(),
                 [](const Vec3& a, const Vec3& b) { return (a - b).norm() < 1e-4f; });
  std::printf("| %s | %zu |", row.name.c_str(), model.node.size());
  for (int scene = 0; scene < 2; ++scene) {
    std::vector<double> ms = row.ms[scene];
    std::sort(ms.begin(), ms.end());
    std::printf(" %.2f, %.2f |", ms.front(), ms[ms.size() / 2]);
  }
  for (int scene = 0; scene < 2; ++scene) {
    const Played reference = play(*row.car, Scene(scene), 50, ticks, converged);
    std::printf(" %.2f |", difference(model.node, row.crash[scene].node, reference.node));
  }
  for (int scene = 0; scene < 2; ++scene) {
    if (&row == &first || !same)
      std::printf(" |");
    else
      std::printf(" %.1f |", difference(model.vertex, row.crash[scene].vertex, first.crash[scene].vertex));
  }
  double least = 1e9, most = 0;
  std::string crush;
  for (double speed : speeds) {
    const Played played = play(*row.car, Scene::wall, speed, 30, 0);
    least = std::min(least, played.energy);
    most = std::max(most, played.energy);
    char text[32];
    std::snprintf(text, sizeof text, " %.0f |", 1e3 * front_crush(model, played.vertex));
    crush += text;
  }
  std::printf(" %.3f-%.3f |%s\n", least, most, crush.c_str());
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) try {
  std::vector<Mesh> rows;
  for (int i = 1; i < argc; ++i) {
    Mesh& row = rows.emplace_back();
    row.name = std::filesystem::path(argv[i]).stem().string();
    row.car = load_car(argv[i]);
  }
  if (rows.empty()) throw std::runtime_error("name baked cars; the head of bench/meshers.cpp explains the table");
  for (int run = 0; run < runs; ++run)
    for (Mesh& row : rows)
      for (int scene = 0; scene < 2; ++scene) {
        row.crash[scene] = play(*row.car, Scene(scene), 50, ticks, 0);
        row.ms[scene].push_back(row.crash[scene].ms);
      }
  std::printf(
      "| mesh | nodes | ms a tick, wall: best, median | pole | error, wall, %% | pole | dents beside the first's, wall, %% | "
      "pole | "
      "energy | crush at 16 km/h, mm | 32 | 48 | 57 |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|\n");
  for (const Mesh& row : rows) print(row, rows.front());
} catch (const std::exception& refused) {
  std::fprintf(stderr, "crumple_meshers: %s\n", refused.what());
  return 1;
}

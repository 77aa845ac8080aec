// The stability matrix: plays every hostile start with every method, and reports the state of the car at the end.
//   crumple_stability CAR [--quick] [--seed N] [--only TEXT] -o CSV
// in: a baked car (1,000 nodes are enough). out: one row for each method and start: the outcome, the share of inverted tets,
// the rms distance of the nodes from their goal in % of the car's diagonal, the hash of the body, the number of ticks, and how
// many ticks deform() undid. Baselines play a tenth of the random scenes. The same car and seed give the same rows on any
// number of threads. In a start named "elastic" there is no plasticity, so the car must return to rest. A start named "plastic"
// has the default material: a wall dents the car first, then nodes are displaced, and the car must return to that dent. If the
// scene itself dents the car, the car must stay finite and without inverted tets, and no farther from rest than the obstacle
// can have pushed it. Outcomes: recovered; wrong rest; inverted (tets); passed (an obstacle went through the car); exploded (a
// node is 10 m or more from rest); not finite (at the end, or deform() undid a tick because of it).
#include <tbb/parallel_for.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <cstdio>
#include <stdexcept>

#include "bake/build_constraints.h"
#include "bake/load_car.h"
#include "hostile.h"

namespace {

using namespace crumple;

constexpr double recovered_share = 1e-3;  // rms shape error over the diagonal: 5 mm on a car

struct Outcome {
  const char* what;
  double inverted, error;  // %
  uint64_t hash;
  int ticks, undone;
};

Outcome judge(const Run& run) {
  Outcome out{"recovered", 0, 0, hash(run.body), run.ticks, run.undone};
  size_t inverted = 0;
  for (const Tet& tet : run.model.tet) {
    const auto at = [&](int k) -> const Vec3& { return run.body.node[tet.node[k]]; };
    inverted += !(tet_volume(at(0), at(1), at(2), at(3)) > 0);
  }
  double squares = 0;
  for (size_t i = 0; i < run.goal.size(); ++i) squares += (run.body.node[i] - run.goal[i]).cast<double>().squaredNorm();
  const double rms = std::sqrt(squares / double(run.goal.size())), diagonal = double(run.box.size().norm());
  out.inverted = 100 * double(inverted) / double(run.model.tet.size());
  out.error = 100 * rms / diagonal;
  if (!finite(run.body)) out.inverted = out.error = std::numeric_limits<double>::quiet_NaN();  // one text for every NaN
  if (!finite(run.body) || (run.undone > 0 && !run.poisoned))
    out.what = "not finite";
  else if (run.exploded || !(run.farthest() <= exploded_distance))
    out.what = "exploded";
  else if (run.passed)
    out.what = "passed";
  else if (inverted > 0)
    out.what = "inverted";
  else if (!(rms <= (run.limit > 0 ? run.limit : recovered_share * diagonal)))
    out.what = "wrong rest";
  return out;
}

struct Options {
  std::string car, csv, only;
  bool quick = false;
  uint64_t seed = 1;
};

void write_matrix(const Options& options) {
  const auto car = load_car(options.car);
  std::vector<std::pair<const Method*, Scene>> cells;
  for (const Scene& scene : hostile_scenes(*car, options.seed, options.quick)) {
    for (const Method& method : methods) {
      if (scene.ours && method.baseline) continue;
      if ((std::string(method.name) + ": " + scene.name).find(options.only) != std::string::npos)
        cells.push_back({&method, scene});
    }
  }
  if (cells.empty()) throw std::runtime_error("no cell \"METHOD: START\" contains \"" + options.only + "\"; see a whole CSV.");
  std::vector<Outcome> outcomes(cells.size());
  std::atomic<size_t> done = 0;
  tbb::parallel_for(size_t(0), cells.size(), [&](size_t i) {
    const auto& [method, scene] = cells[i];
    Run run(scene.car ? scene.car : car, *method, scene.parameters, options.seed);
    scene.play(run);
    outcomes[i] = judge(run);
    std::fprintf(stderr, "%4zu of %zu  %s: %s: %s, inverted %.2f %%, shape error %.3f %%\n", ++done, cells.size(), method->name,
                 scene.name.c_str(), outcomes[i].what, outcomes[i].inverted, outcomes[i].error);
  });
  const std::unique_ptr<FILE, int (*)(FILE*)> file(std::fopen(options.csv.c_str(), "w"), std::fclose);
  if (!file) throw std::runtime_error(options.csv + ": cannot be written; name a folder that exists and can be written.");
  std::fprintf(file.get(), "method,start,outcome,inverted_percent,shape_error_percent,hash,ticks,undone\n");
  for (size_t i = 0; i < cells.size(); ++i) {
    const Outcome& o = outcomes[i];
    std::fprintf(file.get(), "%s,\"%s\",%s,%.4g,%.4g,%016llx,%d,%d\n", cells[i].first->name, cells[i].second.name.c_str(),
                 o.what, o.inverted, o.error, static_cast<unsigned long long>(o.hash), o.ticks, o.undone);
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("The stability matrix: every method against every hostile start");
  Options options;
  app.add_option("CAR", options.car, "baked; 1,000 nodes are plenty")->required()->check(CLI::ExistingFile);
  app.add_flag("--quick", options.quick,
               "20 random scenes and 1,000 ticks of rubbing instead of 1,000 and 1,000,000 (baselines: 100 and 10,000)");
  app.add_option("--seed", options.seed, "of all that is random")->capture_default_str();
  app.add_option("--only", options.only, "cells whose \"METHOD: START\" contains this");
  app.add_option("-o", options.csv, "CSV")->required();
  CLI11_PARSE(app, argc, argv);
  try {
    write_matrix(options);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple_stability: %s\n", error.what());
    return 1;
  }
}

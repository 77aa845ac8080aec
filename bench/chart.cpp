// Measures the time of every method, and its distance from its own converged result, in one run:
//   crumple_chart CAR... [--quick] [--commit NAME] -o CSV
// in: baked cars. All methods run on the first car, and only `nodal` runs on the others. out: one row for each method, number
// of iterations, car and scene, in the order of measurement.
// Scenes: "wall" and "pole" (0.15 m radius), hit at 50 km/h, for twelve ticks of 1/60 s. "head-on": the car meets its like,
// both at 50 km/h; the error is that of the first one, the time that of both. Error: the distance of the surface's vertices at
// the end from the result of the same method with many iterations, in % of the largest displacement in that result; rms and
// largest. Time: the mean of the ticks in which the obstacle touches the car; best and median of several plays. All plays must
// end with the same bits. Path: `nodal` slows the car down as in any crash. The other methods have no reaction, so they follow
// the poses that the converged `nodal` car has at the ticks. For comparison `nodal` also runs on this path, and at the wall on
// more threads. Further scenes: "elastic push" (a wall moves 0.20 m into the nose in twelve ticks and nothing flows, as in
// bench/peers); "side by side" (two cars on two threads, compared with one car); "untouched" (a car at rest with nothing near);
// "push in N ticks" (a wall moves in by 0.40 m in N ticks and back; the error is against 40 ticks); "kernel ..." (the method is
// the instruction set; the time of one pass over all tets). Nothing here is random: the seed is 0.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <functional>
#include <limits>
#include <optional>
#include <stdexcept>
#include <thread>

#include "bake/load_car.h"
#include "car/car.h"
#include "machine.h"
#include "reference/baselines.h"
#include "reference/pile_up.h"
#include "rooms.h"
#include "sim/deform.h"
#include "sim/scratch.h"
#include "sim/skin.h"

namespace {

using namespace crumple;

constexpr double tick_seconds = 1.0 / 60, speed = 50 / 3.6, gap = 0.02;  // s, m/s, m
constexpr int ticks = 12, push_ticks = 40;
constexpr int by_default = 0;  // iterations: until the default tolerance is reached
const int default_substeps = Parameters().substeps;
constexpr double push_depth = 0.40, elastic_depth = 0.20;  // m
constexpr char elastic_push[] = "elastic push", head_on[] = "head-on";
constexpr size_t small_car = 12'000;  // nodes: larger cars get only some measurements, with --quick without errors
constexpr double patience = 4;        // s: plays are repeated for at most this long
const double nan_value = std::numeric_limits<double>::quiet_NaN();

struct Method {
  std::string name;
  std::optional<Baseline> baseline;  // empty: deform()
  Solver solver = Solver::nodal;
  bool on_path = false;
  std::vector<int> iterations;
  int converged = 0;                // iterations of the converged result
  int substeps = default_substeps;  // a tick
  int threads = 1;                  // 1: times are processor time; more: wall time
};

// The pose of the frame at the start of each tick and at the end, and whether the obstacle touched the car in each tick.
struct Path {
  std::vector<Pose> pose;
  std::vector<char> touched;
};

struct Play {
  std::vector<Vec3> vertex;
  Path path;
  double seconds = 0;  // of the counted ticks, and their number
  int counted = 0;
  double energy = nan_value, crush = nan_value;  // energy: at the end over at the start; crush: residual, m
  uint64_t bits = 0;
  double milliseconds() const { return 1e3 * seconds / std::max(1, counted); }
};

struct Error {
  double rms = nan_value, most = nan_value;  // %
};

Mass mass_of(const Model& model, bool law) {
  Mass mass{double(model.mass), model.inertia.cast<double>(), model.center_of_mass.cast<double>(), true};
  if (law) mass.mass = std::numeric_limits<double>::infinity(), mass.inertia.setConstant(mass.mass);
  return mass;
}

float nose_of(const Model& model) {
  float nose = model.node[0].x();
  for (const Vec3& node : model.node) nose = std::max(nose, node.x());
  return nose;
}

// The mean over the nodes that were foremost.
double crush_of(const Model& model, const DeformableState& body) {
  const float nose = nose_of(model);
  double sum = 0;
  int count = 0;
  for (size_t i = 0; i < body.node.size(); ++i) {
    if (model.node[i].x() < nose - 0.02f) continue;
    sum += double(model.node[i].x() - body.node[i].x());
    ++count;
  }
  return sum / count;
}

Obstacle obstacle_of(const std::string& scene, const Model& model) {
  Obstacle out;
  const bool pushes = scene == elastic_push;
  const bool pole = scene == "pole";
  if (pole)
    make_capsule(0.15f, 3, out);
  else
    make_box({0.5f, 5, 5}, out);
  out.pose.position.x() = double(nose_of(model)) + (pole ? 0.15 : 0.5) + (pushes ? 0 : gap);
  if (pushes) out.velocity.x() = -elastic_depth / ticks / tick_seconds;
  return out;
}

std::vector<Vec3> surface_of(const Model& model, const DeformableState& body) {
  std::vector<Vec3> out(model.vertex.size());
  skin(model, body, out);
  return out;
}

// The steady motion from one pose to the other within a tick.
Motion between(const Pose& from, const Pose& to, const Mass& mass) {
  const Eigen::AngleAxisd turn(to.orientation * from.orientation.conjugate());
  const Eigen::Vector3d way = to.position + to.orientation * mass.center - from.position - from.orientation * mass.center;
  return {from, way / tick_seconds, turn.angle() / tick_seconds * turn.axis()};
}

struct Crash {
  std::shared_ptr<const Car> car;
  std::string scene;
  Structure structure;
  Path path;  // the path of the converged `nodal` car
};

// The car meets its like.
Play play_pair(const Crash& crash, const Method& method, int iterations) {
  const Model& model = crash.car->model;
  const double nose = double(nose_of(model) - model.center_of_mass.x()) + gap;
  PileUp cars;
  cars.add(crash.car, -nose, 0, 0, speed);
  cars.add(crash.car, nose, 0, 3.14159265358979, speed);
  for (CrashCar& car : cars.cars) {
    if (iterations != by_default) car.parameters.iterations = uint16_t(iterations), car.parameters.tolerance = 0;
    car.parameters.substeps = uint16_t(method.substeps);
  }
  tbb::task_arena arena(method.threads);
  const double brought = cars.energy();
  const CrashCar& first = cars.cars.front();
  Play out;
  for (int k = 0; k < ticks; ++k) {
    const double seconds = seconds_of([&] { arena.execute([&] { cars.tick(tick_seconds); }); },
                                      method.threads == 1 ? thread_seconds : wall_seconds);
    if (first.last.contacts == 0) continue;
    out.seconds += seconds;
    ++out.counted;
  }
  out.vertex = surface_of(model, first.body);
  out.crush = crush_of(model, first.body);
  out.bits = hash(first.body);
  out.energy = cars.energy() / brought;
  return out;
}

Play play(const Crash& crash, const Method& method, int iterations) {
  if (crash.scene == head_on) return play_pair(crash, method, iterations);
  const Model& model = crash.car->model;
  const bool pushed = crash.scene == elastic_push, law = method.on_path || pushed;
  const Mass mass = mass_of(model, law);
  Obstacle obstacle = obstacle_of(crash.scene, model);
  Parameters parameters;
  parameters.solver = method.solver;
  if (iterations != by_default) parameters.iterations = uint16_t(iterations), parameters.tolerance = 0;
  parameters.substeps = uint16_t(method.substeps);
  for (Material& material : parameters.region) {
    if (pushed) material.plastic_limit = 0, material.plasticity = 1;
  }
  DeformableState body = make_body(model);
  Motion motion;
  motion.velocity.x() = pushed ? 0 : speed;
  const double brought = kinetic_energy(motion, mass);
  const ScratchHandle scratch = make_scratch();
  tbb::task_arena arena(method.threads);
  bool failed = false;
  Play out;
  for (int k = 0; k < ticks; ++k) {
    if (method.on_path) motion = between(crash.path.pose[k], crash.path.pose[k + 1], mass);
    out.path.pose.push_back(motion.pose);
    uint32_t contacts = 0;
    const auto tick = [&] {
      if (method.baseline) {
        deform_baseline(*method.baseline, model, crash.structure, parameters, mass, {&obstacle, 1}, tick_seconds, body, motion);
        return;
      }
      const StepResult result = deform({model, parameters, mass, {&obstacle, 1}, tick_seconds}, *scratch, body, motion);
      contacts = result.contacts;
      failed = failed || result.recovered;
    };
    const double seconds = seconds_of([&] { arena.execute(tick); }, method.threads == 1 ? thread_seconds : wall_seconds);
    obstacle.pose = advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, tick_seconds);
    out.path.touched.push_back(contacts > 0);
    if (crash.path.touched.empty() ? contacts == 0 : !crash.path.touched[k]) continue;
    out.seconds += seconds;
    ++out.counted;
  }
  out.path.pose.push_back(motion.pose);
  out.vertex = surface_of(model, body);
  if (failed) out.vertex[0].setConstant(std::numeric_limits<float>::quiet_NaN());
  if (crash.scene == "wall") out.crush = crush_of(model, body);
  out.bits = hash(body);
  if (!law) out.energy = (kinetic_energy(motion, mass) + body.absorbed + body.stored) / brought;
  return out;
}

Error error_of(const Model& model, const std::vector<Vec3>& vertex, const std::vector<Vec3>& answer) {
  double squares = 0, most = 0, scale = 0;
  for (size_t v = 0; v < vertex.size(); ++v) {
    const double apart = double((vertex[v] - answer[v]).norm());
    if (!std::isfinite(apart)) return {};
    squares += apart * apart;
    most = std::max(most, apart);
    scale = std::max(scale, double((answer[v] - model.vertex[v]).norm()));
  }
  return {100 * std::sqrt(squares / double(vertex.size())) / scale, 100 * most / scale};
}

struct Options {
  std::vector<std::string> cars;
  std::string csv, commit = "unknown";
  bool quick = false;
};

struct Row {
  std::string scene, method;
  int iterations, threads;
  Error error;
  double best = nan_value, median = nan_value, energy = nan_value, crush = nan_value;
  uint64_t bits = 0;
};

// The table being written. A value that was not measured is an empty field.
class Table {
 public:
  explicit Table(const Options& options) : file_(std::fopen(options.csv.c_str(), "w"), std::fclose) {
    if (!file_) throw std::runtime_error(options.csv + ": cannot be written; name a folder that exists and can be written.");
    about_ = '"' + machine() + "\"," + options.commit + ",0";
    std::fprintf(file_.get(),
                 "machine,commit,seed,scene,car,nodes,tets,method,iterations,threads,error_percent,max_percent,ms_best,"
                 "ms_median,energy_ratio,crush_mm,hash\n");
  }
  void add(const std::string& name, const Model& model, const Row& row) {
    std::fprintf(file_.get(), "%s,%s,%s,%zu,%zu,\"%s\",%d,%d", about_.c_str(), row.scene.c_str(), name.c_str(),
                 model.node.size(), model.tet.size(), row.method.c_str(), row.iterations, row.threads);
    for (double value : {row.error.rms, row.error.most, row.best, row.median, row.energy, 1e3 * row.crush}) {
      std::fprintf(file_.get(), std::isfinite(value) ? ",%.5g" : ",", value);
    }
    std::fprintf(file_.get(), ",%016llx\n", static_cast<unsigned long long>(row.bits));
    std::fflush(file_.get());
    std::fprintf(stderr, "%s, %s: %s, %d: error %.3g %%, %.4g ms\n", name.c_str(), row.scene.c_str(), row.method.c_str(),
                 row.iterations, row.error.rms, row.best);
  }

 private:
  std::unique_ptr<FILE, int (*)(FILE*)> file_;
  std::string about_;
};

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const size_t half = values.size() / 2;
  return values.size() % 2 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

// Fills in the times of all runs.
void take(std::vector<double> milliseconds, Row& row) {
  row.best = *std::min_element(milliseconds.begin(), milliseconds.end());
  row.median = median(std::move(milliseconds));
}

void measure_method(const std::string& name, const Crash& crash, const Method& method, const Options& options,
                    const std::vector<Vec3>* answer, Table& table) {
  for (int iterations : method.iterations) {
    std::vector<double> milliseconds;
    Play first;
    const double start = thread_seconds();
    for (int k = 0; k < (options.quick ? 3 : 5) && (k < 1 || thread_seconds() - start < patience); ++k) {
      Play again = play(crash, method, iterations);
      milliseconds.push_back(again.milliseconds());
      if (k == 0)
        first = std::move(again);
      else if (again.bits != first.bits)
        throw std::runtime_error(name + ", " + crash.scene + ", " + method.name + ": two plays ended with other bits.");
    }
    Row row{crash.scene, method.name, iterations,   method.threads, {},
            nan_value,   nan_value,   first.energy, first.crush,    first.bits};
    if (answer) row.error = error_of(crash.car->model, first.vertex, *answer);
    take(std::move(milliseconds), row);
    table.add(name, crash.car->model, row);
  }
}

// All methods that the chart compares in a scene. `nodal` is first, because the others follow its path. Methods that never come
// within 1 % at the wall run in no other scene, except `xpbd` in the push, because other engines there use XPBD too.
std::vector<Method> methods(const std::string& scene, bool quick) {
  const std::vector<int> sweeps = {by_default, 1, 2, 4, 6, 8, 10, 12, 16, 24, 48};
  const std::vector<int> further = quick ? std::vector{1, 5, 20, 100} : std::vector{1, 2, 5, 10, 20, 50, 100, 200};
  const std::vector<int> slow = quick ? std::vector{1, 5, 20} : std::vector{1, 2, 5, 10, 20, 50};
  const int answer = quick ? 400 : 1000, slow_answer = quick ? 100 : 400;
  std::vector<Method> out = {{"nodal", {}, Solver::nodal, false, sweeps, 400},
                             {"nodal, path given", {}, Solver::nodal, true, sweeps, 400},
                             {"classic", {}, Solver::classic, true, further, answer}};
  if (scene != "pole") out.push_back({"xpbd", Baseline::xpbd, Solver::nodal, true, slow, slow_answer});
  if (quick || scene != "wall") return out;
  for (const auto& [name, baseline] : {std::pair{"coloured", Baseline::coloured},
                                       {"averaged jacobi", Baseline::averaged_jacobi},
                                       {"relaxed jacobi", Baseline::relaxed_jacobi},
                                       {"naive jacobi", Baseline::naive_jacobi}}) {
    out.push_back({name, baseline, Solver::nodal, true, further, answer});
  }
  return out;
}

// Measures the error of the time steps in addition to the solver's error, against twice the largest number of sub-steps here.
void measure_substeps(const std::string& name, const Crash& crash, const Options& options, Table& table) {
  const auto method = [](int substeps) {
    return Method{
        "nodal, " + std::to_string(substeps) + " sub-steps a tick", {}, Solver::nodal, false, {by_default}, 0, substeps};
  };
  const Play answer = play(crash, method(8 * default_substeps), 24);
  for (int substeps : {4, 8, 16, 32}) measure_method(name, crash, method(substeps), options, &answer.vertex, table);
}

void measure_threads(const std::string& name, const Crash& crash, const Options& options, Table& table) {
  for (int threads = 2; threads <= int(std::thread::hardware_concurrency()) && threads <= 8; threads *= 2) {
    const Method method{"nodal", {}, Solver::nodal, false, {by_default, 10, 24}, 0, default_substeps, threads};
    measure_method(name, crash, method, options, nullptr, table);
  }
}

// Measures the best gain that two threads can have on this machine: two cars on a thread each, which share nothing, against one
// car; ms for each car and crash.
void measure_side_by_side(const std::string& name, const Crash& crash, Table& table) {
  const Method method{"nodal", {}, Solver::nodal, false, {by_default}, 0, default_substeps};
  std::vector<double> milliseconds[2];
  Row row{"side by side", "nodal", by_default, 1, {}};
  for (int round = 0; round < 3; ++round) {
    for (size_t cars : {1, 2}) {
      milliseconds[cars - 1].push_back(1e3 / double(cars) * seconds_of([&] {
                                         std::vector<std::thread> threads;
                                         for (size_t k = 1; k < cars; ++k)
                                           threads.emplace_back([&] { play(crash, method, by_default); });
                                         row.bits = play(crash, method, by_default).bits;
                                         for (std::thread& thread : threads) thread.join();
                                       }));
    }
  }
  for (int cars : {1, 2}) {
    row.threads = cars;
    take(milliseconds[cars - 1], row);
    table.add(name, crash.car->model, row);
  }
}

void measure_crash(const std::string& name, const std::shared_ptr<const Car>& car, const std::string& scene, bool first,
                   const Options& options, Table& table) {
  const bool large = car->model.node.size() > small_car;
  const bool all = first && (scene == "wall" || !options.quick) && scene != head_on;
  if (large && options.quick && scene != "wall") return;
  Crash crash{car, scene, {}, {}};
  if (all) crash.structure = build_structure(car->model);
  for (Method method : methods(scene, options.quick)) {
    if (!all && method.name != "nodal") break;
    if (scene == elastic_push && method.on_path && method.name.starts_with("nodal")) continue;  // there is no path
    if (large) method.iterations = {by_default, 10, 24}, method.converged = 100;
    std::optional<Play> answer;
    if (!large || !options.quick) answer = play(crash, method, method.converged);
    if (answer && crash.path.pose.empty()) crash.path = answer->path;
    measure_method(name, crash, method, options, answer ? &answer->vertex : nullptr, table);
  }
  if (!large && scene == "wall") measure_substeps(name, crash, options, table);
  if (scene == "wall") measure_threads(name, crash, options, table);
  if (scene == "wall" && first) measure_side_by_side(name, crash, table);
}

void measure_untouched(const std::string& name, const Model& model, Table& table) {
  DeformableState body = make_body(model);
  Motion motion;
  const ScratchHandle scratch = make_scratch();
  constexpr int calls = 1000;
  std::vector<double> milliseconds;
  for (int k = 0; k < 5; ++k) {
    const double start = thread_seconds();
    for (int call = 0; call < calls; ++call)
      deform({model, {}, mass_of(model, false), {}, tick_seconds}, *scratch, body, motion);
    milliseconds.push_back(1e3 * (thread_seconds() - start) / calls);
  }
  Row row{"untouched", "nodal", by_default, 1, {}};
  row.bits = hash(body);
  take(std::move(milliseconds), row);
  table.add(name, model, row);
}

void measure_push(const std::string& name, const Model& model, Table& table) {
  std::vector<Vec3> answer;
  for (int count : {push_ticks, 1}) {
    DeformableState body = make_body(model);
    Motion motion;
    const ScratchHandle scratch = make_scratch();
    Obstacle wall = obstacle_of("wall", model);
    wall.pose.position.x() -= gap;
    const auto run = [&](double velocity, int most) {
      wall.velocity.x() = velocity;
      for (int k = 0; k < most && !(k > 3 && body.settled); ++k) {
        deform({model, {}, mass_of(model, true), {&wall, 1}, tick_seconds}, *scratch, body, motion);
        wall.pose = advance(wall.pose, wall.velocity, wall.angular_velocity, tick_seconds);
      }
    };
    run(-push_depth / count / tick_seconds, count);
    run(1.2, 70);
    Row row{"push in " + std::to_string(count) + (count == 1 ? " tick" : " ticks"), "nodal", by_default, 1, {}};
    const std::vector<Vec3> vertex = surface_of(model, body);
    if (answer.empty()) answer = vertex;
    row.error = error_of(model, vertex, answer);
    row.crush = crush_of(model, body);
    row.bits = hash(body);
    table.add(name, model, row);
  }
}

// Measures one pass of each kernel over a car that has been driven into the wall for two ticks.
void measure_kernels(const std::string& name, const Model& model, Table& table) {
  DeformableState body = make_body(model);
  Motion motion;
  motion.velocity.x() = speed;
  const ScratchHandle scratch = make_scratch();
  NodalSolver& s = scratch->solver;
  const Obstacle wall = obstacle_of("wall", model);
  Parameters all;
  all.tolerance = 0;  // solves the whole car
  for (int k = 0; k < 2; ++k) deform({model, all, mass_of(model, false), {&wall, 1}, tick_seconds}, *scratch, body, motion);
  const SweepOrder& order = *model.order;
  const uint32_t groups = uint32_t(order.group.size());
  for (size_t i = 0; i < s.direction.size(); ++i) s.direction[i] = {i % 2 ? 1e-3f : 0, 1e-3f, 2e-3f, 0};
  const auto positions = s.node;
  const auto tets = s.tets;
  const auto flowing = s.flowing;
  wake_all(model, {}, s.active);
  pack(model, {}, s.weights, s.active);
  const Blocks& blocks = s.active.blocks;
  const auto nobody = [](void*, uint32_t, const float*, const float*) {};
  const NodeView nodes{.node = s.node.data(),
                       .before = s.before.data(),
                       .rest = s.rest.data(),
                       .stiffness = s.stiffness.data(),
                       .index = blocks.node.data(),
                       .row = blocks.row.data(),
                       .anchored = blocks.anchored.data(),
                       .rows = blocks.rows.data(),
                       .weights = blocks.weights.data(),
                       .still = s.active.still.data(),
                       .touched = s.active.touched.data(),
                       .relaxation = relaxation,
                       .measure = false,
                       .resolve = nobody,
                       .context = nullptr};
  const TetView view{s.node.data(), order.group.data(), s.tets.data(), s.region.data(), s.law.data(), s.active.stirred.data()};
  std::vector<uint16_t> every(groups, 0xffff);
  kernels().update_secant_moduli(view, 0, groups, s.stiffness.data(), every.data());
  for (const char* instructions : {"avx512", "avx2", "portable"}) {
    const Kernels* kernel = kernels(instructions);
    if (!kernel) continue;
    const auto add = [&](const char* what, const std::function<void()>& pass) {
      std::vector<double> milliseconds;
      for (int k = 0; k < 30; ++k) {
        s.node = positions;
        s.tets = tets;
        s.flowing = flowing;
        const double start = thread_seconds();
        pass();
        milliseconds.push_back(1e3 * (thread_seconds() - start));
      }
      Row row{std::string("kernel ") + what, instructions, 1, 1, {}};
      take(std::move(milliseconds), row);
      table.add(name, model, row);
    };
    add("sweep", [&] {
      for (size_t c = 0; c + 1 < blocks.colour.size(); ++c) kernel->relax_nodes(nodes, blocks.colour[c], blocks.colour[c + 1]);
    });
    add("renew", [&] { kernel->update_secant_moduli(view, 0, groups, s.stiffness.data(), s.flowing.data()); });
    add("slope", [&] {
      double derivative[6] = {};
      kernel->line_derivative(view, 0, groups, s.stiffness.data(), s.direction.data(), derivative);
    });
    add("flow", [&] { kernel->flow(view, s.tets.data(), 0, groups, s.flowing.data()); });
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Error against time, of every method that is here");
  Options options;
  app.add_option("CAR", options.cars, "baked; all methods on the first, `nodal` on all")->required()->check(CLI::ExistingFile);
  app.add_flag("--quick", options.quick, "fewer iteration counts, no converged answer for large cars");
  app.add_option("--commit", options.commit, "named in every row");
  app.add_option("-o", options.csv, "CSV")->required();
  CLI11_PARSE(app, argc, argv);
  try {
    Table table(options);
    tbb::task_arena(1).execute([&] {
      for (const std::string& file : options.cars) {
        const auto car = load_car(file);
        const std::string name = std::filesystem::path(file).stem().string();
        for (const char* scene : {"wall", "pole", elastic_push, head_on})
          measure_crash(name, car, scene, file == options.cars[0], options, table);
        measure_untouched(name, car->model, table);
        if (car->model.node.size() <= small_car) measure_push(name, car->model, table);
        measure_kernels(name, car->model, table);
      }
    });
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple_chart: %s\n", error.what());
    return 1;
  }
}

// Measures how many cars one tick of 1/60 s can compute, and how much accuracy each way to compute more of them costs:
//   crumple_scene CAR... [--threads N] [--commit NAME] -o CSV
// in: baked cars of one surface, the levels of one car. out: one row for each scene, level, number of sweeps and budget.
// Scenes with the server's whole tick (World), cars side by side before one wall:
//   asleep     many cars at rest, the wall out of reach
//   tapped     cars reach the wall at 1.5 m/s
//   crashing   cars reach the wall at 50 km/h. Both scenes run with default parameters, with a fixed number of sweeps, and with
//              fewer sub-steps
//   overload   crashing; every other car has importance 0.1, and the budget is a share of the work that the cars ask for
// Time: wall time of a tick per solved car, best of several plays. Error: the distance of the surface at the end from the
// result of the finest level with 100 sweeps, rms and largest over its vertices; in m, and rms in % of the largest displacement
// and of the car's diagonal. Work: tet visits per car and tick. Further scenes:
//   all awake  one car is tapped, with one sub-step in a tick: as usual, and with all nodes kept awake. The difference is the
//   gain
//              from the active set.
//   switch     the finest level, crashed into a pole, switches to a coarser level and back. Measures how far its surface jumps.
//              "settled" is how far the surface creeps when the car is woken afterwards.
// Nothing here is random: the seed is 0.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <stdexcept>

#include "bake/load_car.h"
#include "car/map_level.h"
#include "machine.h"
#include "rooms.h"
#include "sim/nodal.h"
#include "sim/rest.h"
#include "sim/skin.h"
#include "tick/hash.h"
#include "tick/levels.h"
#include "tick/state.h"

namespace {

using namespace crumple;

constexpr double rate = 60, tap = 1.5, crash = 50 / 3.6, gap = 0.02;  // 1/s, m/s, m
constexpr int exact_sweeps = 100;
constexpr int ticks = 60;  // in a play; the cars are at rest at its end
constexpr size_t cars_hit = 8, cars_asleep = 200;
constexpr double lane = 4;  // m from car to car
constexpr float unimportant = 0.1f;
constexpr int repetitions = 3;

using Cars = std::vector<std::shared_ptr<const Car>>;  // finest first

Mass mass_of(const Model& model) {
  return {double(model.mass), model.inertia.cast<double>(), model.center_of_mass.cast<double>(), true};
}

double front_of(const Model& model) {
  double front = -1e9;
  for (const Vec3& node : model.node) front = std::max(front, double(node.x()));
  return front;
}

std::vector<Vec3> surface_of(const Model& model, const DeformableState& body) {
  std::vector<Vec3> vertex(model.vertex.size());
  skin(model, body, vertex);
  return vertex;
}

// The distance of two surfaces, m.
struct Error {
  double rms = 0, most = 0;
};
Error compare(const std::vector<Vec3>& a, const std::vector<Vec3>& b) {
  Error error;
  for (size_t v = 0; v < a.size(); ++v) {
    const double squared = double((a[v] - b[v]).squaredNorm());
    error.rms += squared / double(a.size());
    error.most = std::max(error.most, std::sqrt(squared));
  }
  error.rms = std::sqrt(error.rms);
  return error;
}

struct Scene {
  const char* name;
  double speed;           // m/s
  double distance = gap;  // m, from the noses to the wall
  size_t cars = cars_hit;
  int sweeps = Parameters{}.iterations;
  float tolerance = Parameters{}.tolerance;  // m
  uint64_t budget = 0;                       // tet visits a tick
  bool some_unimportant = false;             // every other car
  int substeps = Parameters{}.substeps;      // in 1/60 s
};

struct Play {
  double seconds = 0;            // a car and tick
  double work = 0;               // tet visits a car and tick
  double most_work = 0;          // of all cars in one tick
  double shed = 0;               // share of the requested work that was left out
  std::vector<Vec3> surface[2];  // of the first and the second car at the end
  uint64_t bits = 0;
};

WorldHandle make_scene(const std::shared_ptr<const Car>& asset, const Scene& scene) {
  WorldHandle world = make_world(rate, 0.0005f);
  add_asset(*world, asset);
  world->budget = scene.budget;
  world->hosts["bench"].cars = uint32_t(scene.cars);
  for (size_t k = 0; k < scene.cars; ++k) {
    Instance& car = world->cars[std::to_string(1000 + k)];  // in this order
    car.levels = &world->assets.at(asset->hash);
    car.car = asset;
    car.host = "bench";
    car.mass = mass_of(asset->model);
    car.body = make_body(asset->model);
    car.parameters.iterations = uint16_t(scene.sweeps);
    car.parameters.tolerance = scene.tolerance;
    car.parameters.substeps = uint16_t(scene.substeps);
    car.motion.pose.position.y() = lane * double(k);
    car.motion.velocity.x() = scene.speed;
    if (scene.some_unimportant && k % 2 == 1) car.importance = unimportant;
  }
  const double width = lane * double(scene.cars);
  Obstacle wall;
  make_box({0.5f, float(width), 5}, wall);
  wall.pose.position = {front_of(asset->model) + 0.5 + scene.distance, 0.5 * width, 0};
  world->obstacles.push_back(wall);
  world->hosts["bench"].obstacles = 1;
  return world;
}

Play play_once(const std::shared_ptr<const Car>& asset, const Scene& scene, int threads) {
  const WorldHandle world = make_scene(asset, scene);
  Outbox outbox;
  Play play;
  tick(*world, {}, outbox, threads);  // keyframes
  double solved = 0, asked = 0, shed = 0;
  for (int k = 1; k < ticks; ++k) {
    Work done;
    const double seconds = seconds_of([&] { done = tick(*world, {}, outbox, threads).work; });
    size_t hit = 0;
    for (const auto& [id, car] : world->cars) hit += scene.speed == 0 || car.touched_tick == world->tick;
    if (hit == 0) continue;
    solved += double(hit);
    play.seconds += seconds;
    play.work += double(done.done);
    play.most_work = std::max(play.most_work, double(done.done));
    shed += double(done.shed);
    asked += double(done.done + done.shed);
  }
  play.seconds /= solved;
  play.work /= solved;
  play.shed = asked > 0 ? shed / asked : 0;
  auto car = world->cars.begin();
  for (size_t k = 0; k < std::min<size_t>(2, scene.cars); ++k, ++car) {
    play.surface[k] = surface_of(asset->model, car->second.body);
  }
  play.bits = hash(*world);
  return play;
}

// Returns the best of several plays. All plays end with the same bits.
Play play(const std::shared_ptr<const Car>& asset, const Scene& scene, int threads) {
  Play best = play_once(asset, scene, threads);
  for (int k = 1; k < repetitions; ++k) {
    Play again = play_once(asset, scene, threads);
    if (again.bits != best.bits) throw std::runtime_error(std::string(scene.name) + ": two plays end with other bits");
    if (again.seconds < best.seconds) best = std::move(again);
  }
  return best;
}

struct Options {
  std::vector<std::string> cars;
  std::string csv, commit = "unknown";
  int threads = 2;
};

const double nan_value = std::numeric_limits<double>::quiet_NaN();

struct Row {
  std::string scene;
  size_t nodes;
  int sweeps, threads;
  int substeps = Parameters{}.substeps;
  double tolerance = double(Parameters{}.tolerance);  // m
  double budget = 1;                                  // share of the largest requested work
  double importance = 1;
  double seconds = nan_value, work = nan_value;  // a car and tick
  Error error = {nan_value, nan_value};
  double largest = nan_value;  // largest displacement in the reference result, m
  double shed = nan_value;
  uint64_t bits = 0;
};

// The table being written. A value that was not measured is an empty field.
class Table {
 public:
  Table(const Options& options, double diagonal)
      : file_(std::fopen(options.csv.c_str(), "w"), std::fclose), diagonal_(diagonal) {
    if (!file_) throw std::runtime_error(options.csv + ": cannot be written; name a folder that exists and can be written.");
    about_ = '"' + machine() + "\"," + options.commit + ",0";
    std::fprintf(
        file_.get(),
        "machine,commit,seed,scene,nodes,iterations,threads,substeps,tolerance,budget,importance,us_best,cars_per_tick,work,"
        "shed,error_mm,"
        "max_mm,error_percent,diagonal_percent,hash\n");
  }
  void add(const Row& row) {
    std::fprintf(file_.get(), "%s,\"%s\",%zu,%d,%d,%d", about_.c_str(), row.scene.c_str(), row.nodes, row.sweeps, row.threads,
                 row.substeps);
    const double error = row.error.rms;
    for (double value : {row.tolerance, row.budget, row.importance, 1e6 * row.seconds, 1 / (rate * row.seconds), row.work,
                         row.shed, 1e3 * error, 1e3 * row.error.most, 100 * error / row.largest, 100 * error / diagonal_}) {
      std::fprintf(file_.get(), std::isfinite(value) ? ",%.5g" : ",", value);
    }
    std::fprintf(file_.get(), ",%016llx\n", static_cast<unsigned long long>(row.bits));
    std::fflush(file_.get());
    std::fprintf(stderr,
                 "%s, %zu nodes, %d sweeps, tolerance %.2g, budget %.2g, importance %.2g: %.4g us a car and tick, %.4g visits, "
                 "error %.4g mm\n",
                 row.scene.c_str(), row.nodes, row.sweeps, row.tolerance, row.budget, row.importance, 1e6 * row.seconds,
                 row.work, 1e3 * error);
  }

 private:
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> file_;
  double diagonal_;
  std::string about_;
};

// The reference result of a scene: the finest level with many sweeps.
struct Answer {
  std::vector<Vec3> surface;
  double largest;  // m
};
Answer answer(const Cars& levels, Scene scene) {
  scene.cars = 1;
  scene.sweeps = exact_sweeps;
  scene.tolerance = 0;
  const Model& model = levels[0]->model;
  const Play exact = play_once(levels[0], scene, 1);
  return {exact.surface[0], compare(exact.surface[0], {model.vertex.begin(), model.vertex.end()}).most};
}

Row row_of(const Scene& scene, const Car& car, int threads, const Play& play, const Answer& exact, size_t which = 0) {
  Row row{scene.name, car.model.node.size(), scene.sweeps, threads};
  row.tolerance = double(scene.tolerance);
  row.substeps = scene.substeps;
  row.seconds = play.seconds;
  row.work = play.work;
  row.shed = play.shed;
  row.error = compare(play.surface[which], exact.surface);
  row.largest = exact.largest;
  row.bits = play.bits;
  return row;
}

void measure_asleep(const Cars& levels, int threads, Table& table) {
  for (const auto& car : levels) {
    const Scene scene{"asleep", 0, 20, cars_asleep};
    const Play asleep = play(car, scene, threads);
    Row row{scene.name, car->model.node.size(), scene.sweeps, threads};
    row.seconds = asleep.seconds;
    row.work = asleep.work;
    row.error = {0, 0};
    row.bits = asleep.bits;
    table.add(row);
  }
}

void measure_hit(const Cars& levels, const Scene& scene, int threads, Table& table) {
  const Answer exact = answer(levels, scene);
  for (const auto& car : levels) {
    table.add(row_of(scene, *car, threads, play(car, scene, threads), exact));
    for (int sweeps : {2, 4, 6, 10, 20}) {
      Scene one = scene;
      one.sweeps = sweeps;
      one.tolerance = 0;
      table.add(row_of(one, *car, threads, play(car, one, threads), exact));
    }
    for (int substeps : {2, 1}) {
      Scene one = scene;
      one.substeps = substeps;
      table.add(row_of(one, *car, threads, play(car, one, threads), exact));
      one.tolerance = 0;
      for (int sweeps : {4, 6, 8}) {  // the fewest sweeps that a budget may leave (server/tick/budget.cpp)
        one.sweeps = sweeps;
        table.add(row_of(one, *car, threads, play(car, one, threads), exact));
      }
    }
  }
}

void measure_overload(const Cars& levels, int threads, Table& table) {
  Scene scene{"overload", crash};
  scene.some_unimportant = true;
  const Answer exact = answer(levels, scene);
  const double asked = play_once(levels[0], scene, threads).most_work;
  for (double share : {1.0, 0.7, 0.5, 0.35, 0.25}) {
    scene.budget = uint64_t(share * asked);
    const Play got = play(levels[0], scene, threads);
    for (size_t which : {0, 1}) {
      Row row = row_of(scene, *levels[0], threads, got, exact, which);
      row.budget = share;
      row.importance = which == 0 ? 1 : double(unimportant);
      table.add(row);
    }
    std::fprintf(stderr, "  most work of a tick: %.3g of the budget\n", got.most_work / double(scene.budget));
  }
}

// Makes one sub-step in a tick, so that the benchmark can keep all nodes awake: it sets their steps just above those of a
// resting node.
Play tapped_alone(const Model& model, bool all_awake) {
  const Mass mass = mass_of(model);
  const ScratchHandle scratch = make_scratch();
  DeformableState body = make_body(model);
  Motion motion;
  motion.velocity.x() = tap;
  Obstacle wall;
  make_box({0.5f, 5, 5}, wall);
  wall.pose.position.x() = front_of(model) + 0.5 + gap;
  Play play;
  double solved = 0;
  for (int k = 0; k < 8 * ticks; ++k) {
    if (all_awake && body.touching) {
      const float least = 1.01f * settle_speed * float(substep_seconds(Parameters{}));
      for (size_t i = 0; i < body.node.size(); ++i) {
        if (!model.node_anchored[i] && body.step[i].norm() < least) body.step[i] = {least, 0, 0};
      }
    }
    StepResult result;
    const double seconds = seconds_of(
        [&] {
          result = deform({model, {}, mass, {&wall, 1}, substep_seconds(Parameters{})}, *scratch, body, motion);
        },
        thread_seconds);
    if (result.substeps == 0 || !body.touching) continue;
    play.seconds += seconds;
    play.work += double(result.work);
    ++solved;
  }
  play.seconds /= solved;
  play.work /= solved;
  play.surface[0] = surface_of(model, body);
  play.bits = hash(body);
  return play;
}

void measure_active_set(const Cars& levels, Table& table) {
  const Model& model = levels[0]->model;
  const Play all = tapped_alone(model, true);
  for (bool awake : {false, true}) {
    Play play = tapped_alone(model, awake);
    for (int k = 1; k < repetitions; ++k) play.seconds = std::min(play.seconds, tapped_alone(model, awake).seconds);
    Row row{awake ? "sub-step of a tap, all awake" : "sub-step of a tap", model.node.size(), Parameters{}.iterations, 1};
    row.seconds = play.seconds;
    row.work = play.work;
    row.error = compare(play.surface[0], all.surface[0]);
    row.largest = compare(all.surface[0], {model.vertex.begin(), model.vertex.end()}).most;
    row.bits = play.bits;
    table.add(row);
  }
}

DeformableState crashed_into_a_pole(const Model& model) {
  const ScratchHandle scratch = make_scratch();
  DeformableState body = make_body(model);
  Motion motion;
  motion.velocity.x() = crash;
  Obstacle pole;
  make_capsule(0.15f, 2, pole);
  pole.pose.position = {front_of(model) + 0.15 + gap, 0.2, 0};
  for (int k = 0; k < ticks; ++k) deform({model, {}, mass_of(model), {&pole, 1}, 1 / rate}, *scratch, body, motion);
  return body;
}

// How far the car moves when nothing holds it.
double creep(const Model& model, DeformableState body) {
  const ScratchHandle scratch = make_scratch();
  const auto before = surface_of(model, body);
  Motion motion;
  body.settled = false;
  for (int k = 0; k < ticks && !body.settled; ++k) deform({model, {}, mass_of(model), {}, 1 / rate}, *scratch, body, motion);
  return compare(surface_of(model, body), before).rms;
}

void measure_switch(const Cars& levels, Table& table) {
  const Model& fine = levels[0]->model;
  const DeformableState crashed = crashed_into_a_pole(fine);
  const auto surface = surface_of(fine, crashed);
  const double largest = compare(surface, {fine.vertex.begin(), fine.vertex.end()}).most;
  const auto add = [&](const std::string& what, const Model& model, const DeformableState& body, const Model& from) {
    Row row{what, from.node.size(), Parameters{}.iterations, 1};
    row.error = compare(surface_of(model, body), surface);
    row.largest = largest;
    row.bits = hash(body);
    table.add(row);
    row.scene += ", woken";
    row.error = {creep(model, body), nan_value};
    table.add(row);
  };
  for (size_t k = 1; k < levels.size(); ++k) {
    const Model& coarse = levels[k]->model;
    const DeformableState down = transfer(fine, coarse, map_level(fine, coarse), crashed);
    add("switch down", coarse, down, coarse);
    add("switch down and up", fine, transfer(coarse, fine, map_level(coarse, fine), down), coarse);
    Row row{"crash on the level", coarse.node.size(), Parameters{}.iterations, 1};
    row.error = compare(surface_of(coarse, crashed_into_a_pole(coarse)), surface);
    row.largest = largest;
    table.add(row);
  }
}

Options read_options(int argc, char** argv) {
  Options options;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const auto value = [&]() -> std::string {
      if (++i == argc) throw std::runtime_error(word + ": a value must follow it.");
      return argv[i];
    };
    if (word == "--threads")
      options.threads = std::max(1, std::atoi(value().c_str()));
    else if (word == "--commit")
      options.commit = value();
    else if (word == "-o")
      options.csv = value();
    else if (word[0] != '-')
      options.cars.push_back(word);
    else
      throw std::runtime_error(word + ": unknown; call it without arguments for its usage.");
  }
  return options;
}

Cars load_levels(const std::vector<std::string>& files) {
  Cars levels;
  for (const std::string& file : files) {
    levels.push_back(load_car(file));
    if (!same_surface(*levels[0], *levels.back()))
      throw std::runtime_error(file + ": its surface is not that of " + files[0] + "; name the levels of one car.");
  }
  std::sort(levels.begin(), levels.end(), [](auto& a, auto& b) { return a->model.node.size() > b->model.node.size(); });
  return levels;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const Options options = read_options(argc, argv);
    if (options.cars.empty() || options.csv.empty()) {
      std::fprintf(stderr, "usage: crumple_scene CAR... [--threads N] [--commit NAME] -o CSV   (CAR: the levels of one car)\n");
      return 2;
    }
    const Cars levels = load_levels(options.cars);
    Eigen::AlignedBox3f box;
    for (const Vec3& vertex : levels[0]->model.vertex) box.extend(vertex);
    Table table(options, double(box.diagonal().norm()));
    measure_asleep(levels, options.threads, table);
    measure_hit(levels, {"tapped", tap}, options.threads, table);
    measure_hit(levels, {"crashing", crash}, options.threads, table);
    measure_overload(levels, options.threads, table);
    measure_active_set(levels, table);
    measure_switch(levels, table);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple_scene: %s\n", error.what());
    return 1;
  }
}

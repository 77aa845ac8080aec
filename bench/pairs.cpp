// Cars that hit each other, beside answers that are known: a car that meets its like at equal speed crushes as in a wall,
// momentum and energy are kept, and what one sees another may not change.
//   crumple_pairs CAR...                  one table per car; --help lists the options
//   crumple_pairs CAR --random 1000       random crashes; prints those that break a law, and how many
#include <CLI/CLI.hpp>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "bake/load_car.h"
#include "reference/pile_up.h"

namespace {

using namespace crumple;
using Eigen::Vector3d;

constexpr double pi = 3.14159265358979;
constexpr double crash_seconds = 0.35;

struct Options {
  std::vector<std::string> cars;
  double kmh = 50;
  uint16_t sweeps = 0, substeps = 0;  // 0: the default, with its tolerance
  std::string scene;
  int random = 0, first = 0;
};

double seconds_now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

double front_of(const Car& car) {
  float front = -1e9f;
  for (const Vec3& node : car.model.node) front = std::max(front, node.x());
  return double(front) - double(car.model.center_of_mass.x());
}
double back_of(const Car& car) {
  float back = 1e9f;
  for (const Vec3& node : car.model.node) back = std::min(back, node.x());
  return double(car.model.center_of_mass.x()) - double(back);
}
double half_width_of(const Car& car) {
  float most = 0;
  for (const Vec3& node : car.model.node) most = std::max(most, std::fabs(node.y()));
  return double(most);
}

Obstacle wall_at(double x, float friction) {
  Obstacle wall;
  make_box({0.5f, 10, 10}, wall);
  wall.pose.position.x() = x + 0.5;
  wall.friction = friction;
  return wall;
}

struct Row {
  std::string name;
  PileUp scene;
  double seconds = crash_seconds;
  // Of the run:
  double ms = 0, energy = 0, created = 0, momentum = 0, angular = 0, deepest_node = 0, deepest_any = 0;
};

void play(Row& row) {
  PileUp& scene = row.scene;
  const double start = scene.energy(), brought = scene.kinetic();
  const Vector3d momentum = scene.momentum(), angular = scene.angular_momentum();
  double scale = 0, angular_scale = 0;
  for (const CrashCar& car : scene.cars) {
    scale += car.mass.mass * car.motion.velocity.norm();
    angular_scale += car.mass.mass * car.motion.velocity.norm() * 2;
  }
  for (int k = 0; k < int(row.seconds * 60); ++k) {
    const double begin = seconds_now();
    scene.tick();
    row.ms += 1e3 * (seconds_now() - begin);
    row.created = std::max(row.created, scene.energy() / start - 1);
    if (k % 3 != 2) continue;
    for (const CrashCar& a : scene.cars) {
      for (const CrashCar& b : scene.cars) {
        if (&a == &b) continue;
        const Overlap overlap = measure_overlap(a, b);
        row.deepest_node = std::max(row.deepest_node, overlap.node);
        row.deepest_any = std::max(row.deepest_any, overlap.any);
      }
    }
  }
  row.energy = (scene.energy() - start + brought) / brought;
  row.momentum = (scene.momentum() - momentum).norm() / scale;
  row.angular = (scene.angular_momentum() - angular).norm() / angular_scale;
}

void print(const Row& row, double speed) {
  const auto& cars = row.scene.cars;
  double sweeps = 0, substeps = 0, peak = 0;
  for (const CrashCar& car : cars)
    sweeps = std::max(sweeps, car.sweeps), substeps = std::max(substeps, car.substeps), peak = std::max(peak, car.peak);
  std::printf(
      "| %-22s | %5.1f, %5.1f | %6.3f, %6.3f | %+5.2f, %+5.2f | %7.0f | %6.3f | %+6.3f | %7.1e | %7.1e | %5.1f, %5.1f | %3.0f, "
      "%4.1f | %6.1f |\n",
      row.name.c_str(), 1e3 * cars.front().nose_crush(), 1e3 * cars.back().nose_crush(),
      cars.front().motion.velocity.x() / speed, cars.back().motion.velocity.x() / speed,
      cars.front().motion.angular_velocity.z(), cars.back().motion.angular_velocity.z(), 1e-3 * peak, row.energy,
      100 * row.created, row.momentum, row.angular, 1e3 * row.deepest_node, 1e3 * row.deepest_any, substeps,
      sweeps / std::max(1.0, substeps), row.ms);
}

void play_car(const std::shared_ptr<const Car>& car, const Options& options) {
  const double v = options.kmh / 3.6, front = front_of(*car), back = back_of(*car), wide = half_width_of(*car);
  const double gap = 0.05;
  std::printf("\n%s: %zu nodes, %zu boundary nodes, %zu triangles, %.0f km/h\n\n", car->name.c_str(), car->model.node.size(),
              car->boundary.node.size(), car->boundary.triangle.size(), options.kmh);
  std::printf(
      "| scene | nose crush first, last mm | vx / v | yaw rad/s | peak kN | energy | created %% | momentum | angular | inside "
      "node, any mm | sub-steps, sweeps | ms |\n|---|\n");
  std::vector<Row> rows;
  const auto scene = [&](const std::string& name, double seconds, const std::function<void(PileUp&)>& fill) {
    Row row{name, {}, seconds};
    row.scene.cars.reserve(16);
    if (name.find(options.scene) == std::string::npos) return;
    fill(row.scene);
    for (CrashCar& each : row.scene.cars) {
      if (options.substeps > 0) each.parameters.substeps = options.substeps;
      if (options.sweeps > 0) each.parameters.iterations = options.sweeps, each.parameters.tolerance = 0;
    }
    play(row);
    print(row, v);
  };
  scene("wall", crash_seconds, [&](PileUp& s) {
    s.add(car, 0, 0, 0, v);
    s.obstacles.push_back(wall_at(front + gap, 0));
  });
  scene("head-on", crash_seconds, [&](PileUp& s) {
    s.add(car, -front - gap, 0, 0, v);
    s.add(car, front + gap, 0, pi, v);
  });
  scene("head-on (2v, 0)", crash_seconds, [&](PileUp& s) {
    s.add(car, -front - gap, 0, 0, 2 * v);
    s.add(car, front + gap, 0, pi, 0);
  });
  scene("offset 50 %", crash_seconds, [&](PileUp& s) {
    s.add(car, -front - gap, 0.5 * wide, 0, v);
    s.add(car, front + gap, -0.5 * wide, pi, v);
  });
  scene("oblique 30", crash_seconds, [&](PileUp& s) {
    s.add(car, -front - gap, 0, 0, v);
    s.add(car, front * std::cos(pi / 6) + gap + 0.3, front * 0.5, pi + pi / 6, v);
  });
  scene("T-bone front", crash_seconds, [&](PileUp& s) {
    s.add(car, 0, -1.2 - front, pi / 2, v);
    s.add(car, -1.2, 0, 0, 0);
  });
  scene("T-bone rear", crash_seconds, [&](PileUp& s) {
    s.add(car, 0, -1.2 - front, pi / 2, v);
    s.add(car, 1.2, 0, 0, 0);
  });
  scene("rear-end", crash_seconds, [&](PileUp& s) {
    s.add(car, -front - gap - back, 0, 0, v);
    s.add(car, 0, 0, 0, 0);
  });
  scene("side-swipe", crash_seconds, [&](PileUp& s) {
    s.add(car, -2 * front, 0, 0, v);
    s.add(car, 2 * front, 1.9 * wide, pi, v);
  });
  scene("queue of five", 2 * crash_seconds, [&](PileUp& s) {
    s.add(car, -front - back - 0.1, 0, 0, v);
    for (int k = 0; k < 4; ++k) s.add(car, k * (front + back + 0.1), 0, 0, 0);
  });
}

struct Tally {
  int crashes = 0, lost = 0, created = 0, kinetic = 0, undone = 0, inside = 0;
  double least = 1, most = 1, worst_momentum = 0, seconds = 0;
};

void play_random(const std::shared_ptr<const Car>& car, const Options& options) {
  Tally tally;
  for (int k = 0; k < options.random; ++k) {
    const int seed = options.first + k;
    PileUp scene = random_crash(car, uint32_t(seed));
    const double start = scene.energy(), brought = scene.kinetic(), begun = seconds_now();
    const Vector3d momentum = scene.momentum();
    double scale = 0, most = 0, most_kinetic = 0, slowest = 0;
    for (const CrashCar& each : scene.cars) scale += each.mass.mass * each.motion.velocity.norm();
    bool undone = false, lost_shape = false;
    for (int tick = 0; tick < 30; ++tick) {
      const double before = seconds_now();
      scene.tick();
      slowest = std::max(slowest, seconds_now() - before);
      most = std::max(most, scene.energy() / start - 1);
      most_kinetic = std::max(most_kinetic, scene.kinetic() / brought - 1);
      for (const CrashCar& each : scene.cars) undone |= each.last.recovered, lost_shape |= each.body.lost;
    }
    const double energy = scene.energy() / start, moved = (scene.momentum() - momentum).norm() / scale;
    const double inside =
        std::max(measure_overlap(scene.cars[0], scene.cars[1]).node, measure_overlap(scene.cars[1], scene.cars[0]).node);
    ++tally.crashes;
    tally.seconds += seconds_now() - begun;
    tally.lost += energy < 0.97;
    tally.created += most > 0.01;
    tally.kinetic += most_kinetic > 1e-6;
    tally.undone += undone;
    tally.inside += inside > 0.02;
    tally.least = std::min(tally.least, energy);
    tally.most = std::max(tally.most, 1 + most);
    tally.worst_momentum = std::max(tally.worst_momentum, moved);
    if (energy < 0.97 || most > 0.01 || undone || most_kinetic > 1e-6 || inside > 0.02 || moved > 1e-9) {
      const CrashCar &a = scene.cars[0], &b = scene.cars[1];
      std::printf(
          "%6d: %5.0f kg and %5.0f kg, energy %.4f, most %+.4f, kinetic %+.1e, inside %3.0f mm, displaced %.2f and %.2f m, "
          "slowest tick %.0f ms%s%s\n",
          seed, a.mass.mass, b.mass.mass, energy, most, most_kinetic, 1e3 * inside, a.largest_displacement(),
          b.largest_displacement(), 1e3 * slowest, lost_shape ? ", shape lost" : "", undone ? ", a tick undone" : "");
      std::fflush(stdout);
    }
  }
  std::printf(
      "%d crashes: %d end below 0.97 of their energy (least %.3f), %d rise by over 1 %% (most %.3f), %d gain kinetic energy, "
      "%d with a tick undone, %d end over 20 mm inside; momentum within %.1e; %.0f s\n",
      tally.crashes, tally.lost, tally.least, tally.created, tally.most, tally.kinetic, tally.undone, tally.inside,
      tally.worst_momentum, tally.seconds);
}

}  // namespace

int main(int count, char** argument) {
  CLI::App app{"Plays ten scenes of cars that hit each other, and prints what is kept and what an equal wall would give."};
  Options options;
  app.add_option("car", options.cars, "baked cars")->required()->check(CLI::ExistingFile);
  app.add_option("--kmh", options.kmh, "speed of each moving car")->check(CLI::Range(1.0, 200.0))->capture_default_str();
  app.add_option("--sweeps", options.sweeps, "exactly so many sweeps a sub-step (default: 24 at most, by tolerance)")
      ->check(CLI::Range(2, 1000));
  app.add_option("--substeps", options.substeps, "sub-steps in 1/60 s (default: 4)")->check(CLI::Range(1, 64));
  app.add_option("--scene", options.scene, "only scenes whose name contains this");
  app.add_option("--random", options.random, "instead plays so many random crashes")->check(CLI::Range(1, 1000000));
  app.add_option("--first", options.first, "seed of the first random crash; the next has the next")
      ->check(CLI::Range(0, 1000000));
  CLI11_PARSE(app, count, argument);
  for (const std::string& file : options.cars)
    options.random > 0 ? play_random(load_car(file), options) : play_car(load_car(file), options);
}

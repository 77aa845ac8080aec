// Cars that hit each other, beside answers that are known: a car that meets its like at equal speed crushes as in a wall,
// momentum and energy are kept, and the number of sweeps, sub-steps and ticks should not matter.
//   crumple_pairs CAR...                  tables in Markdown: scenes, what is asked beside what is measured, measured crashes
//   crumple_pairs CAR --scene oblique     only such scenes
//   crumple_pairs CAR --random 1000       random crashes; prints those that break a law, and how many
//   crumple_pairs CAR --rest 1000000      a car that leans on another, and one that lies on another's roof
#include <tbb/global_control.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "bake/load_car.h"
#include "car/balance.h"
#include "reference/pile_up.h"

namespace {

using namespace crumple;
using Eigen::Vector3d;
using CarPointer = std::shared_ptr<const Car>;

constexpr double pi = 3.14159265358979;
constexpr double gap = 0.05;  // m, between cars that are about to meet

struct Options {
  std::vector<std::string> cars;
  double kmh = 50;
  uint16_t sweeps = 0, substeps = 0;  // 0: the default, with its tolerance
  std::string scene;
  int random = 0, first = 0, rest = 0, threads = 1;
};

double seconds_now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

// From the centre of mass to the car's ends, m; top: from the ground to the roof.
struct Sizes {
  double front = -1e9, back = -1e9, wide = 0, top = 0;
};
Sizes sizes_of(const Car& car) {
  Sizes sizes;
  const double center = double(car.model.center_of_mass.x());
  for (const Vec3& node : car.model.node) {
    sizes.front = std::max(sizes.front, double(node.x()) - center);
    sizes.back = std::max(sizes.back, center - double(node.x()));
    sizes.wide = std::max(sizes.wide, std::fabs(double(node.y())));
    sizes.top = std::max(sizes.top, double(node.z()));
  }
  return sizes;
}

Obstacle block(const Vec3& half, double x, double y, double z, float friction) {
  Obstacle out;
  make_box(half, out);
  out.pose.position = {x, y, z};
  out.friction = friction;
  return out;
}

// What a scene is made of: a car, how fast it is, and how far from a wall or from half-way to its like it starts.
struct Cast {
  CarPointer car;
  Sizes size;
  double v;            // m/s
  double apart = gap;  // m
};

struct Scene {
  const char* name;
  double seconds;
  int yaw[2];  // sign of the first and of the last car's turn, where it is beyond doubt; else 0
  std::function<void(PileUp&, const Cast&)> fill;
};

void wall(PileUp& s, const Cast& c) {
  s.add(c.car, 0, 0, 0, c.v);
  s.obstacles.push_back(block({0.5f, 10, 10}, c.size.front + c.apart + 0.5, 0, 0, 0));
}
void head_on(PileUp& s, const Cast& c) {
  s.add(c.car, -c.size.front - c.apart, 0, 0, c.v);
  s.add(c.car, c.size.front + c.apart, 0, pi, c.v);
}
void into_parked(PileUp& s, const Cast& c) {
  s.add(c.car, -c.size.front - gap, 0, 0, 2 * c.v);
  s.add(c.car, c.size.front + gap, 0, pi, 0);
}
void offset(PileUp& s, const Cast& c) {
  s.add(c.car, -c.size.front - gap, 0.5 * c.size.wide, 0, c.v);
  s.add(c.car, c.size.front + gap, -0.5 * c.size.wide, pi, c.v);
}
void oblique(PileUp& s, const Cast& c) {
  s.add(c.car, -c.size.front - gap, 0, 0, c.v);
  s.add(c.car, c.size.front * std::cos(pi / 6) + gap + 0.3, c.size.front * 0.5, pi + pi / 6, c.v);
}
void t_bone_front(PileUp& s, const Cast& c) {
  s.add(c.car, 0, -c.size.wide - c.size.front - gap, pi / 2, c.v);
  s.add(c.car, -1.2, 0, 0, 0);
}
void t_bone_rear(PileUp& s, const Cast& c) {
  s.add(c.car, 0, -c.size.wide - c.size.front - gap, pi / 2, c.v);
  s.add(c.car, 1.2, 0, 0, 0);
}
void rear_end(PileUp& s, const Cast& c) {
  s.add(c.car, -c.size.front - gap - c.size.back, 0, 0, c.v);
  s.add(c.car, 0, 0, 0, 0);
}
void side_swipe(PileUp& s, const Cast& c) {
  s.add(c.car, -2 * c.size.front, 0, 0, c.v);
  s.add(c.car, 2 * c.size.front, 1.9 * c.size.wide, pi, c.v);
}
void queue(PileUp& s, const Cast& c) {
  s.add(c.car, -c.size.front - c.size.back - 0.1, 0, 0, c.v);
  for (int k = 0; k < 4; ++k) s.add(c.car, k * (c.size.front + c.size.back + 0.1), 0, 0, 0);
}
void pile_up(PileUp& s, const Cast& c) {
  const double length = c.size.front + c.size.back + 0.4;
  for (int k = 0; k < 10; ++k) {
    const int row = k / 2, lane = k % 2;
    s.add(c.car, -row * length - c.size.front, (lane - 0.5) * (2 * c.size.wide + 0.3), 0.06 * ((k * 7) % 5 - 2), c.v);
  }
  s.obstacles.push_back(block({0.5f, 10, 10}, 1, 2, 0, 0.3f));
  s.obstacles.push_back(block({0.15f, 0.15f, 2}, 0.3, -0.4, 1, 0.3f));
}
void on_a_roof(PileUp& s, const Cast& c) {
  s.add(c.car, 0, 0, 0, 0);
  s.obstacles.push_back(block({10, 10, 0.5f}, 0, 0, -0.5, 0.6f));
  CrashCar& above = s.add(c.car, 0, 0, 0, 0);
  above.motion.pose.orientation = Eigen::AngleAxisd(pi, Vector3d::UnitX());
  above.motion.pose.position.z() = 2 * c.size.top + gap;
  above.motion.velocity = {0, 0, -0.3 * c.v};
  above.mass.planar = false;
}

const Scene scenes[] = {
    {"wall", 0.35, {0, 0}, wall},
    {"head-on", 0.35, {0, 0}, head_on},
    {"head-on (2v, 0)", 0.35, {0, 0}, into_parked},
    {"offset 50 %", 0.35, {-1, -1}, offset},
    {"oblique 30", 0.35, {0, 0}, oblique},
    {"T-bone, front axle", 0.35, {0, 1}, t_bone_front},
    {"T-bone, rear axle", 0.35, {0, -1}, t_bone_rear},
    {"rear-end", 0.35, {0, 0}, rear_end},
    {"side-swipe", 0.35, {0, 0}, side_swipe},
    {"queue of five", 0.7, {0, 0}, queue},
    {"ten, wall and pole", 0.5, {0, 0}, pile_up},
    {"dropped on a roof", 0.35, {0, 0}, on_a_roof},
};

struct Settings {
  uint16_t sweeps = 0, substeps = 0;
  double rate = 60;     // ticks a second
  float friction = -1;  // of all materials; below 0: the default
};

struct Run {
  PileUp scene;
  double ms = 0, worst_ms = 0, energy = 0, created = 0, momentum = 0, angular = 0, deepest_node = 0, deepest_any = 0;
  int ticks = 0;
};

Run play(const Scene& scene, const Cast& cast, const Settings& settings = {}, bool measure = false) {
  Run run;
  PileUp& cars = run.scene;
  cars.cars.reserve(16);
  scene.fill(cars, cast);
  for (CrashCar& each : cars.cars) {
    if (settings.substeps > 0) each.parameters.substeps = settings.substeps;
    if (settings.sweeps > 0) each.parameters.iterations = settings.sweeps, each.parameters.tolerance = 0;
    for (Material& material : each.parameters.region)
      if (settings.friction >= 0) material.friction = settings.friction;
  }
  const double start = cars.energy(), brought = cars.kinetic();
  const Vector3d momentum = cars.momentum(), angular = cars.angular_momentum();
  double scale = 0;
  for (const CrashCar& car : cars.cars) scale += car.mass.mass * car.motion.velocity.norm();
  for (; run.ticks < int(std::lround(scene.seconds * settings.rate)); ++run.ticks) {
    const double begin = seconds_now();
    cars.tick(1 / settings.rate);
    const double ms = 1e3 * (seconds_now() - begin);
    run.ms += ms;
    run.worst_ms = std::max(run.worst_ms, ms);
    run.created = std::max(run.created, cars.energy() / start - 1);
    if (!measure || run.ticks % 3 != 2) continue;
    for (const CrashCar& a : cars.cars) {
      for (const CrashCar& b : cars.cars) {
        if (&a == &b) continue;
        const Overlap overlap = measure_overlap(a, b);
        run.deepest_node = std::max(run.deepest_node, overlap.node);
        run.deepest_any = std::max(run.deepest_any, overlap.any);
      }
    }
  }
  run.energy = (cars.energy() - start + brought) / brought;
  run.momentum = (cars.momentum() - momentum).norm() / scale;
  run.angular = (cars.angular_momentum() - angular).norm() / (2 * scale);
  return run;
}

double crush(const Run& run) { return run.scene.cars.front().nose_crush(); }
// Of a car that drove to the right, at v against its like or a wall.
double restitution(const Run& run, double v) { return -run.scene.cars.front().motion.velocity.x() / v; }
double largest_peak(const Run& run) {
  double peak = 0;
  for (const CrashCar& car : run.scene.cars) peak = std::max(peak, car.peak);
  return peak;
}

void print(const Scene& scene, const Run& run, double v) {
  const auto& cars = run.scene.cars;
  double sweeps = 0, substeps = 0;
  for (const CrashCar& car : cars) sweeps = std::max(sweeps, car.sweeps), substeps = std::max(substeps, car.substeps);
  char kept[64] = "–";  // obstacles take momentum
  if (run.scene.obstacles.empty()) std::snprintf(kept, sizeof kept, "%.0e, %.0e", run.momentum, run.angular);
  std::printf(
      "| %s | %.1f, %.1f | %.3f, %.3f | %+.2f, %+.2f | %.0f | %.3f | %.2f | %s | %.1f, %.1f | %.0f, %.1f | %.1f, %.1f |\n",
      scene.name, 1e3 * cars.front().nose_crush(), 1e3 * cars.back().nose_crush(), cars.front().motion.velocity.x() / v,
      cars.back().motion.velocity.x() / v, cars.front().motion.angular_velocity.z(), cars.back().motion.angular_velocity.z(),
      1e-3 * largest_peak(run), run.energy, 100 * run.created, kept, 1e3 * run.deepest_node, 1e3 * run.deepest_any, substeps,
      sweeps / std::max(1.0, substeps), run.ms / run.ticks, run.worst_ms);
  std::fflush(stdout);
}

// The span of some figures.
struct Span {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  void add(double value) { low = std::min(low, value), high = std::max(high, value); }
  double wide() const { return high - low; }
};

template <typename... Values>
void bar(const char* what, const char* goal, const char* format, Values... values) {
  char measured[256];
  std::snprintf(measured, sizeof measured, format, values...);
  std::printf("| %s | %s | %s |\n", what, goal, measured);
  std::fflush(stdout);
}

// Cars side by side press together at `across` m/s each while they pass. The ratio of the impulse along to that across.
double rubbing(const Cast& cast, float friction, double across = 2) {
  const Scene scene = {"rub", 0.15, {0, 0}, [across](PileUp& s, const Cast& c) {
                         s.add(c.car, 0, -c.size.wide - 0.5 * gap, 0, c.v).motion.velocity.y() = across;
                         s.add(c.car, 0, c.size.wide + 0.5 * gap, pi, c.v).motion.velocity.y() = -across;
                       }};
  const Run run = play(scene, cast, {.friction = friction});
  const Vector3d& impulse = run.scene.cars.front().impulse;
  return std::fabs(impulse.x() / impulse.y());
}

// Plays a head-on crash with each of some settings. Prints the spans over those from `from` on, and lists the others' figures.
void span_bar(const char* what, const char* goal, const Cast& cast, const std::vector<Settings>& list, size_t from) {
  Span crushes, restitutions;
  std::string others;
  for (size_t k = 0; k < list.size(); ++k) {
    const Run run = play(scenes[1], cast, list[k]);
    if (k < from) {
      char text[96];
      std::snprintf(text, sizeof text, "; with %d: %.1f mm, %.3f", list[k].sweeps, 1e3 * crush(run), restitution(run, cast.v));
      others += text;
      continue;
    }
    crushes.add(crush(run));
    restitutions.add(restitution(run, cast.v));
  }
  bar(what, goal, "%.1f to %.1f mm (%.2f %%), %.3f to %.3f%s", 1e3 * crushes.low, 1e3 * crushes.high,
      100 * crushes.wide() / crushes.high, restitutions.low, restitutions.high, others.c_str());
}

// How far a pair is off the same car in a frictionless wall, the worst of some speeds.
struct OffWall {
  double crush = 0, restitution = 0, peak = 0, unequal = 0;
  void add(const Run& pair, const Run& wall, double v) {
    const double first = ::crush(pair), second = pair.scene.cars.back().nose_crush();
    crush = std::max({crush, std::fabs(first / ::crush(wall) - 1), std::fabs(second / ::crush(wall) - 1)});
    restitution = std::max(restitution, std::fabs(::restitution(pair, v) - ::restitution(wall, v)));
    peak = std::max(peak, std::fabs(largest_peak(pair) / largest_peak(wall) - 1));
    unequal = std::max(unequal, std::fabs(first / second - 1));
  }
};

// The peak is the mean of a tick, so it depends on when in a tick the crash begins.
void compare_with_wall(const Cast& cast) {
  OffWall by_default, converged, finer;
  double peaks = 0;
  for (const double kmh : {16.0, 24.0, 32.0, 40.0, 48.0, 57.0}) {
    const Cast at{cast.car, cast.size, kmh / 3.6};
    const Run wall = play(scenes[0], at);
    by_default.add(play(scenes[1], at), wall, at.v);
    converged.add(play(scenes[1], at, {.sweeps = 100}), play(scenes[0], at, {.sweeps = 100}), at.v);
    finer.add(play(scenes[0], at, {.substeps = 8}), wall, at.v);
    Span peak;
    for (int k = 0; k < 4; ++k)
      peak.add(largest_peak(play(scenes[0], {cast.car, cast.size, at.v, gap + 0.25 * k * at.v / 60})));
    peaks = std::max(peaks, peak.high / peak.low - 1);
  }
  bar("crush against that in a frictionless wall, worst of 16 to 57 km/h; with 100 sweeps", "1 %", "%.1f %%; %.1f %%",
      100 * by_default.crush, 100 * converged.crush);
  bar("restitution against the wall's; with 100 sweeps", "0.01", "%.3f; %.3f", by_default.restitution, converged.restitution);
  bar("peak force against the wall's; with 100 sweeps", "5 %", "%.1f %%; %.1f %%", 100 * by_default.peak, 100 * converged.peak);
  bar("equal cars crush equally; with 100 sweeps", "1 %", "%.1f %%; %.1f %%", 100 * by_default.unequal,
      100 * converged.unequal);
  bar("the wall against itself: crush, restitution at twice the sub-steps; peak if it starts a quarter tick later", "–",
      "%.1f %%, %.3f; %.1f %%", 100 * finer.crush, finer.restitution, 100 * peaks);
}

void play_bars(const Cast& cast, const std::vector<Run>& played) {
  std::printf("\n| head-on at %.0f km/h unless said | goal | measured |\n|---|---|---|\n", cast.v * 3.6);
  compare_with_wall(cast);
  const Run even = play(scenes[1], cast), odd = play(scenes[2], cast);
  double squares = 0;
  const auto &a = even.scene.cars.front().body.node, &b = odd.scene.cars.front().body.node;
  for (size_t i = 0; i < a.size(); ++i) squares += double((a[i] - b[i]).squaredNorm());
  bar("(2v, 0) against (v, v), rms of all nodes", "0.2 mm", "%.2f mm", 1e3 * std::sqrt(squares / double(a.size())));

  Span energy, created, momentum, angular, node, any;
  int right = 0, known = 0;
  for (size_t k = 0; k < played.size(); ++k) {
    const Run& run = played[k];
    energy.add(run.energy), created.add(run.created), node.add(run.deepest_node), any.add(run.deepest_any);
    if (run.scene.obstacles.empty()) momentum.add(run.momentum), angular.add(run.angular);
    const double turned[2] = {run.scene.cars.front().motion.angular_velocity.z(),
                              run.scene.cars.back().motion.angular_velocity.z()};
    for (int side = 0; side < 2; ++side) {
      if (scenes[k].yaw[side] == 0) continue;
      ++known;
      right += turned[side] * scenes[k].yaw[side] > 0;
    }
  }
  bar("momentum, spin of all scenes, of what the cars bring", "1e-12; 1e-10", "%.0e; %.0e", momentum.high, angular.high);
  bar("energy found / brought, all scenes; most created", "0.99 to 1.01", "%.3f to %.3f; %.2f %%", energy.low, energy.high,
      100 * created.high);
  bar("deepest node, point between nodes inside another car, all scenes", "2; 20 mm", "%.1f; %.0f mm", 1e3 * node.high,
      1e3 * any.high);
  bar("signs of yaw that are beyond doubt", "all", "%d of %d", right, known);

  span_bar("crush, restitution over 10, 16, 24, 32, 64 sweeps", "2 %, ± 0.01", cast, {{4}, {8}, {10}, {16}, {24}, {32}, {64}},
           2);
  span_bar("over 4, 8, 16, 32 sub-steps", "2 %", cast, {{0, 4}, {0, 8}, {0, 16}, {0, 32}}, 0);
  span_bar("over 30, 60, 120, 240 ticks a second", "0.1 mm", cast, {{0, 0, 30}, {0, 0, 60}, {0, 0, 120}, {0, 0, 240}}, 0);
  bar("rubbing side by side: impulse along / across at friction 0, 0.3, 0.6", "± 0.03", "%.3f, %.3f, %.3f", rubbing(cast, 0),
      rubbing(cast, 0.3f), rubbing(cast, 0.6f));
  bar("the same if they press at 1 m/s and 4 m/s each, at friction 0", "–", "%.3f, %.3f", rubbing(cast, 0, 1),
      rubbing(cast, 0, 4));

  std::vector<double> ratio;
  double tick = std::numeric_limits<double>::infinity(), slowest = tick;
  for (int k = 0; k < 5; ++k) {
    const Run alone = play(scenes[0], cast), pair = play(scenes[1], cast);
    ratio.push_back(pair.ms / (2 * alone.ms));
    tick = std::min(tick, pair.ms / pair.ticks);
    slowest = std::min(slowest, pair.worst_ms);
  }
  std::sort(ratio.begin(), ratio.end());
  bar("time of a pair / of two walls, best and median of 5", "1.4", "%.2f, %.2f", ratio[0], ratio[2]);
  bar("a tick of the pair, mean and slowest, best of 5", "–", "%.1f, %.1f ms", tick, slowest);
}

// The arrays of a car that scaled() replaces.
struct ScaledArrays {
  std::vector<Vec3> node, vertex;
  std::vector<float> node_mass, tet_rest, edge_rest;
  std::vector<Gradients> gradients;
  CarPointer car;  // owns the others
};

// The car with all its points scaled along each axis, and with another mass.
CarPointer scaled(const CarPointer& car, const Vec3& by, double mass) {
  const Model& from = car->model;
  auto arrays = std::make_shared<ScaledArrays>();
  auto out = std::make_shared<Car>(*car);
  for (const Vec3& node : from.node) arrays->node.push_back(node.cwiseProduct(by));
  for (const Vec3& vertex : from.vertex) arrays->vertex.push_back(vertex.cwiseProduct(by));
  for (const float each : from.node_mass) arrays->node_mass.push_back(each * float(mass) / from.mass);
  for (const float each : from.tet_rest) arrays->tet_rest.push_back(each * by.prod());
  for (const auto& [node] : from.edge) arrays->edge_rest.push_back((arrays->node[node[0]] - arrays->node[node[1]]).norm());
  for (Gradients each : from.gradients) {
    for (Vec3& corner : each.corner) corner = corner.cwiseQuotient(by);
    arrays->gradients.push_back(each);
  }
  arrays->car = car;
  Model& to = out->model;
  to.node = arrays->node, to.vertex = arrays->vertex, to.node_mass = arrays->node_mass, to.tet_rest = arrays->tet_rest;
  to.edge_rest = arrays->edge_rest, to.gradients = arrays->gradients;
  to.order = &out->order, to.boundary = &out->boundary;
  const Balance all = balance(to.node, to.node_mass);
  to.mass = float(all.mass), to.center_of_mass = all.center.cast<float>(), to.inertia = all.inertia.cast<float>();
  out->mean_edge *= std::cbrt(by.prod());
  out->owner = arrays;
  return out;
}

// Crashes of real cars. The given car stands for each of them, scaled to its length and width, with its mass and inertia. The
// material is not calibrated. The oblique ones: Rose et al., SAE 2006-01-0908, whose figures are a planar fit to the tests;
// headings and the way from the centre of mass to the impact's centre as published.
struct MeasuredCar {
  double mass, inertia, length, width, kmh, heading, away, angle;  // kg, kg m^2, m, m, km/h, deg, m, deg
  double change, yaw;                                              // published: km/h, deg/s
};
struct MeasuredCrash {
  const char* name;
  double impulse_ratio;  // published: along the contact / across it
  MeasuredCar car[2];
};
constexpr MeasuredCrash measured_crashes[] = {
    {"NHTSA 4363, oblique",
     0.51,
     {{1565.4, 2918, 4.719, 1.781, 56.49, 180, 0.792, 23.8, 63.57, 31},
      {2129.8, 3803, 4.61, 1.72, 56.33, 32, 1.737, 10.6, 46.83, 182}}},
    {"NHTSA 4438, oblique",
     0.44,
     {{1499.4, 2801, 4.719, 1.781, 55.84, 180, 0.853, 35.3, 63.89, 68},
      {2143.4, 3917, 4.602, 1.681, 56.33, 30, 1.524, 13.2, 44.74, 166}}},
};

// Puts a car that is like the measured one into the scene, at rest at the origin.
CrashCar& add_like(const CarPointer& car, const MeasuredCar& like, float friction, PileUp& cars) {
  const Sizes size = sizes_of(*car);
  const Vec3 by(float(like.length / (size.front + size.back)), float(0.5 * like.width / size.wide), 1);
  CrashCar& out = cars.add(scaled(car, by, like.mass), 0, 0, like.heading * pi / 180, 0);
  out.mass.inertia *= like.mass / out.mass.mass;
  out.mass.mass = like.mass;
  if (like.inertia > 0) out.mass.inertia.z() = like.inertia;
  for (Material& material : out.parameters.region) material.friction = friction;
  return out;
}

void print_measured(const std::string& name, const PileUp& cars, const std::vector<Vector3d>& start,
                    const MeasuredCrash& crash) {
  double change[2], yaw[2];
  for (size_t k = 0; k < 2; ++k) {
    change[k] = 3.6 * (cars.cars[k].motion.velocity - start[k]).norm();
    yaw[k] = cars.cars[k].motion.angular_velocity.z() * 180 / pi;
  }
  std::printf("| %s | %.1f, %.1f; %.1f, %.1f | %+.0f, %+.0f; %+.0f, %+.0f |\n", name.c_str(), change[0], change[1],
              crash.car[0].change, crash.car[1].change, yaw[0], yaw[1], crash.car[0].yaw, crash.car[1].yaw);
  std::fflush(stdout);
}

std::string name_of(const char* crash, const char* with, double value) {
  char text[128];
  std::snprintf(text, sizeof text, "%s, %s %.3g", crash, with, value);
  return text;
}

void play_oblique(const CarPointer& car, const MeasuredCrash& crash, double friction) {
  PileUp cars;
  cars.cars.reserve(2);
  constexpr double degree = pi / 180, before = 0.2;  // s until both would be where the impact's centre is theirs
  std::vector<Vector3d> start;
  for (const MeasuredCar& each : crash.car) {
    const double heading = each.heading * degree, to = heading + each.angle * degree, speed = each.kmh / 3.6;
    CrashCar& one = add_like(car, each, float(friction), cars);
    const Vector3d way(std::cos(heading), std::sin(heading), 0);
    one.motion.pose.position -= each.away * Vector3d(std::cos(to), std::sin(to), 0) + before * speed * way;
    one.motion.velocity = speed * way;
    start.push_back(one.motion.velocity);
  }
  cars.run(0.5);
  print_measured(name_of(crash.name, "friction", friction), cars, start, crash);
}

// NHTSA 7292: a Taurus runs into a standing one that is turned by 7 degrees. No rail of one meets a rail of the other. The
// report gives neither the way between the two middles nor the turn's sign: 1.1 m are assumed (rails half a metre from the
// middle, which just miss), and both signs are played. Its rates of yaw are inferred, without a sign.
void play_7292(const CarPointer& car, double turn) {
  constexpr double aside = 1.1;
  const MeasuredCrash crash{
      "NHTSA 7292",
      0,
      {{1735, 0, 5.022, 1.845, 113.4, 0, 0, 0, 56.0, 160}, {1730, 0, 5.02, 1.845, 0, 180 + turn, 0, 0, 54.6, 77}}};
  PileUp cars;
  cars.cars.reserve(2);
  std::vector<Vector3d> start;
  for (const MeasuredCar& each : crash.car) {
    CrashCar& one = add_like(car, each, 0.6f, cars);
    const double heading = each.heading * pi / 180, front = sizes_of(*one.car).front;
    one.motion.pose.position += Vector3d(cars.cars.size() == 1 ? -2 * gap : 0, cars.cars.size() == 1 ? 0 : aside, 0) -
                                front * Vector3d(std::cos(heading), std::sin(heading), 0);
    one.motion.velocity = each.kmh / 3.6 * Vector3d(std::cos(heading), std::sin(heading), 0);
    start.push_back(one.motion.velocity);
  }
  while (measure_overlap(cars.cars[0], cars.cars[1]).any + measure_overlap(cars.cars[1], cars.cars[0]).any > 0)
    cars.cars[0].motion.pose.position.x() -= gap;
  cars.run(0.5);
  print_measured(name_of(crash.name, "turned by", turn) + " degrees", cars, start, crash);
}

void play_measured(const Cast& cast) {
  std::printf("\n| measured crash | change of speed: ours; published, km/h | yaw: ours; published, deg/s |\n|---|---|---|\n");
  for (const MeasuredCrash& crash : measured_crashes) {
    for (const double friction : {0.6, crash.impulse_ratio}) play_oblique(cast.car, crash, friction);
  }
  for (const double turn : {7.0, -7.0}) play_7292(cast.car, turn);
}

double play_car(const CarPointer& car, const Options& options) {
  const Cast cast{car, sizes_of(*car), options.kmh / 3.6};
  std::printf("\n## %s, %zu nodes\n\n%zu boundary nodes, %zu triangles, %.0f km/h\n\n", car->name.c_str(),
              car->model.node.size(), car->boundary.node.size(), car->boundary.triangle.size(), options.kmh);
  std::printf(
      "| scene | nose crush: first, last car, mm | vx / v | yaw, rad/s | peak, kN | energy found / brought | most created, %% "
      "| "
      "momentum, spin lost | inside: node, any point, mm | sub-steps, sweeps in each | tick: mean, slowest, ms |\n"
      "|---|---|---|---|---|---|---|---|---|---|---|\n");
  std::vector<Run> played;
  for (const Scene& scene : scenes) {
    if (std::string(scene.name).find(options.scene) == std::string::npos) continue;
    played.push_back(play(scene, cast, {.sweeps = options.sweeps, .substeps = options.substeps}, true));
    print(scene, played.back(), cast.v);
  }
  if (!options.scene.empty()) return 0;
  play_bars(cast, played);
  play_measured(cast);
  return crush(played[1]);
}

// How far the farthest node has moved in a car that lies still on another, since five seconds after it came to lie.
void play_rest(const CarPointer& car, const Options& options) {
  const Sizes size = sizes_of(*car);
  const auto play = [&](const char* name, const Vector3d& pull, const std::function<void(PileUp&)>& fill) {
    PileUp scene;
    scene.cars.reserve(2);
    fill(scene);
    scene.cars[0].mass.mass = std::numeric_limits<double>::infinity();
    scene.cars[0].mass.inertia.setConstant(scene.cars[0].mass.mass);
    CrashCar& resting = scene.cars[1];
    resting.pull = pull;
    std::vector<Vec3> early;
    Motion then;
    const double begin = seconds_now();
    for (int tick = 0; tick < options.rest; ++tick) {
      scene.tick();
      if (tick == 299) early = resting.body.node, then = resting.motion;
    }
    double moved = 0;
    for (size_t i = 0; i < early.size(); ++i) moved = std::max(moved, double((resting.body.node[i] - early[i]).norm()));
    std::printf("%s: in ticks 300 to %d a node moves %.3f mm at most in its car's frame, the car %.3f mm; %.2f ms a tick\n",
                name, options.rest, 1e3 * moved, 1e3 * (resting.motion.pose.position - then.pose.position).norm(),
                1e3 * (seconds_now() - begin) / options.rest);
    std::fflush(stdout);
  };
  play("leans with 0.3 g", {0.3 * 9.81, 0, 0}, [&](PileUp& s) {
    s.add(car, size.front + 0.005, 0, pi, 0);
    s.add(car, -size.front - 0.005, 0, 0, 0);
  });
  play("lies on a roof with 1 g", {0, 0, -9.81}, [&](PileUp& s) {
    s.add(car, 0, 0, 0, 0);
    CrashCar& above = s.add(car, 0, 0, 0, 0);
    above.motion.pose.orientation = Eigen::AngleAxisd(pi, Vector3d::UnitX());
    above.motion.pose.position.z() = 2 * size.top + 0.01;
    above.mass.planar = false;
  });
}

struct Tally {
  int crashes = 0, lost = 0, created = 0, kinetic = 0, undone = 0, inside = 0;
  double least = 1, most = 1, worst_momentum = 0, seconds = 0;
};

void play_random(const CarPointer& car, const Options& options) {
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
  CLI::App app{
      "Plays cars that hit each other, and prints what they keep and what an equal wall would give: tables in Markdown, of\n"
      "scenes and of what is asked beside what is measured. Takes a minute for each thousand nodes; random crashes 0.1 s "
      "each."};
  Options options;
  app.add_option("car", options.cars, "baked cars")->required()->check(CLI::ExistingFile);
  app.add_option("--kmh", options.kmh, "speed of each moving car")->check(CLI::Range(1.0, 200.0))->capture_default_str();
  app.add_option("--sweeps", options.sweeps,
                 "in the scenes: exactly so many sweeps a sub-step (default: 24 at most, by tolerance)")
      ->check(CLI::Range(2, 1000));
  app.add_option("--substeps", options.substeps, "in the scenes: sub-steps in 1/60 s (default: 4)")->check(CLI::Range(1, 64));
  app.add_option("--scene", options.scene, "only scenes whose name contains this");
  app.add_option("--random", options.random, "instead plays so many random crashes")->check(CLI::Range(1, 1000000));
  app.add_option("--first", options.first, "seed of the first random crash; the next has the next")
      ->check(CLI::Range(0, 1000000));
  app.add_option("--rest", options.rest, "instead lets a car lean and lie on another for so many ticks")
      ->check(CLI::Range(301, 100000000));
  app.add_option("--threads", options.threads, "threads of the solver")->check(CLI::Range(1, 64))->capture_default_str();
  CLI11_PARSE(app, count, argument);
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, size_t(options.threads));
  Span crushes;
  for (const std::string& file : options.cars) {
    const CarPointer car = load_car(file);
    if (options.random > 0)
      play_random(car, options);
    else if (options.rest > 0)
      play_rest(car, options);
    else
      crushes.add(play_car(car, options));
  }
  if (options.cars.size() > 1 && options.random + options.rest == 0 && options.scene.empty())
    std::printf("\nCrush of all these cars head-on: %.1f to %.1f mm (%.1f %%; goal for meshes of one car: 5 %%).\n",
                1e3 * crushes.low, 1e3 * crushes.high, 100 * crushes.wide() / crushes.high);
}

// The hostile starts of the stability matrix. A Run is one car with one method; a Scene is played with it.
// in: a baked car and a seed; out: the scenes for each method. No scene knows the method, and a seed gives the same scene for
// all methods.
#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "car/car.h"
#include "reference/baselines.h"
#include "sim/deform.h"

namespace crumple {

inline constexpr double tick_seconds = 1.0 / 60;
inline constexpr double exploded_distance = 10;  // m from rest: a server loads no such state
inline constexpr int recovery_ticks = 180;       // 3 s at 60 Hz

struct Random {
  std::mt19937_64 engine;
  double uniform(double low, double high) { return low + (high - low) * (double(engine() >> 11) * 0x1p-53); }
  double logarithmic(double low, double high) { return low * std::pow(high / low, uniform(0, 1)); }
  bool chance(double share) { return uniform(0, 1) < share; }
  Vec3 in(const Vec3& low, const Vec3& high) {
    Vec3 out;
    for (int i = 0; i < 3; ++i) out[i] = float(uniform(low[i], high[i]));
    return out;
  }
};

struct Method {
  const char* name;
  std::optional<Baseline> baseline;  // empty: deform(), as the server runs it
  Solver solver = Solver::nodal;
};
inline constexpr Method methods[] = {
    {"nodal", {}, Solver::nodal},
    {"classic", {}, Solver::classic},
    {"coloured", Baseline::coloured},
    {"averaged jacobi", Baseline::averaged_jacobi},
    {"relaxed jacobi", Baseline::relaxed_jacobi},
    {"naive jacobi", Baseline::naive_jacobi},
    {"xpbd", Baseline::xpbd},
};

struct Box {
  Vec3 low, high;
  explicit Box(std::span<const Vec3> points) : low(points[0]), high(points[0]) {
    for (const Vec3& point : points) {
      low = low.cwiseMin(point);
      high = high.cwiseMax(point);
    }
  }
  Vec3 center() const { return 0.5f * (low + high); }
  Vec3 size() const { return high - low; }
};

inline bool finite(const DeformableState& body) {
  return std::all_of(body.node.begin(), body.node.end(), [](const Vec3& node) { return node.allFinite(); });
}

// One car with one method. The car follows its path exactly unless the scene sets a mass.
struct Run {
  std::shared_ptr<const Car> car;
  const Model& model;
  const Structure structure;
  Method method;
  Parameters parameters;
  Random random;
  Mass mass;
  DeformableState body;
  Motion motion;
  std::vector<Obstacle> obstacles;
  std::vector<Vec3> goal;  // the places where the nodes should end
  double limit = 0;        // m, rms: largest accepted distance from the goal; 0: recovered_share of the diagonal
  bool passed = false;     // an obstacle went through the car
  bool exploded = false;   // a node was farther from rest than the scene can explain
  bool poisoned = false;   // a node is not finite at the start: deform() must undo ticks to recover
  int ticks = 0, undone = 0;
  bool lost = false;  // a node is no longer finite: no further ticks are made
  ScratchHandle scratch = make_scratch();
  const Box box;

  Run(std::shared_ptr<const Car> which, const Method& by, const Parameters& with, uint64_t seed)
      : car(std::move(which)),
        model(car->model),
        structure(build_structure(model)),
        method(by),
        parameters(with),
        random{std::mt19937_64(seed)},
        body(make_body(model)),
        goal(body.node),
        box(model.node) {
    parameters.solver = method.solver;
    mass.center = model.center_of_mass.cast<double>();
    mass.mass = std::numeric_limits<double>::infinity();
    mass.inertia.setConstant(mass.mass);
  }

  void tick(double seconds = tick_seconds) {
    if (lost) return;
    if (method.baseline) {
      deform_baseline(*method.baseline, model, structure, parameters, mass, obstacles, seconds, body, motion);
    } else {
      undone += deform({model, parameters, mass, obstacles, seconds}, *scratch, body, motion).recovered;
    }
    for (Obstacle& each : obstacles) each.pose = advance(each.pose, each.velocity, each.angular_velocity, seconds);
    ++ticks;
    lost = method.baseline && !finite(body);
  }
  void run(int count, double seconds = tick_seconds) {
    for (int k = 0; k < count; ++k) tick(seconds);
  }
  double farthest() const {  // largest distance of a node from rest, m
    float most = 0;
    for (size_t i = 0; i < body.node.size(); ++i) most = std::max(most, (body.node[i] - model.node[i]).norm());
    return double(most);
  }
  // Removes the obstacles and ticks until nothing has moved for three ticks.
  void release(int most = recovery_ticks, double seconds = tick_seconds) {
    obstacles.clear();
    for (int k = 0, still = 0; k < most && still < 3; ++k) {
      tick(seconds);
      still = body.settled ? still + 1 : 0;
    }
  }
  // Moves every free node; anchored nodes stay on the pose.
  template <class Place>
  void displace(const Place& place) {
    for (size_t i = 0; i < body.node.size(); ++i) {
      if (!model.node_anchored[i]) body.node[i] = place(body.node[i]);
      body.step[i].setZero();
    }
    body.settled = false;
    measure_reach(model, body);
  }
  Obstacle& wall(double depth) {  // a wall across the nose, 1 m thick, which reaches `depth` into it
    Obstacle& added = obstacles.emplace_back();
    make_box({0.5f, 5, 5}, added);
    added.pose.position = {box.high.x() + 0.5 - depth, 0, 0};
    return added;
  }
  // A wall goes `depth` into the nose in a third of a second and comes back.
  void push_in(double depth) {
    Obstacle& added = wall(0);
    added.velocity = {-3 * depth, 0, 0};
    run(20);
    added.velocity = {6 * depth, 0, 0};
    run(10);
    release();
  }
  // Dents the car. From now on this shape is the goal.
  void dent() {
    push_in(0.15);
    goal = body.node;
  }
};

struct Scene {
  std::string name;
  Parameters parameters;
  std::function<void(Run&)> play;
  std::shared_ptr<const Car> car;  // null: the car on the command line
  bool ours = false;               // only for the server's solvers: the baselines would take an hour
};

// quick: 20 random scenes and 1,000 ticks of rubbing instead of 1,000 and 1,000,000 (baselines: 100 and 10,000).
std::vector<Scene> hostile_scenes(const Car&, uint64_t seed, bool quick);

}  // namespace crumple

// Simulates the box car of the tests among obstacles, tick by tick.
#pragma once

#include <cmath>
#include <limits>

#include "box_car.h"
#include "sim/deform.h"

namespace crumple {

constexpr double tick_seconds = 1.0 / 60;

// A car that drives along x into obstacles.
struct Crash {
  std::shared_ptr<const Car> car;
  const Model& model = car->model;
  Parameters parameters;
  Mass mass;
  DeformableState body = make_body(model);
  Motion motion;
  std::vector<Obstacle> obstacles;
  ScratchHandle scratch = make_scratch();
  StepResult total;  // with the sums of the impulses
  double front = 0;

  explicit Crash(std::shared_ptr<const Car> given = box_car()) : car(std::move(given)) {
    mass.mass = model.mass;
    mass.center = model.center_of_mass.cast<double>();
    mass.inertia = model.inertia.cast<double>();
    for (const Vec3& node : model.node) front = std::max(front, double(node.x()));
  }
  void scripted() {
    mass.mass = std::numeric_limits<double>::infinity();
    mass.inertia.setConstant(mass.mass);
  }
  Obstacle& wall(double gap = 0.05) {
    Obstacle wall;
    make_box({0.5f, 5, 5}, wall);
    wall.pose.position = {front + 0.5 + gap, 0, 0};
    return obstacles.emplace_back(wall);
  }
  StepResult tick(double seconds = tick_seconds) {
    const StepResult result = deform({model, parameters, mass, obstacles, seconds}, *scratch, body, motion);
    for (Obstacle& each : obstacles) each.pose = advance(each.pose, each.velocity, each.angular_velocity, seconds);
    total.impulse += result.impulse;
    total.angular_impulse += result.angular_impulse;
    total.substeps += result.substeps;
    total.deepest = std::max(total.deepest, result.deepest);
    return result;
  }
  void run(double seconds, double rate = 60) {
    for (int k = 0; k < int(std::lround(seconds * rate)); ++k) tick(1 / rate);
  }
  double crush() const {
    double most = 0;
    for (size_t i = 0; i < body.node.size(); ++i) most = std::max(most, double((model.node[i] - body.node[i]).x()));
    return most;
  }
  float farthest() const {  // largest distance of a node from rest, m
    float most = 0;
    for (size_t i = 0; i < body.node.size(); ++i) most = std::max(most, (body.node[i] - model.node[i]).norm());
    return most;
  }
  double energy() const { return kinetic_energy(motion, mass) + body.absorbed + body.stored; }
};

}  // namespace crumple

// Scenes of several cars for tests and benchmarks: drives cars at one another, tick by tick, as one island.
#pragma once

#include <memory>
#include <vector>

#include "car/car.h"
#include "sim/deform.h"

namespace crumple {

struct CrashCar {
  std::shared_ptr<const Car> car;
  Parameters parameters;
  Mass mass;
  DeformableState body;
  Motion motion;
  Eigen::Vector3d pull = Eigen::Vector3d::Zero();  // acceleration by other forces than contacts, m/s^2
  ScratchHandle scratch;
  StepResult last;                                    // of the last tick
  Eigen::Vector3d impulse = Eigen::Vector3d::Zero();  // of all ticks, N s
  double peak = 0;                                    // largest impulse of a tick divided by its length, N
  double sweeps = 0, substeps = 0;                    // of all ticks

  // Mean way of the nodes that lie farthest in front at rest towards the car's back, m: the crush of its nose.
  double nose_crush() const;
  double largest_displacement() const;  // of a node, m
};

struct PileUp {
  std::vector<CrashCar> cars;
  std::vector<Obstacle> obstacles;

  // A car of its baked mass whose centre of mass stands at (x, y); it drives forward at `speed`, m/s. heading: about z,
  // radians.
  CrashCar& add(std::shared_ptr<const Car>, double x, double y, double heading, double speed);
  void tick(double seconds = 1.0 / 60);
  void run(double seconds, double rate = 60);

  Eigen::Vector3d momentum() const;          // N s, world
  Eigen::Vector3d angular_momentum() const;  // N m s, about the world's origin
  double kinetic() const;                    // J
  double energy() const;                     // kinetic, absorbed and stored, J
};

// How far one car's boundary is inside another's, m: its nodes, and the middles of its triangles and edges too.
struct Overlap {
  double node = 0, any = 0;
  int nodes = 0;  // how many are inside
};
Overlap measure_overlap(const CrashCar&, const CrashCar&);

// A crash of two cars of random mass (a tenth to ten times the car's), stiffness (half to three times), pose, speed and, in
// every fourth, spin.
PileUp random_crash(const std::shared_ptr<const Car>&, uint32_t seed);

}  // namespace crumple

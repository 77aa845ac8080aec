// One tick of one car: what it reads, what it changes, and what came of it. Memory that does not outlast it: scratch.h.
#pragma once

#include <span>

#include "sim/body.h"
#include "sim/material.h"
#include "sim/motion.h"
#include "sim/obstacle.h"

namespace crumple {

// Read only. The obstacles stand at their poses at the start of the tick and move steadily.
struct StepInput {
  const Model& model;
  const Parameters& parameters;
  const Mass& mass;
  std::span<const Obstacle> obstacles;
  double seconds;  // of the tick
};

// What the tick did to the rigid motion. World axes; about the centre of mass.
struct StepResult {
  Eigen::Vector3d impulse = Eigen::Vector3d::Zero();          // N s
  Eigen::Vector3d angular_impulse = Eigen::Vector3d::Zero();  // N m s
  float deepest = 0;                                          // the farthest that an obstacle pushed a node, m
  uint32_t contacts = 0;                                      // nodes held at the end
  uint32_t substeps = 0;                                      // solved; 0: nothing was near and the body was settled
  uint32_t sweeps = 0;                                        // of all sub-steps together
  uint64_t work = 0;                                          // tets visited by sweeps
  float residual = 0;             // what the last sweeps of a sub-step moved, rms over awake nodes, the largest, m
  bool contact_overflow = false;  // a node met more than contacts_per_node obstacles: the deepest were kept
  bool recovered = false;         // the tick ended non-finite and was undone: the body stands as before it
};

// What a tick changes.
struct StepState {
  DeformableState& body;
  Motion& motion;
  StepResult result = {};
  double spring = 0;  // J that the body should store by what the motion gave it (energy_balance.h)
};

// A part of the tick.
struct Substep {
  double start, seconds;  // within the tick
  float last;             // seconds of the sub-step before, for the predictor
};

}  // namespace crumple

// One tick of one car: its inputs, the state that it changes, and its result. Memory used only within the tick is in scratch.h.
#pragma once

#include <algorithm>
#include <span>
#include <vector>

#include "sim/body.h"
#include "sim/material.h"
#include "sim/motion.h"
#include "sim/obstacle.h"

namespace crumple {

// Read only. The obstacles stand at their poses of the start of the tick and move steadily.
struct StepInput {
  const Model& model;
  const Parameters& parameters;
  const Mass& mass;
  std::span<const Obstacle> obstacles;
  double seconds;  // length of the tick
  // m/s^2: acceleration by the host's own forces, such as weight. The velocity at the start already contains its effect over
  // the whole tick; the tick spreads this effect over its sub-steps. Otherwise every tick would throw a car that lies on
  // something against it, and the car would hop.
  Eigen::Vector3d pull = Eigen::Vector3d::Zero();
};

// The effect of another car on this one in the tick.
struct PartnerResult {
  uint64_t key;                                       // Member::key of the other car
  Eigen::Vector3d impulse = Eigen::Vector3d::Zero();  // N s, world axes; the other car got the opposite
  uint32_t contacts = 0;                              // between the two at the end of the tick
};

// The effect of the tick on the rigid motion. World axes; angular impulse about the centre of mass.
struct StepResult {
  Eigen::Vector3d impulse = Eigen::Vector3d::Zero();          // N s
  Eigen::Vector3d angular_impulse = Eigen::Vector3d::Zero();  // N m s
  float deepest = 0;                                          // deepest push of an obstacle or a car into this car, m
  uint32_t contacts = 0;                                      // nodes held at the end of the tick
  uint32_t substeps = 0;                                      // solved sub-steps; 0: nothing was near and the body was settled
  uint32_t sweeps = 0;                                        // in all sub-steps together
  uint64_t work = 0;                                          // tets visited by sweeps
  float residual = 0;                        // rms way of the awake nodes in the last sweeps, m; largest of all sub-steps
  bool contact_overflow = false;             // a node met more than contacts_per_node planes: the deepest were kept
  uint32_t lost = 0;                         // tets that have lost their shape in a sub-step; most of all sub-steps
  bool recovered = false;                    // the tick ended with a number that is not finite and was undone
  std::vector<PartnerResult> partners = {};  // cars that touched this one, ascending by key
};

// The state that a tick changes.
struct StepState {
  DeformableState& body;
  Motion& motion;
  StepResult result = {};
  double spring = 0;  // energy that the body should store, by the energy that the motion gave it, J (energy_balance.h)
};

// The entry of a car in a list that is sorted by key; adds it if there is none.
inline PartnerResult& result_of(uint64_t key, std::vector<PartnerResult>& partners) {
  auto at = std::lower_bound(partners.begin(), partners.end(), key,
                             [](const PartnerResult& each, uint64_t wanted) { return each.key < wanted; });
  if (at == partners.end() || at->key != key) at = partners.insert(at, PartnerResult{key});
  return *at;
}

// A part of the tick.
struct Substep {
  double start, seconds;  // within the tick
};

}  // namespace crumple

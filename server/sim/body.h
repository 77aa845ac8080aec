// What one car keeps between ticks, and nothing else: its hash decides whether two runs are the same.
#pragma once

#include <string>
#include <vector>

#include "sim/anderson.h"
#include "sim/material.h"
#include "sim/model.h"
#include "sim/motion.h"

namespace crumple {

struct Body {
  std::vector<Vec3> node;            // positions, car's frame, m
  std::vector<Vec3> step;            // displacement of the last sub-step, m: the predictor's history
  float step_seconds = 0;            // that it took; 0: none was made yet
  std::vector<Gradients> gradients;  // per tet: rest gradients after plastic flow, 1/m
  std::vector<float> hardening;      // per tet: accumulated plastic strain
  std::vector<float> edge_rest;      // rest lengths of `classic`, m
  std::vector<float> tet_rest;       // rest volumes of `classic`, m^3
  AndersonHistory history;           // of the solver's last steps; empty when settled
  double absorbed = 0;               // J since spawn: plastic work, drag, friction
  double stored = 0;                 // J: elastic, now
  double owed = 0;                   // J of it that the motion did not give: the body may not return them
  // Of the nodes (measure_reach): the farthest from the centre of mass, and the box around them in the car's frame; m.
  float reach = 0;
  Vec3 low = Vec3::Zero(), high = Vec3::Zero();
  // Of the contacts on the car at the end of the last sub-step, N and N m about the centre of mass, world axes.
  Eigen::Vector3d force = Eigen::Vector3d::Zero();
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();
  bool touching = false;  // some node was held by an obstacle in the last sub-step
  float drift = 0;        // way of the obstacles along a settled body since it settled, m
  bool lost = false;      // its shape is one that no crash makes: it springs back before anything flows
  bool settled = true;    // nothing moved in the last sub-step: costs nothing until touched
};

// An undamaged car.
Body make_body(const Model&);

// Takes `amount` of the damage away: 1 gives the undamaged car, bit for bit.
void repair(const Model&, float amount, Body&);

// After nodes moved.
void measure_reach(const Model&, Body&);

// Why these arrays cannot be the state of this car (sizes, non-finite values, or nodes farther than 10 m from rest).
[[nodiscard]] std::optional<std::string> refuse_state(const Model&, const Body&);

// XXH64 over everything in the body.
uint64_t hash(const Body&);

}  // namespace crumple

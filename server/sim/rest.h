// Bodies at rest cost nothing. This file says when a body settles, what it does while settled, and what wakes it.
#pragma once

#include <span>

#include "sim/contacts.h"
#include "sim/pairs.h"
#include "sim/step.h"

namespace crumple {

// m/s: a slower node is at rest. A block whose nodes are all at rest is not solved, nor is a body whose nodes are all at rest.
inline constexpr float settle_speed = 2e-3f;

// After a sub-step of h seconds: stores each node's displacement from `before`, and whether the body is at rest.
void settle(float h, std::span<const Vec3> before, DeformableState&);

// The obstacles and cars that touch a settled body in a sub-step.
struct Met {
  bool any = false;
  float deepest = 0;  // how deep an obstacle or a car enters it, m
  float moved = 0;    // how far they move along it, m

  void add(const Contact&, const DeformableState&);
  void add(const PairContact&);
};

// Whether something wakes a settled body: it enters the body, or what the body rests against moves along it or leaves. h:
// length of the sub-step, s. drift: how far that has slid since the body settled, m; this call adds to it.
[[nodiscard]] bool is_woken(double h, const Met&, const DeformableState&, float& drift);

// One sub-step of a body that stays at rest: what it rests against keeps pressing with the same force.
void stay_at_rest(const StepInput&, const Substep&, StepState&);

// Finds the anchored nodes that nothing touches any more. Those farther than anchor_slack (m) from their rest positions go to
// contacts.loose: their springs bring them back. The others are put back, and all are if the body has lost its shape. Putting
// all back at once would stretch the crushed tets around them by force, with energy that nothing gave.
inline constexpr float anchor_slack = 2e-4f;
void hold_anchors(const Model&, const PairIndex*, ContactSet&, DeformableState&);

}  // namespace crumple

// Bodies that have come to rest cost nothing: how they settle, what they do meanwhile, and what wakes them.
#pragma once

#include <span>

#include "sim/contacts.h"
#include "sim/step.h"

namespace crumple {

// m/s: a node that is slower is at rest, and its block is not solved; nor is a body all of whose nodes are.
inline constexpr float settle_speed = 2e-3f;

// After a sub-step of h seconds that began with the nodes at `before`: their displacements, and whether the body is at rest.
void settle(float h, std::span<const Vec3> before, DeformableState&);

// A settled body wakes when an obstacle enters it, and when the one that it rests against has moved on or leaves. h: of the
// sub-step, s. drift: way of the obstacles along it since it settled, m; counted on.
[[nodiscard]] bool is_woken(double h, std::span<const Contact>, const DeformableState&, float& drift);

// A sub-step of a body that stays at rest: the obstacle that it rests against goes on pressing it with the same force.
void stay_at_rest(const StepInput&, const Substep&, StepState&);

// Anchored nodes that nothing touches stand where they were baked.
void hold_anchors(const Model&, const ContactSet&, DeformableState&);

}  // namespace crumple

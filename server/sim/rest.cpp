#include "sim/rest.h"

#include <algorithm>

namespace crumple {

// m: an obstacle this deep in a settled body wakes it, and so does one that has slid this far along it.
constexpr float wake_depth = 1e-4f;

void settle(float h, std::span<const Vec3> before, DeformableState& body) {
  float most = 0;
  for (size_t i = 0; i < body.node.size(); ++i) {
    body.step[i] = body.node[i] - before[i];
    most = std::max(most, body.step[i].squaredNorm());
  }
  body.settled = most <= settle_speed * settle_speed * h * h;
  body.step_seconds = h;
  body.drift = 0;
}

void Met::add(const Contact& c, const DeformableState& body) {
  any = true;
  deepest = std::max(deepest, -c.after);
  moved = std::max(moved, (c.carried - body.node[c.node]).norm());
}

void Met::add(const PairContact& c) {
  any = true;
  deepest = std::max(deepest, -c.after);
  moved = std::max(moved, c.motion);
}

bool is_woken(double h, const Met& met, const DeformableState& body, float& drift) {
  if (!body.touching) return met.deepest > wake_depth;
  if (!met.any) return true;
  if (double(met.moved) > double(settle_speed) * h) drift += met.moved;
  return drift > wake_depth;
}

void stay_at_rest(const StepInput& input, const Substep& now, StepState& state) {
  auto& [body, motion, result, spring] = state;
  if (!body.touching) {
    body.force.setZero();
    body.moment.setZero();
    body.pairs.push.clear();
    return;
  }
  push(now.seconds * body.force, now.seconds * body.moment, input.mass, motion);
  result.impulse += now.seconds * body.force;
  result.angular_impulse += now.seconds * body.moment;
  for (const auto& [partner, force] : body.pairs.push) result_of(partner, result.partners).impulse += now.seconds * force;
}

void hold_anchors(const Model& model, const PairIndex* pairs, ContactSet& contacts, DeformableState& body) {
  contacts.loose.clear();
  for (size_t i = 0; i < body.node.size(); ++i) {
    if (!model.node_anchored[i] || contacts.holds(i) || (pairs && pairs->holds(i))) continue;
    if (!body.lost && (body.node[i] - model.node[i]).norm() > anchor_slack) {
      contacts.loose.push_back(uint32_t(i));
      continue;
    }
    body.node[i] = model.node[i];
    body.step[i].setZero();
  }
}

}  // namespace crumple

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

bool is_woken(double h, std::span<const Contact> contacts, const DeformableState& body, float& drift) {
  if (!body.touching) {
    return std::any_of(contacts.begin(), contacts.end(), [](const Contact& c) { return c.after < -wake_depth; });
  }
  if (contacts.empty()) return true;
  float most = 0;
  for (const Contact& c : contacts) most = std::max(most, (c.carried - body.node[c.node]).norm());
  if (double(most) > double(settle_speed) * h) drift += most;
  return drift > wake_depth;
}

void stay_at_rest(const StepInput& input, const Substep& now, StepState& state) {
  auto& [body, motion, result, spring] = state;
  if (!body.touching) {
    body.force.setZero();
    body.moment.setZero();
    return;
  }
  push(now.seconds * body.force, now.seconds * body.moment, input.mass, motion);
  result.impulse += now.seconds * body.force;
  result.angular_impulse += now.seconds * body.moment;
}

void hold_anchors(const Model& model, const ContactSet& contacts, DeformableState& body) {
  for (size_t i = 0; i < body.node.size(); ++i) {
    if (model.node_anchored[i] && !contacts.holds(i)) {
      body.node[i] = model.node[i];
      body.step[i].setZero();
    }
  }
}

}  // namespace crumple

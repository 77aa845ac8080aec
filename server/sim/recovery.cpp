#include "sim/recovery.h"

#include <cmath>
#include <utility>

#include "sim/flow.h"

namespace crumple {
namespace {

constexpr float flat = 0.02f;     // share of a tet's volume left: below it no shape is a sound one at rest
constexpr float reverted = 0.1f;  // of the flow around an inverted tet, a tick

// A body that holds numbers that are not finite has lost its shape there: those nodes and tets are as baked again.
void reset_non_finite(const Model& model, Body& body) {
  for (size_t i = 0; i < body.node.size(); ++i) {
    if (body.node[i].allFinite() && body.step[i].allFinite()) continue;
    body.node[i] = model.node[i];
    body.step[i].setZero();
  }
  for (size_t t = 0; t < body.gradients.size(); ++t) {
    bool sound = std::isfinite(body.hardening[t]);
    for (const Vec3& corner : body.gradients[t].corner) sound = sound && corner.allFinite();
    if (sound) continue;
    body.gradients[t] = model.gradients[t];
    body.hardening[t] = 0;
  }
  for (size_t e = 0; e < body.edge_rest.size(); ++e) {
    if (!std::isfinite(body.edge_rest[e])) body.edge_rest[e] = model.edge_rest[e];
  }
  for (size_t t = 0; t < body.tet_rest.size(); ++t) {
    if (!std::isfinite(body.tet_rest[t])) body.tet_rest[t] = model.tet_rest[t];
  }
  if (!std::isfinite(body.absorbed)) body.absorbed = 0;
  if (!std::isfinite(body.stored)) body.stored = 0;
  if (!std::isfinite(body.owed)) body.owed = 0;
  if (!body.force.allFinite() || !body.moment.allFinite()) body.force.setZero(), body.moment.setZero();
  measure_reach(model, body);
}

}  // namespace

void back_up(Body& body, Backup& backup) {
  AndersonHistory history = std::exchange(body.history, {});
  backup.body = body;
  body.history = std::move(history);
  backup.taken = true;
}

bool is_finite(const Body& body, const Motion& motion) {
  bool all = motion.pose.position.allFinite() && motion.velocity.allFinite() && motion.angular_velocity.allFinite();
  for (const Vec3& node : body.node) all = all && node.allFinite();
  return all && std::isfinite(body.absorbed) && std::isfinite(body.stored) && std::isfinite(body.owed);
}

void restore(const Model& model, const Motion& begin, Backup& backup, Body& body, Motion& motion) {
  std::swap(body, backup.body);
  reset_non_finite(model, body);
  motion = begin;
  motion.velocity.setZero();
  motion.angular_velocity.setZero();
}

bool revert_inverted(const Model& model, Body& body) {
  bool any = false, inverted = false;
  const auto take_back = [&](uint32_t tet) {
    float& kappa = body.hardening[tet];
    if (kappa == 0) return;
    any = true;
    const float taken = kappa > 1e-3f ? reverted : 1;
    kappa -= taken * kappa;
    for (int k = 0; k < 3; ++k) {
      Vec3& gradient = body.gradients[tet].corner[k];
      gradient += taken * (model.gradients[tet].corner[k] - gradient);
    }
  };
  for (size_t t = 0; t < model.tet.size(); ++t) {
    const uint32_t* n = model.tet[t].node;
    const Mat3 f = deformation(body.node[n[0]], body.node[n[1]], body.node[n[2]], body.node[n[3]], body.gradients[t]);
    if (f.determinant() > flat) continue;
    inverted = true;
    for (uint32_t node : model.tet[t].node) {
      for (uint32_t k = model.node_first[node]; k < model.node_first[node + 1]; ++k) take_back(model.corner[k] / 4);
    }
  }
  if (inverted && !any) {
    for (uint32_t tet = 0; tet < model.tet.size(); ++tet) take_back(tet);
  }
  return any;
}

}  // namespace crumple

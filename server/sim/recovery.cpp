#include "sim/recovery.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sim/flow.h"

namespace crumple {
namespace {

constexpr float flat = 0.02f;     // share of a tet's volume left: a tet with less is not sound at rest
constexpr float reverted = 0.1f;  // share of the flow around an inverted tet that is reverted per tick

bool is_finite(float number) { return std::isfinite(number); }
bool is_finite(const Vec3& v) { return v.allFinite(); }
bool is_finite(const Gradients& g) {
  return std::all_of(g.corner, g.corner + 3, [](const Vec3& v) { return v.allFinite(); });
}

void reset_non_finite(bool&) {}
void reset_non_finite(AndersonHistory&) {}  // a backup has none
void reset_non_finite(PairMemory& memory) { memory = {}; }
void reset_non_finite(Eigen::Vector3d& v) {
  if (!v.allFinite()) v.setZero();
}
template <class Number>
void reset_non_finite(Number& number) {
  if (!std::isfinite(number)) number = 0;
}

// A node, tet or edge with a number that is not finite gets its baked value in all its fields.
void reset_non_finite(const Model& model, Per per, DeformableState& body) {
  std::vector<uint8_t> broken(count_of(model, per), 0);
  const auto for_each_list = [&](const auto& visit) {
    for_each_field([&](const auto& field) {
      if constexpr (IsList<decltype(field)>) {
        if (field.per == per) visit(field, body.*field.value);
      }
    });
  };
  for_each_list([&](const auto&, const auto& list) {
    for (size_t i = 0; i < list.size(); ++i) broken[i] |= !is_finite(list[i]);
  });
  for_each_list([&](const auto& field, auto& list) {
    for (size_t i = 0; i < list.size(); ++i) {
      if (broken[i]) list[i] = rest_of(model, field, i);
    }
  });
}

void reset_non_finite(const Model& model, DeformableState& body) {
  for (const Per per : {Per::node, Per::tet, Per::edge}) reset_non_finite(model, per, body);
  for_each_field([&](const auto& field) {
    if constexpr (!IsList<decltype(field)>) reset_non_finite(body.*field.value);
  });
  measure_reach(model, body);
}

}  // namespace

void back_up(DeformableState& body, Backup& backup) {
  AndersonHistory history = std::exchange(body.history, {});
  backup.body = body;
  body.history = std::move(history);
  backup.taken = true;
}

bool is_finite(const DeformableState& body, const Motion& motion) {
  bool all = motion.pose.position.allFinite() && motion.velocity.allFinite() && motion.angular_velocity.allFinite();
  for (const Vec3& node : body.node) all = all && node.allFinite();
  for (const PairMemory::Touch& touch : body.pairs.touch) {
    all = all && touch.normal.allFinite() && std::isfinite(touch.pressure) && touch.friction.allFinite();
  }
  for (const PairMemory::Push& push : body.pairs.push) all = all && push.force.allFinite();
  return all && std::isfinite(body.absorbed) && std::isfinite(body.stored) && std::isfinite(body.owed);
}

void restore(const Model& model, const Motion& begin, Backup& backup, DeformableState& body, Motion& motion) {
  std::swap(body, backup.body);
  reset_non_finite(model, body);
  motion = begin;
  motion.velocity.setZero();
  motion.angular_velocity.setZero();
}

bool revert_inverted(const Model& model, DeformableState& body) {
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

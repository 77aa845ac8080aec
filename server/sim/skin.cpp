#include "sim/skin.h"

namespace crumple {
namespace {

Vec3 displacement_of(const Model& model, const DeformableState& body, const Skin& skin) {
  Vec3 sum = Vec3::Zero();
  for (int k = 0; k < 4; ++k) sum += skin.weight[k] * (body.node[skin.node[k]] - model.node[skin.node[k]]);
  return sum;
}

}  // namespace

void skin(const Model& model, const DeformableState& body, std::span<Vec3> vertex) {
  for (size_t v = 0; v < vertex.size(); ++v) vertex[v] = model.vertex[v] + displacement_of(model, body, model.skin[v]);
}

void displace(const Model& model, const DeformableState& body, std::span<const uint32_t> nodes, std::span<Vec3> out) {
  for (size_t i = 0; i < nodes.size(); ++i) out[i] = body.node[nodes[i]] - model.node[nodes[i]];
}

void displace(const Model& model, const LevelMap& to, const DeformableState& body, std::span<const uint32_t> nodes,
              std::span<Vec3> out) {
  std::vector<Vec3> moved(body.node.size());  // computed once, because some ten nodes of the other mesh use each
  for (size_t i = 0; i < moved.size(); ++i) moved[i] = body.node[i] - model.node[i];
  for (size_t i = 0; i < nodes.size(); ++i) {
    const Skin& skin = to.node[nodes[i]];
    out[i] = Vec3::Zero();
    for (int k = 0; k < 4; ++k) out[i] += skin.weight[k] * moved[skin.node[k]];
  }
}

}  // namespace crumple

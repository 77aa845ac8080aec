#include "sim/classic.h"

#include <Eigen/Geometry>

namespace crumple {

EdgeCorrection distance_correction(const Vec3& a, const Vec3& b, float rest) {
  const Vec3 across = b - a;
  const float length = across.norm();
  if (length < 1e-9f) return {Vec3::Zero(), Vec3::Zero()};  // no direction to correct in
  const Vec3 half = (0.5f * (length - rest) / length) * across;
  return {half, -half};
}

float signed_volume(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) { return (b - a).cross(c - a).dot(d - a) / 6; }

TetCorrection volume_correction(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, float rest) {
  const Vec3 direction[4] = {(d - b).cross(d - c), (c - a).cross(a - d), (d - a).cross(a - b), (a - b).cross(c - a)};
  float sum = 0;
  for (const Vec3& each : direction) sum += each.squaredNorm();
  if (sum < 1e-24f) return {{Vec3::Zero(), Vec3::Zero(), Vec3::Zero(), Vec3::Zero()}};
  const float scale = (signed_volume(a, b, c, d) - rest) / sum;
  return {{scale * direction[0], scale * direction[1], scale * direction[2], scale * direction[3]}};
}

void solve_classic(const Model& model, const Parameters& parameters, std::span<const Contact> contacts, DeformableState& body) {
  for (const Contact& contact : contacts) {
    if (model.node_anchored[contact.node]) continue;
    Vec3& node = body.node[contact.node];
    node += std::max(0.0f, contact.offset - contact.normal.dot(node)) * contact.normal;
  }
  const auto move = [&](uint32_t node, const Vec3& correction) {
    if (!model.node_anchored[node]) body.node[node] += correction;
  };
  for (int iteration = 0; iteration < parameters.iterations; ++iteration) {
    for (size_t e = 0; e < model.edge.size(); ++e) {
      const auto [a, b] = model.edge[e].node;
      const Material& material = parameters.region[model.node_region[a]];
      const EdgeCorrection correction = distance_correction(body.node[a], body.node[b], body.edge_rest[e]);
      if (iteration == 0) {
        const float now = (body.node[b] - body.node[a]).norm();
        body.edge_rest[e] = body.edge_rest[e] * material.plasticity + (1 - material.plasticity) * now;
      }
      move(a, material.distance_stiffness * correction.a);
      move(b, material.distance_stiffness * correction.b);
    }
    for (size_t t = 0; t < model.tet.size(); ++t) {
      const uint32_t* n = model.tet[t].node;
      const Material& material = parameters.region[model.tet_region[t]];
      const Vec3 &a = body.node[n[0]], &b = body.node[n[1]], &c = body.node[n[2]], &d = body.node[n[3]];
      const TetCorrection correction = volume_correction(a, b, c, d, body.tet_rest[t]);
      if (iteration == 0) {
        body.tet_rest[t] = body.tet_rest[t] * material.plasticity + (1 - material.plasticity) * signed_volume(a, b, c, d);
      }
      for (int k = 0; k < 4; ++k) move(n[k], material.volume_stiffness * correction.node[k]);
    }
  }
}

}  // namespace crumple

#include "sim/transfer.h"

#include <Eigen/Dense>

#include "sim/flow.h"

namespace crumple {
namespace {

constexpr double sound = 0.02;  // smallest determinant of a sound shape, as in flow.h

using Matrix = Eigen::Matrix3d;

// Row k: the gradient of corner k + 1.
Matrix rows(const Gradients& gradients) {
  Matrix out;
  for (int k = 0; k < 3; ++k) out.row(k) = gradients.corner[k].cast<double>().transpose();
  return out;
}

Matrix shape(const Tet& tet, const std::vector<Vec3>& node, const Gradients& gradients) {
  const uint32_t* n = tet.node;
  return deformation(node[n[0]], node[n[1]], node[n[2]], node[n[3]], gradients).cast<double>();
}

}  // namespace

DeformableState transfer(const Model& from, const Model& to, const LevelMap& map, const DeformableState& body) {
  DeformableState out = make_body(to);
  for (size_t i = 0; i < out.node.size(); ++i) {
    if (to.node_anchored[i]) continue;
    const Skin& s = map.node[i];
    for (int k = 0; k < 4; ++k) out.node[i] += s.weight[k] * (body.node[s.node[k]] - from.node[s.node[k]]);
  }
  // F is the whole deformation and F_p its plastic part: gradients = rest gradients * F_p^-1, and F F_p^-1 carries the stress.
  // The new tet has its own F; this computes its F_p from it.
  for (size_t t = 0; t < out.gradients.size(); ++t) {
    const uint32_t source = map.tet[t];
    out.hardening[t] = body.hardening[source];
    if (!(out.hardening[t] > 0)) continue;  // never flowed
    const Matrix rest = rows(to.gradients[t]);
    const Matrix whole = shape(to.tet[t], out.node, to.gradients[t]);
    const Matrix elastic = shape(from.tet[source], body.node, body.gradients[source]);
    Matrix plastic;  // F_p^-1
    if (whole.determinant() > sound && elastic.determinant() > sound) {
      plastic = whole.inverse() * elastic;
    } else {
      plastic = rows(from.gradients[source]).inverse() * rows(body.gradients[source]);
    }
    const Matrix flowed = rest * plastic;
    for (int k = 0; k < 3; ++k) out.gradients[t].corner[k] = flowed.row(k).transpose().cast<float>();
  }
  for_each_field([&](const auto& field) {
    if (field.traits.transferred) out.*field.value = body.*field.value;
  });
  measure_reach(to, out);
  return out;
}

}  // namespace crumple

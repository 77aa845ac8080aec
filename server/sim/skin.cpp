#include "sim/deform.h"

namespace crumple {

void skin(const Model& model, const Body& body, std::span<Vec3> vertex) {
  for (size_t v = 0; v < vertex.size(); ++v) {
    const Skin& s = model.skin[v];
    Vec3 displacement = Vec3::Zero();
    for (int k = 0; k < 4; ++k) displacement += s.weight[k] * (body.node[s.node[k]] - model.node[s.node[k]]);
    vertex[v] = model.vertex[v] + displacement;
  }
}

}  // namespace crumple

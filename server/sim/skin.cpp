#include "sim/deform.h"

namespace crumple {

void skin(const Model& model, const Body& body, std::span<Vec3> vertex) {
  for (size_t v = 0; v < vertex.size(); ++v) {
    const Skin& s = model.skin[v];
    vertex[v] = s.weight[0] * body.node[s.node[0]] + s.weight[1] * body.node[s.node[1]] + s.weight[2] * body.node[s.node[2]] +
                s.weight[3] * body.node[s.node[3]];
  }
}

}  // namespace crumple

// Neighbours in space become neighbours in memory: nodes and vertices along a Morton curve, tets by their lowest node.
// Corners keep their cyclic sense, so orientation stays. The same meshes give the same order.
#pragma once

#include "car/mesh.h"

namespace crumple {

void order_spatially(TetMesh&);
void order_spatially(Surface&);

}  // namespace crumple

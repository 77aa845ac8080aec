// Makes neighbours in space neighbours in memory: nodes and vertices follow a Morton curve, tets their lowest node. The
// orientation of tets stays. The same meshes give the same order.
#pragma once

#include "car/mesh.h"

namespace crumple {

void order_spatially(TetMesh&);
void order_spatially(Surface&);

}  // namespace crumple

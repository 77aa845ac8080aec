// Moves a body from one level of a car to another: the same surface on another mesh. Its nodes go where the old mesh carries
// them, and each tet keeps the stress that the old mesh had there, so a body at rest stays nearly at rest. Detail that the
// coarser mesh cannot show is lost.
#pragma once

#include "sim/body.h"

namespace crumple {

// Where the nodes and tets of a mesh lie in another mesh, at rest. Made once for each pair of levels (car/map_level.h).
struct LevelMap {
  std::vector<Skin> node;     // per node: four nodes of the other mesh and their weights
  std::vector<uint32_t> tet;  // per tet: the tet of the other mesh that contains its centre, or the nearest one
};

// `classic` loses its dents: edge_rest and tet_rest get their baked values.
DeformableState transfer(const Model& from, const Model& to, const LevelMap&, const DeformableState&);

}  // namespace crumple

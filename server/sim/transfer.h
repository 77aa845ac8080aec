// A body from one level of a car to another: the same surface in other tets. Nodes go where the old mesh takes them, and each
// tet keeps the stress that the old one had there, so that a shape which was at rest is at rest, near enough. What the coarser
// mesh cannot show is lost for good.
#pragma once

#include "sim/body.h"

namespace crumple {

// Where a mesh finds itself in another at rest. Made once for each pair of levels (asset/map_level.h).
struct LevelMap {
  std::vector<Skin> node;     // per node: four nodes of the other and their weights
  std::vector<uint32_t> tet;  // per tet: the one of the other that holds its middle, or is nearest to it
};

// `classic` keeps no dents through it: its rest values are as baked again.
DeformableState transfer(const Model& from, const Model& to, const LevelMap&, const DeformableState&);

}  // namespace crumple

// Ties every surface vertex to four nodes: to the node it coincides with, to the tet that contains it, or to the tet that is
// truly nearest (not the one with the nearest centroid: wrong beside long tets). Barycentric in the tet's rest shape, outside
// it clamped to the tet. Found through a tree of boxes; the same for any thread count.
#pragma once

#include <span>
#include <vector>

#include "car/mesh.h"

namespace crumple {

struct SkinResult {
  std::vector<Skin> skin;        // one a vertex
  std::vector<uint32_t> tet;     // that it hangs on
  std::vector<double> distance;  // m, of a vertex from its tet; 0 on a node or inside
  size_t coincident = 0;         // within 1e-6 m of a node
  size_t contained = 0;
  size_t nearest = 0;   // outside every tet
  double farthest = 0;  // m, the greatest distance
};

// The mesh must have at least one tet, positively oriented.
SkinResult build_skin(const TetMesh&, std::span<const Vec3> vertices);

}  // namespace crumple

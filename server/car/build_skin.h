// Attaches every surface vertex to four nodes: to the node at its place, to the tet that contains it, or to the truly nearest
// tet (not the tet with the nearest centroid, which is wrong beside long tets). Weights are barycentric in the tet's rest
// shape, clamped to the tet for vertices outside. The search uses a tree of boxes. The result is the same for any thread count.
#pragma once

#include <span>
#include <vector>

#include "car/mesh.h"

namespace crumple {

struct SkinResult {
  std::vector<Skin> skin;        // one per vertex
  std::vector<uint32_t> tet;     // per vertex: its tet
  std::vector<double> distance;  // m, from the vertex to its tet; 0 on a node or inside
  size_t coincident = 0;         // number of vertices within 1e-6 m of a node
  size_t contained = 0;
  size_t nearest = 0;   // outside every tet
  double farthest = 0;  // m, the largest distance
};

// The mesh must have at least one tet, positively oriented.
SkinResult build_skin(const TetMesh&, std::span<const Vec3> vertices);

}  // namespace crumple

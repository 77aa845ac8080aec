// Which nodes of a lattice are solid: those that lie inside the filled surface, and as many more as hold what is too thin for
// the lattice (mirrors, spoilers, loose sheets) and join what hangs apart to the rest. Nothing that is drawn is dropped.
#pragma once

#include <vector>

#include "bake/fill_surface.h"
#include "bake/lattice.h"
#include "bake/stuff.h"

namespace crumple {

struct SolidNodes {
  LatticeSolid solid;
  size_t thin = 0;      // points of the surface that the inside does not hold at this spacing
  size_t joined = 0;    // pieces that hung apart, joined by the shortest way
  double farthest = 0;  // m, the longest of these ways
};

// extra: points that the nearest node must hold in any case.
SolidNodes choose_solid_nodes(const FilledSurface&, const Lattice&, const std::vector<Eigen::Vector3d>& extra);

// The first of the points in each cell of a grid of this spacing.
std::vector<Eigen::Vector3d> thinned_out(const std::vector<Eigen::Vector3d>& points, double spacing);

}  // namespace crumple

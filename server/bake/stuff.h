// Isosurface stuffing (Labelle and Shewchuk, "Isosurface Stuffing: Fast Tetrahedral Meshes with Good Dihedral Angles", 2007):
// the part of a lattice that lies inside an isosurface, as tets. Nodes that the surface passes too closely are warped onto it;
// tets that it cuts are cut after a few templates.
#pragma once

#include <vector>

#include "bake/lattice.h"
#include "bake/voxels.h"
#include "sim/model.h"

namespace crumple {

// What of the lattice is solid.
struct LatticeSolid {
  std::vector<double> depth;  // a node, m: above zero inside; never zero
  Mask held;                  // a node: stays where it is, and the surface keeps at least 0.42 of an edge away from it
};

// Tets in double precision, positively oriented, while they are made.
struct FineTets {
  std::vector<Eigen::Vector3d> node;
  std::vector<Tet> tet;
};

// All solid nodes must hang together by edges of the lattice; then all tets hang together by faces. Nodes that warping would
// cut off are held as well.
FineTets stuff(const Lattice&, LatticeSolid);

}  // namespace crumple

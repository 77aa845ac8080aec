// Moves the nodes of stuffed tets so that their outside fits the drawn surface and their shapes become better. No move makes
// the worst tet around a node worse than a floor, so none turns over; no tet is added or removed.
#pragma once

#include <span>
#include <vector>

#include "bake/fill_surface.h"
#include "bake/stuff.h"
#include "car/nearest.h"

namespace crumple {

// The drawn triangles, and a tree of their boxes.
struct DrawnSurface {
  std::span<const Vec3> vertex;
  std::span<const Triangle> triangle;
  BoxTree tree;
};
DrawnSurface drawn_surface(std::span<const Vec3> vertices, std::span<const Triangle>);

// spacing: that of the lattice, m.
void finish_tets(const DrawnSurface&, const FilledSurface&, double spacing, FineTets&);

// Drawn vertices outside the tets by more than `limit`, and how far the farthest is; m.
struct Outliers {
  std::vector<Eigen::Vector3d> point;
  double farthest = 0;
};
Outliers find_outliers(const DrawnSurface&, const FineTets&, double limit, double spacing);

struct AngleRange {
  double least, most;  // degrees
};
AngleRange dihedral_angles(const TetMesh&);

}  // namespace crumple

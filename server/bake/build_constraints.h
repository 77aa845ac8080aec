// From tets to the arrays that the solvers read: unique edges, rest lengths, rest gradients, rest volumes, the corners around
// each node, and lumped masses. The same mesh gives the same arrays. Computed in double, stored in single precision.
#pragma once

#include <span>
#include <vector>

#include "car/balance.h"
#include "car/mesh.h"

namespace crumple {

struct Constraints {
  std::vector<Gradients> gradients;  // t
  std::vector<float> tet_rest;       // t, m^3
  std::vector<Edge> edge;            // e, unique, edge.node[0] < edge.node[1], sorted
  std::vector<float> edge_rest;      // e, m
  std::vector<uint32_t> node_first;  // n + 1
  std::vector<uint32_t> corner;      // 4 t: 4 * tet + corner, sorted within a node
};

// The volume of a tet, m^3: a sixth of the determinant of its edge matrix. Positive if the tet is positively oriented.
double tet_volume(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d);

// The mesh must be positively oriented, use every node, and have all indices in range.
Constraints build_constraints(const TetMesh&);

struct Masses {
  std::vector<float> node;  // kg
  Vec3 center;              // m
  Vec3 inertia;             // about the centre along the car's axes, kg m^2
};

// Spreads `mass` (kg) over the tets by volume, and each tet's mass equally over its four corners.
Masses lump_masses(const TetMesh&, std::span<const float> tet_rest, double mass);

}  // namespace crumple

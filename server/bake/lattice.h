// A body-centred cubic lattice: corners of cubes, and their centres. Its tets are all alike (four around each face that two
// cubes share, dihedral angles of 60 and 90 degrees), so that a cut through them can be bounded. Nothing is stored: a node is a
// number, corners first.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cstdint>

namespace crumple {

struct Lattice {
  Eigen::Vector3d origin;           // of corner 0, m
  double spacing;                   // side of a cube, m
  std::array<uint32_t, 3> corners;  // along each axis; one centre fewer

  uint32_t corner_count() const { return corners[0] * corners[1] * corners[2]; }
  uint32_t node_count() const { return corner_count() + (corners[0] - 1) * (corners[1] - 1) * (corners[2] - 1); }
  bool is_corner(uint32_t node) const { return node < corner_count(); }
  uint32_t corner(uint32_t i, uint32_t j, uint32_t k) const { return (i * corners[1] + j) * corners[2] + k; }
  uint32_t center(uint32_t i, uint32_t j, uint32_t k) const {
    return corner_count() + (i * (corners[1] - 1) + j) * (corners[2] - 1) + k;
  }
  std::array<uint32_t, 3> place(uint32_t node) const {
    const uint32_t less = is_corner(node) ? 0 : 1, own = is_corner(node) ? node : node - corner_count();
    const uint32_t ny = corners[1] - less, nz = corners[2] - less;
    return {own / (ny * nz), own / nz % ny, own % nz};
  }
  Eigen::Vector3d position(uint32_t node) const {
    const auto [i, j, k] = place(node);
    const double half = is_corner(node) ? 0 : 0.5;
    return origin + spacing * Eigen::Vector3d(i + half, j + half, k + half);
  }
};

// A lattice around a box, centred on it, with one and a half cubes to spare on every side.
inline Lattice lattice_around(const Eigen::AlignedBox3d& box, double spacing) {
  Lattice out{box.center(), spacing, {}};
  for (int k = 0; k < 3; ++k) {
    out.corners[k] = static_cast<uint32_t>(box.sizes()[k] / spacing + 3) + 2;
    out.origin[k] -= spacing * (out.corners[k] - 1) / 2;
  }
  return out;
}

// take(node) for each of the up to 14 nodes that share an edge with this one: along the axes, and to the other kind.
template <class Take>
void for_each_neighbor(const Lattice& lattice, uint32_t node, const Take& take) {
  const bool corner = lattice.is_corner(node);
  const auto at = lattice.place(node);
  const auto id = [&](bool of_corner, const std::array<uint32_t, 3>& p) {
    return of_corner ? lattice.corner(p[0], p[1], p[2]) : lattice.center(p[0], p[1], p[2]);
  };
  for (int axis = 0; axis < 3; ++axis) {
    auto next = at;
    if (at[axis] > 0) next[axis] = at[axis] - 1, take(id(corner, next));
    if (at[axis] + 1 < lattice.corners[axis] - (corner ? 0 : 1)) next[axis] = at[axis] + 1, take(id(corner, next));
  }
  for (uint32_t bits = 0; bits < 8; ++bits) {
    std::array<uint32_t, 3> next{};
    bool within = true;
    for (int axis = 0; axis < 3; ++axis) {
      const uint32_t bit = bits >> axis & 1;
      next[axis] = corner ? at[axis] - bit : at[axis] + bit;  // 0 - 1 is beyond every count
      within &= next[axis] < lattice.corners[axis] - (corner ? 1 : 0);
    }
    if (within) take(id(!corner, next));
  }
}

// take(nodes) for each tet: the centres of two cubes, and an edge of the face between them.
template <class Take>
void for_each_tet(const Lattice& lattice, const Take& take) {
  const auto& n = lattice.corners;
  for (int axis = 0; axis < 3; ++axis) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    std::array<uint32_t, 3> c{};
    for (c[0] = axis == 0; c[0] + 1 < n[0]; ++c[0])
      for (c[1] = axis == 1; c[1] + 1 < n[1]; ++c[1])
        for (c[2] = axis == 2; c[2] + 1 < n[2]; ++c[2]) {
          auto before = c;
          --before[axis];
          const uint32_t low = lattice.center(before[0], before[1], before[2]), high = lattice.center(c[0], c[1], c[2]);
          uint32_t ring[4];
          for (int k = 0; k < 4; ++k) {
            auto corner = c;
            corner[u] += k == 1 || k == 2;
            corner[v] += k >= 2;
            ring[k] = lattice.corner(corner[0], corner[1], corner[2]);
          }
          for (int k = 0; k < 4; ++k) take(std::array<uint32_t, 4>{low, high, ring[k], ring[(k + 1) % 4]});
        }
  }
}

}  // namespace crumple

// The nearest of many triangles to a point, up to a reach, and on which side of it the point lies. A grid of cells lists the
// triangles within reach of each cell: for many points and triangles of about the reach's size, ten times as fast as a tree.
#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <vector>

#include "car/mesh.h"

namespace crumple {

struct NearTriangle {
  uint32_t triangle;
  Eigen::Vector3d offset;  // from its nearest point to the point asked for, m
  bool in_front;           // on the side that the triangle is turned to
};

class NearTriangles {
 public:
  // Both must outlive this, unchanged.
  NearTriangles(const std::vector<Eigen::Vector3d>& vertices, const std::vector<Triangle>&, double reach);
  std::optional<NearTriangle> find(const Eigen::Vector3d& point) const;

 private:
  const std::vector<Eigen::Vector3d>& vertex_;
  const std::vector<Triangle>& triangle_;
  double reach_;
  Eigen::AlignedBox3d box_;
  std::array<size_t, 3> count_{};        // of cells, each a reach wide
  std::vector<uint32_t> first_, entry_;  // triangles of cell c: entry_[first_[c]] .. entry_[first_[c + 1]]
};

}  // namespace crumple

// Finds the box whose content is nearest to a point, through Eigen's bounding volume hierarchy. Users: the skin (tets), the
// safety cell (triangles of the body's outside) and vertex colours (points). Trees are read-only after building, so all threads
// may search.
#pragma once

#include <Eigen/Geometry>
#include <limits>
#include <unsupported/Eigen/BVH>
#include <vector>

namespace crumple {

using Box = Eigen::AlignedBox3d;
using BoxTree = Eigen::KdBVH<double, 3, uint32_t>;

inline BoxTree build_tree(const std::vector<Box>& boxes) {
  std::vector<uint32_t> index(boxes.size());
  for (uint32_t i = 0; i < index.size(); ++i) index[i] = i;
  return BoxTree(index.begin(), index.end(), boxes.begin(), boxes.end());
}

struct Nearest {
  uint32_t index = 0;
  double squared_distance = std::numeric_limits<double>::infinity();
};

// The interface that Eigen's tree search needs.
template <class SquaredDistance>
struct NearestSearch {
  using Scalar = double;
  const Eigen::Vector3d& point;
  const SquaredDistance& squared_distance;
  Nearest best;
  double minimumOnVolume(const Box& box) const { return box.squaredExteriorDistance(point); }
  double minimumOnObject(uint32_t index) {
    const double distance = squared_distance(index);
    if (distance < best.squared_distance) best = {index, distance};
    return distance;
  }
};

// squared_distance(i): from `point` to the content of box i.
template <class SquaredDistance>
Nearest find_nearest(const BoxTree& tree, const Eigen::Vector3d& point, const SquaredDistance& squared_distance) {
  NearestSearch<SquaredDistance> search{point, squared_distance, {}};
  Eigen::BVMinimize(tree, search);
  return search.best;
}

// The vector from a triangle's nearest point to p. Ericson, Real-Time Collision Detection, 5.1.5: tests the regions of the
// triangle's corners, edges and face.
Eigen::Vector3d offset_from_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                     const Eigen::Vector3d& c);

inline double squared_distance_to_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                           const Eigen::Vector3d& c) {
  return offset_from_triangle(p, a, b, c).squaredNorm();
}

}  // namespace crumple

// A regular grid of cubes, and the exact Euclidean distance transform on it. Voxel (i, j, k) is centred at
// origin + size (i, j, k); x runs fastest in memory. A mask has one byte a voxel, 0 or 1.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

namespace crumple {

struct Voxels {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();  // m
  double size = 1;                                   // m
  std::array<int, 3> count = {0, 0, 0};

  size_t total() const { return size_t(count[0]) * size_t(count[1]) * size_t(count[2]); }
  size_t index(int i, int j, int k) const { return (size_t(k) * size_t(count[1]) + size_t(j)) * size_t(count[0]) + size_t(i); }
  size_t stride(int axis) const { return axis == 0 ? 1 : axis == 1 ? size_t(count[0]) : size_t(count[0]) * size_t(count[1]); }
};

using Mask = std::vector<uint8_t>;

// What squared_distances() says where the mask holds no such voxel at all.
inline constexpr int32_t nowhere = 1 << 30;

// From each voxel the squared distance, in voxels, to the nearest one whose mask is `goal`. Exact: all in integers, after
// Meijster, Roerdink and Hesselink, "A general algorithm for computing distance transforms in linear time" (2000).
// No axis may have more than 8,192 voxels, or squares overflow.
std::vector<int32_t> squared_distances(const Voxels&, const Mask&, bool goal);

// A value between voxel centres, linear along each axis; beyond the grid that of its edge.
double interpolate(const Voxels&, const std::vector<float>& value, const Eigen::Vector3d& point);

}  // namespace crumple

#include "bake/near_triangles.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "car/nearest.h"

namespace crumple {

NearTriangles::NearTriangles(const std::vector<Eigen::Vector3d>& vertices, const std::vector<Triangle>& triangles, double reach)
    : vertex_(vertices), triangle_(triangles), reach_(reach) {
  for (const Triangle& triangle : triangles)
    for (uint32_t v : triangle) box_.extend(vertices[v]);
  box_.min().array() -= reach;
  box_.max().array() += reach;
  for (int k = 0; k < 3; ++k) count_[k] = size_t(box_.sizes()[k] / reach) + 1;
  const auto for_each_cell = [&](const Triangle& triangle, const auto& take) {
    size_t low[3], high[3];
    for (int k = 0; k < 3; ++k) {
      const auto [least, most] = std::minmax({vertices[triangle[0]][k], vertices[triangle[1]][k], vertices[triangle[2]][k]});
      low[k] = size_t((least - reach - box_.min()[k]) / reach);
      high[k] = std::min(count_[k] - 1, size_t((most + reach - box_.min()[k]) / reach));
    }
    for (size_t i = low[0]; i <= high[0]; ++i)
      for (size_t j = low[1]; j <= high[1]; ++j)
        for (size_t k = low[2]; k <= high[2]; ++k) take((i * count_[1] + j) * count_[2] + k);
  };
  first_.assign(count_[0] * count_[1] * count_[2] + 1, 0);
  for (const Triangle& triangle : triangles) for_each_cell(triangle, [&](size_t cell) { ++first_[cell + 1]; });
  std::partial_sum(first_.begin(), first_.end(), first_.begin());
  entry_.resize(first_.back());
  std::vector<uint32_t> next(first_.begin(), first_.end() - 1);
  for (uint32_t t = 0; t < triangles.size(); ++t) for_each_cell(triangles[t], [&](size_t cell) { entry_[next[cell]++] = t; });
}

std::optional<NearTriangle> NearTriangles::find(const Eigen::Vector3d& point) const {
  if (!box_.contains(point)) return std::nullopt;
  size_t cell = 0;
  for (int k = 0; k < 3; ++k) cell = cell * count_[k] + std::min(count_[k] - 1, size_t((point[k] - box_.min()[k]) / reach_));
  const double same = 1e-9 * reach_ * reach_;
  double best = reach_ * reach_, steepest = 0;
  std::optional<NearTriangle> out;
  for (uint32_t i = first_[cell]; i < first_[cell + 1]; ++i) {
    const auto& [u, v, w] = triangle_[entry_[i]];
    const Eigen::Vector3d &a = vertex_[u], &b = vertex_[v], &c = vertex_[w];
    const Eigen::Vector3d offset = offset_from_triangle(point, a, b, c);
    const double squared = offset.squaredNorm();
    if (squared > best + same) continue;
    // Of triangles that share the nearest edge or corner, the one that faces the point most says on which side it lies.
    const Eigen::Vector3d normal = (b - a).cross(c - a);
    const double height = offset.dot(normal) / std::sqrt(std::max(normal.squaredNorm(), 1e-300));
    if (squared >= best - same && std::abs(height) <= steepest) continue;
    best = std::min(best, squared);
    steepest = std::abs(height);
    out = NearTriangle{entry_[i], offset, height > 0};
  }
  return out;
}

}  // namespace crumple

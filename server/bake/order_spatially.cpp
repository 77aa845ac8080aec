#include "bake/order_spatially.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <numeric>

namespace crumple {
namespace {

// Spreads 21 bits, as many as each axis has: steps of a few micrometres on a car.
uint64_t spread(uint64_t x) {
  x &= 0x1fffff;
  x = (x | x << 32) & 0x001f00000000ffff;
  x = (x | x << 16) & 0x001f0000ff0000ff;
  x = (x | x << 8) & 0x100f00f00f00f00f;
  x = (x | x << 4) & 0x10c30c30c30c30c3;
  return (x | x << 2) & 0x1249249249249249;
}

// order[new index] = old index
std::vector<uint32_t> morton_order(const std::vector<Vec3>& points) {
  Eigen::AlignedBox3d box;
  for (const Vec3& point : points) box.extend(point.cast<double>());
  const double scale = 0x1fffff / std::max(box.sizes().maxCoeff(), 1e-30);
  std::vector<uint64_t> code(points.size());
  for (size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d cell = (points[i].cast<double>() - box.min()) * scale;
    code[i] = spread(static_cast<uint64_t>(cell.x())) | spread(static_cast<uint64_t>(cell.y())) << 1 |
              spread(static_cast<uint64_t>(cell.z())) << 2;
  }
  std::vector<uint32_t> order(points.size());
  std::iota(order.begin(), order.end(), 0u);
  std::stable_sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return code[a] < code[b]; });
  return order;
}

template <class T>
std::vector<T> permuted(const std::vector<T>& list, const std::vector<uint32_t>& order) {
  std::vector<T> out;
  out.reserve(list.size());
  for (size_t i = 0; i < list.size(); ++i) out.push_back(list[order[i]]);
  return out;
}

std::vector<uint32_t> inverse(const std::vector<uint32_t>& order) {
  std::vector<uint32_t> out(order.size());
  for (uint32_t i = 0; i < order.size(); ++i) out[order[i]] = i;
  return out;
}

}  // namespace

void order_spatially(TetMesh& mesh) {
  const std::vector<uint32_t> order = morton_order(mesh.node), place = inverse(order);
  mesh.node = permuted(mesh.node, order);
  // Puts the lowest node first by an even permutation of the corners, which keeps the orientation.
  constexpr int even[4][4] = {{0, 1, 2, 3}, {1, 0, 3, 2}, {2, 3, 0, 1}, {3, 2, 1, 0}};
  for (Tet& tet : mesh.tet) {
    for (uint32_t& node : tet.node) node = place[node];
    const auto lowest = std::min_element(tet.node, tet.node + 4) - tet.node;
    const Tet old = tet;
    for (int k = 0; k < 4; ++k) tet.node[k] = old.node[even[lowest][k]];
  }
  std::sort(mesh.tet.begin(), mesh.tet.end(),
            [](const Tet& a, const Tet& b) { return std::lexicographical_compare(a.node, a.node + 4, b.node, b.node + 4); });
}

void order_spatially(Surface& surface) {
  const std::vector<uint32_t> order = morton_order(surface.vertex), place = inverse(order);
  surface.vertex = permuted(surface.vertex, order);
  if (!surface.color.empty()) surface.color = permuted(surface.color, order);
  if (!surface.part.empty()) surface.part = permuted(surface.part, order);
  for (Triangle& triangle : surface.triangle)
    for (uint32_t& vertex : triangle) vertex = place[vertex];
}

}  // namespace crumple

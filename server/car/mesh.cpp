#include "car/mesh.h"

#include <algorithm>
#include <numeric>

namespace crumple {

std::vector<Triangle> boundary(const TetMesh& mesh) {
  constexpr int face[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
  std::vector<std::pair<Triangle, Triangle>> faces;  // sorted corners, corners
  faces.reserve(4 * mesh.tet.size());
  for (const Tet& tet : mesh.tet)
    for (const auto& f : face) {
      const Triangle corners = {tet.node[f[0]], tet.node[f[1]], tet.node[f[2]]};
      Triangle sorted = corners;
      std::sort(sorted.begin(), sorted.end());
      faces.emplace_back(sorted, corners);
    }
  std::sort(faces.begin(), faces.end());
  std::vector<Triangle> out;
  for (size_t i = 0; i < faces.size(); ++i) {
    const bool shared =
        (i > 0 && faces[i - 1].first == faces[i].first) || (i + 1 < faces.size() && faces[i + 1].first == faces[i].first);
    if (!shared) out.push_back(faces[i].second);
  }
  return out;
}

std::vector<uint32_t> connected(size_t count, std::span<const uint32_t> connections, size_t size) {
  std::vector<uint32_t> parent(count);
  std::iota(parent.begin(), parent.end(), 0u);
  const auto root = [&](uint32_t i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
  };
  for (size_t i = 0; i < connections.size(); ++i) {
    const uint32_t a = root(connections[i]), b = root(connections[i - i % size]);
    parent[std::max(a, b)] = std::min(a, b);
  }
  for (uint32_t i = 0; i < count; ++i) parent[i] = root(i);
  return parent;
}

}  // namespace crumple

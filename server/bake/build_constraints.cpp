#include "bake/build_constraints.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>

namespace crumple {
namespace {

void list_corners(const TetMesh& mesh, Constraints& out) {
  out.node_first.assign(mesh.node.size() + 1, 0);
  for (const Tet& tet : mesh.tet)
    for (uint32_t node : tet.node) ++out.node_first[node + 1];
  for (size_t i = 0; i < mesh.node.size(); ++i) out.node_first[i + 1] += out.node_first[i];
  out.corner.resize(4 * mesh.tet.size());
  std::vector<uint32_t> next(out.node_first.begin(), out.node_first.end() - 1);
  for (uint32_t t = 0; t < mesh.tet.size(); ++t)
    for (uint32_t k = 0; k < 4; ++k) out.corner[next[mesh.tet[t].node[k]]++] = 4 * t + k;
}

// The tets around a node name its neighbours several times each (five on average). Sorting such short lists is cheaper than
// sorting all six edges of all tets at once.
void list_edges(const TetMesh& mesh, Constraints& out) {
  std::vector<uint32_t> neighbours;
  for (uint32_t i = 0; i < mesh.node.size(); ++i) {
    neighbours.clear();
    for (uint32_t k = out.node_first[i]; k < out.node_first[i + 1]; ++k)
      for (uint32_t other : mesh.tet[out.corner[k] / 4].node)
        if (other > i) neighbours.push_back(other);
    std::sort(neighbours.begin(), neighbours.end());
    neighbours.erase(std::unique(neighbours.begin(), neighbours.end()), neighbours.end());
    for (uint32_t other : neighbours) out.edge.push_back({{i, other}});
  }
  out.edge_rest.resize(out.edge.size());
  for (size_t e = 0; e < out.edge.size(); ++e) {
    const auto [a, b] = out.edge[e].node;
    out.edge_rest[e] = static_cast<float>((mesh.node[b].cast<double>() - mesh.node[a].cast<double>()).norm());
  }
}

void rest_shape(const TetMesh& mesh, size_t t, Constraints& out) {
  const uint32_t* node = mesh.tet[t].node;
  const Eigen::Vector3d origin = mesh.node[node[0]].cast<double>();
  Eigen::Matrix3d edges;
  for (int k = 0; k < 3; ++k) edges.col(k) = mesh.node[node[k + 1]].cast<double>() - origin;
  const Eigen::Matrix3d inverse = edges.inverse();
  for (int k = 0; k < 3; ++k) out.gradients[t].corner[k] = inverse.row(k).transpose().cast<float>();
  out.tet_rest[t] = static_cast<float>(edges.determinant() / 6);
}

}  // namespace

double tet_volume(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const Eigen::Vector3d origin = a.cast<double>();
  return (b.cast<double>() - origin).cross(c.cast<double>() - origin).dot(d.cast<double>() - origin) / 6;
}

Constraints build_constraints(const TetMesh& mesh) {
  Constraints out;
  list_corners(mesh, out);
  list_edges(mesh, out);
  out.gradients.resize(mesh.tet.size());
  out.tet_rest.resize(mesh.tet.size());
  tbb::parallel_for(tbb::blocked_range<size_t>(0, mesh.tet.size(), 4096), [&](const auto& range) {
    for (size_t t = range.begin(); t != range.end(); ++t) rest_shape(mesh, t, out);
  });
  return out;
}

Masses lump_masses(const TetMesh& mesh, std::span<const float> tet_rest, double mass) {
  double volume = 0;
  std::vector<double> share(mesh.node.size(), 0);
  for (size_t t = 0; t < mesh.tet.size(); ++t) {
    volume += tet_rest[t];
    for (uint32_t node : mesh.tet[t].node) share[node] += tet_rest[t] / 4.0;
  }
  Masses out;
  for (double each : share) out.node.push_back(static_cast<float>(each * mass / volume));
  const Balance all = balance(mesh.node, out.node);
  out.center = all.center.cast<float>();
  out.inertia = all.inertia.cast<float>();
  return out;
}

}  // namespace crumple

#include "car/build_skin.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <Eigen/LU>
#include <cmath>

#include "car/nearest.h"

namespace crumple {
namespace {

constexpr double coincident_within = 1e-6;  // m: four steps of a float at 2 m

struct Attached {
  Skin skin{};
  uint32_t tet = 0;
  double distance = 0;  // m, 0 inside
  bool coincident = false;
};

Eigen::Vector4d barycentric(const TetMesh& mesh, uint32_t tet, const Eigen::Vector3d& point) {
  const uint32_t* node = mesh.tet[tet].node;
  const Eigen::Vector3d origin = mesh.node[node[0]].cast<double>();
  Eigen::Matrix3d edges;
  for (int k = 0; k < 3; ++k) edges.col(k) = mesh.node[node[k + 1]].cast<double>() - origin;
  const Eigen::Vector3d w = edges.inverse() * (point - origin);
  return {1 - w.sum(), w[0], w[1], w[2]};
}

double squared_distance_to_tet(const TetMesh& mesh, uint32_t tet, const Eigen::Vector3d& point) {
  const Eigen::Vector4d weight = barycentric(mesh, tet, point);
  if (weight.minCoeff() >= 0) return 0;
  double squared = std::numeric_limits<double>::infinity();
  for (int k = 0; k < 4; ++k) {  // only faces with the point outside can be nearest
    if (weight[k] >= 0) continue;
    Eigen::Vector3d corner[3];
    for (int j = 0; j < 3; ++j) corner[j] = mesh.node[mesh.tet[tet].node[(k + 1 + j) % 4]].cast<double>();
    squared = std::min(squared, squared_distance_to_triangle(point, corner[0], corner[1], corner[2]));
  }
  return squared;
}

Attached attach(const TetMesh& mesh, const BoxTree& tree, const Vec3& vertex) {
  const Eigen::Vector3d point = vertex.cast<double>();
  const auto measure = [&](uint32_t tet) { return squared_distance_to_tet(mesh, tet, point); };
  const Nearest found = find_nearest(tree, point, measure);
  Attached out;
  out.distance = std::sqrt(found.squared_distance);
  const uint32_t tet = out.tet = found.index;
  for (uint32_t k = 0; k < 4; ++k) {
    if ((mesh.node[mesh.tet[tet].node[k]].cast<double>() - point).norm() > coincident_within) continue;
    out.coincident = true;
    out.skin.weight[0] = 1;
    for (uint32_t j = 0; j < 4; ++j) out.skin.node[j] = mesh.tet[tet].node[(k + j) % 4];
    return out;
  }
  // A vertex outside follows the tet's surface: extrapolated weights would tear the skin apart when the tet folds.
  Eigen::Vector4d weight = barycentric(mesh, tet, point).cwiseMax(0);
  weight /= weight.sum();
  for (int k = 0; k < 4; ++k) {
    out.skin.node[k] = mesh.tet[tet].node[k];
    out.skin.weight[k] = static_cast<float>(weight[k]);
  }
  return out;
}

BoxTree tree_of_tets(const TetMesh& mesh) {
  std::vector<Box> boxes(mesh.tet.size());
  for (size_t t = 0; t < boxes.size(); ++t)
    for (uint32_t node : mesh.tet[t].node) boxes[t].extend(mesh.node[node].cast<double>());
  return build_tree(boxes);
}

}  // namespace

SkinResult build_skin(const TetMesh& mesh, std::span<const Vec3> vertices) {
  const BoxTree tree = tree_of_tets(mesh);
  std::vector<Attached> attached(vertices.size());
  tbb::parallel_for(tbb::blocked_range<size_t>(0, vertices.size(), 64), [&](const auto& range) {
    for (size_t i = range.begin(); i != range.end(); ++i) attached[i] = attach(mesh, tree, vertices[i]);
  });
  SkinResult out;
  for (const Attached& one : attached) {
    out.skin.push_back(one.skin);
    out.tet.push_back(one.tet);
    ++(one.coincident ? out.coincident : one.distance == 0 ? out.contained : out.nearest);
    out.distance.push_back(one.coincident ? 0 : one.distance);
    out.farthest = std::max(out.farthest, out.distance.back());
  }
  return out;
}

}  // namespace crumple

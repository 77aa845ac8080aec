#include "viewer/parts.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

namespace crumple::viewer {
namespace {

// How far around a part its nodes lie. A wheel's reach is that of its well and its arch.
constexpr double reach_of_wheel = 1.5;   // radii
constexpr double reach_of_others = 0.4;  // m
// A coarse car has few nodes there: then so many count, and the reach is a little beyond the last.
constexpr size_t least_nodes = 12;
constexpr double beyond_last = 1.1;
// If nodes in a line leave a turn open, this share of their spread decides for none. It turns no other by as much.
constexpr double towards_none = 1e-8;

Eigen::Vector3d vector(const Point& p) { return {double(p[0]), double(p[1]), double(p[2])}; }
Eigen::Quaterniond quaternion(const Turn4& q) { return {q[3], q[0], q[1], q[2]}; }
Point point(const Eigen::Vector3d& v) { return {float(v.x()), float(v.y()), float(v.z())}; }

}  // namespace

NodesAround nodes_around(const Part& part, std::span<const Point> rest) {
  const Eigen::Vector3d at = vector(part.position);
  std::vector<double> distance;
  for (const Point& node : rest) distance.push_back((vector(node) - at).norm());
  std::vector<double> sorted = distance;
  const size_t few = std::min(least_nodes, sorted.size()) - 1;
  std::nth_element(sorted.begin(), sorted.begin() + std::ptrdiff_t(few), sorted.end());
  const double wanted = part.kind == schema::PartKind::wheel ? reach_of_wheel * double(part.radius) : reach_of_others;
  const double reach = std::max({wanted, beyond_last * sorted[few], 1e-6});
  NodesAround out;
  double sum = 0;
  for (uint32_t i = 0; i < rest.size(); ++i) {
    if (!(distance[i] < reach)) continue;
    const double share = distance[i] / reach, near = 1 - share * share;
    out.node.push_back(i);
    out.weight.push_back(near * near);
    sum += near * near;
  }
  for (double& weight : out.weight) weight /= sum;
  return out;
}

Point Motion::displacement(const Point& rest) const {
  const Eigen::Vector3d from = vector(rest) - Eigen::Map<const Eigen::Vector3d>(center.data());
  return point(quaternion(orientation) * from - from + Eigen::Map<const Eigen::Vector3d>(shift.data()));
}

Point Motion::turned(const Point& direction) const { return point(quaternion(orientation) * vector(direction)); }

Motion motion_of(const NodesAround& around, std::span<const Point> rest, std::span<const float> displacement, float quantum) {
  Motion out;
  Eigen::Vector3d center = Eigen::Vector3d::Zero(), shift = center;
  const auto moved = [&](uint32_t node) -> Eigen::Vector3d {
    const float* d = &displacement[size_t{3} * node];
    return double(quantum) * Eigen::Vector3d(double(d[0]), double(d[1]), double(d[2]));
  };
  bool still = true;
  for (size_t k = 0; k < around.node.size(); ++k) {
    const Eigen::Vector3d by = moved(around.node[k]);
    center += around.weight[k] * vector(rest[around.node[k]]);
    shift += around.weight[k] * by;
    still &= by.isZero(0);
  }
  if (still) return out;
  Eigen::Matrix3d s = Eigen::Matrix3d::Zero();
  double spread = 0;
  for (size_t k = 0; k < around.node.size(); ++k) {
    const Eigen::Vector3d p = vector(rest[around.node[k]]) - center, q = p + moved(around.node[k]) - shift;
    s += around.weight[k] * p * q.transpose();
    spread += around.weight[k] * p.squaredNorm();
  }
  s.diagonal().array() += towards_none * spread + 1e-12;
  Eigen::Matrix4d n;                                                        // its last eigenvector is the turn as w, x, y, z
  n << s.trace(), s(1, 2) - s(2, 1), s(2, 0) - s(0, 2), s(0, 1) - s(1, 0),  //
      s(1, 2) - s(2, 1), s(0, 0) - s(1, 1) - s(2, 2), s(0, 1) + s(1, 0), s(2, 0) + s(0, 2),  //
      s(2, 0) - s(0, 2), s(0, 1) + s(1, 0), s(1, 1) - s(0, 0) - s(2, 2), s(1, 2) + s(2, 1),  //
      s(0, 1) - s(1, 0), s(2, 0) + s(0, 2), s(1, 2) + s(2, 1), s(2, 2) - s(0, 0) - s(1, 1);
  Eigen::Vector4d turn = Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d>(n).eigenvectors().col(3);
  if (turn[0] < 0) turn = -turn;
  out.orientation = {turn[1], turn[2], turn[3], turn[0]};
  out.center = {center.x(), center.y(), center.z()};
  out.shift = {shift.x(), shift.y(), shift.z()};
  return out;
}

Place place_of(const Part& part, const Motion& motion) {
  const Point moved = motion.displacement(part.position);
  const auto& q = part.orientation;
  const Eigen::Quaterniond now =
      quaternion(motion.orientation) * quaternion({double(q[0]), double(q[1]), double(q[2]), double(q[3])});
  Place out{{}, {now.x(), now.y(), now.z(), now.w()}};
  for (size_t k = 0; k < 3; ++k) out.position[k] = double(part.position[k]) + double(moved[k]);
  return out;
}

}  // namespace crumple::viewer

#include "car/balance.h"

namespace crumple {

Balance balance(std::span<const Vec3> node, std::span<const float> mass) {
  Balance out;
  for (size_t i = 0; i < node.size(); ++i) {
    out.mass += mass[i];
    out.center += mass[i] * node[i].cast<double>();
  }
  out.center /= out.mass;
  for (size_t i = 0; i < node.size(); ++i) {
    const Eigen::Vector3d square = (node[i].cast<double>() - out.center).cwiseAbs2();
    out.inertia += mass[i] * (Eigen::Vector3d::Constant(square.sum()) - square);
  }
  return out;
}

}  // namespace crumple

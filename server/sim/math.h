// Vectors, and the pose of a rigid thing.
#pragma once

#include <Eigen/Geometry>

namespace crumple {

using Vec3 = Eigen::Vector3f;
using Mat3 = Eigen::Matrix3f;

struct Pose {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();               // m
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();  // unit
};

}  // namespace crumple

// Mass, centre of mass and inertia of a body's nodes.
#pragma once

#include <Eigen/Core>
#include <span>

#include "sim/model.h"

namespace crumple {

// Inertia about the centre along the car's axes.
struct Balance {
  double mass = 0;                                    // kg
  Eigen::Vector3d center = Eigen::Vector3d::Zero();   // m
  Eigen::Vector3d inertia = Eigen::Vector3d::Zero();  // kg m^2
};
Balance balance(std::span<const Vec3> node, std::span<const float> mass);

}  // namespace crumple

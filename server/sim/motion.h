// The car as a rigid body. Contacts change its motion inside the tick.
#pragma once

#include "sim/math.h"

namespace crumple {

struct Motion {
  Pose pose;                                                   // of the car's frame
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();          // of the centre of mass, m/s, world
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  // rad/s, world
};

struct Mass {
  double mass = 1500;                                          // kg; infinite: contacts do not change the path
  Eigen::Vector3d inertia = Eigen::Vector3d(600, 2400, 2600);  // principal, along the car's axes, kg m^2
  Eigen::Vector3d center = Eigen::Vector3d::Zero();            // of mass, in the car's frame, m
  bool planar = true;  // the car stands on its wheels: impulses change only vx, vy and the yaw rate
};

// The pose after `seconds` of steady motion (m/s, rad/s, world).
Pose advance(const Pose&, const Eigen::Vector3d& velocity, const Eigen::Vector3d& angular_velocity, double seconds);

// The car's pose after `seconds` of steady motion about its centre of mass.
Pose advance(const Motion&, const Mass&, double seconds);

// Changes the velocities by an impulse (N s) and an angular impulse about the centre of mass (N m s), both in world axes.
void push(const Eigen::Vector3d& impulse, const Eigen::Vector3d& angular_impulse, const Mass&, Motion&);

// Kinetic energy of the degrees of freedom that contacts can change, J.
double kinetic_energy(const Motion&, const Mass&);

}  // namespace crumple

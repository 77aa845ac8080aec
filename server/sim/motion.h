// The car as a rigid body: what contacts slow down inside the tick.
#pragma once

#include "sim/math.h"

namespace crumple {

struct Motion {
  Pose pose;                                                   // of the car's frame
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();          // of the centre of mass, m/s, world
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  // rad/s, world
};

struct Mass {
  double mass = 1500;                                          // kg; infinite: the path is law
  Eigen::Vector3d inertia = Eigen::Vector3d(600, 2400, 2600);  // principal, along the car's axes, kg m^2
  Eigen::Vector3d center = Eigen::Vector3d::Zero();            // of mass, in the car's frame, m
  bool planar = true;  // on its wheels: impulses change the velocity in x and y and the yaw rate only
};

// Where something that moves steadily (m/s, rad/s, world) stands after `seconds`.
Pose advance(const Pose&, const Eigen::Vector3d& velocity, const Eigen::Vector3d& angular_velocity, double seconds);

// The car's pose after `seconds` of steady motion about its centre of mass.
Pose advance(const Motion&, const Mass&, double seconds);

// Changes the velocities by an impulse (N s) and an angular impulse about the centre of mass (N m s), both in world axes.
void push(const Eigen::Vector3d& impulse, const Eigen::Vector3d& angular_impulse, const Mass&, Motion&);

// J; of the freedoms that contacts can change.
double kinetic_energy(const Motion&, const Mass&);

}  // namespace crumple

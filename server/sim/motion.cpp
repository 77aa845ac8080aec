#include "sim/motion.h"

namespace crumple {

Pose advance(const Pose& pose, const Eigen::Vector3d& velocity, const Eigen::Vector3d& angular_velocity, double seconds) {
  const Eigen::Vector3d half = 0.5 * seconds * angular_velocity;
  // First order in the quaternion, then normalised (Cayley): the error is a twelfth of the angle's cube, and no sine is needed.
  const Eigen::Quaterniond turn(1, half.x(), half.y(), half.z());
  return {pose.position + seconds * velocity, (turn * pose.orientation).normalized()};
}

Pose advance(const Motion& motion, const Mass& mass, double seconds) {
  const Eigen::Vector3d center = motion.pose.orientation * mass.center;
  Pose pose =
      advance({motion.pose.position + center, motion.pose.orientation}, motion.velocity, motion.angular_velocity, seconds);
  pose.position -= pose.orientation * mass.center;
  return pose;
}

void push(const Eigen::Vector3d& impulse, const Eigen::Vector3d& angular_impulse, const Mass& mass, Motion& motion) {
  Eigen::Vector3d change = impulse / mass.mass;
  const Eigen::Matrix3d axes = motion.pose.orientation.toRotationMatrix();
  Eigen::Vector3d turn;
  if (mass.planar) {
    change.z() = 0;
    turn = Eigen::Vector3d(0, 0, angular_impulse.z() / mass.inertia.z());
  } else {
    turn = axes * (axes.transpose() * angular_impulse).cwiseQuotient(mass.inertia);
  }
  motion.velocity += change;
  motion.angular_velocity += turn;
}

double kinetic_energy(const Motion& motion, const Mass& mass) {
  const Eigen::Vector3d spin = motion.pose.orientation.conjugate() * motion.angular_velocity;
  if (mass.planar) {
    return 0.5 * mass.mass * motion.velocity.head<2>().squaredNorm() + 0.5 * mass.inertia.z() * spin.z() * spin.z();
  }
  return 0.5 * mass.mass * motion.velocity.squaredNorm() + 0.5 * spin.cwiseAbs2().dot(mass.inertia);
}

}  // namespace crumple

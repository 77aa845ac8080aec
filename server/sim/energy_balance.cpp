#include "sim/energy_balance.h"

#include <algorithm>
#include <cmath>

namespace crumple {
namespace {

constexpr double least_share = 0.5, most_share = 2;  // of the mean impulse

struct Impulse {
  Eigen::Vector3d linear;   // N s, world axes
  Eigen::Vector3d angular;  // N m s, world axes, about the centre of mass
};

// Force-weighted mean velocity of the obstacles at their contact points (m/s, world).
Eigen::Vector3d pressing_velocity(const StepInput& input, const Substep& now, const ContactSet& contacts,
                                  std::span<const ContactForce> held, const StepState& state) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double forces = 0;
  for (size_t k = 0; k < held.size(); ++k) {
    const double force = double(held[k].force.norm());
    if (!held[k].active || force == 0) continue;
    const Contact& contact = contacts.contact[k];
    const Obstacle& obstacle = input.obstacles[contact.obstacle];
    const Pose& pose = state.motion.pose;
    const Eigen::Vector3d node = pose.position + pose.orientation * state.body.node[contact.node].cast<double>();
    const Eigen::Vector3d arm = node - obstacle.pose.position - now.start * obstacle.velocity;
    sum += force * (obstacle.velocity + obstacle.angular_velocity.cross(arm));
    forces += force;
  }
  return forces > 0 ? Eigen::Vector3d(sum / forces) : sum;
}

// The share of the impulse that balances the energy. Energies are kinetic, seen from the obstacles, J. pressing: velocity of
// the obstacles. The motion never gains more than state.spring, and its gain is subtracted from there. Without that limit the
// explicit step of the motion would throw about a body far too stiff or too viscous for the sub-step, and so would obstacles
// that leave the body no room: their forces no longer say where it should go.
double balancing_share(const Mass& mass, const Impulse& impulse, const Eigen::Vector3d& pressing, StepState& state) {
  if (!std::isfinite(mass.mass)) return 1;
  Motion relative = state.motion, still;
  relative.velocity -= pressing;
  still.pose = state.motion.pose;
  const double before = kinetic_energy(relative, mass);
  push(impulse.linear, impulse.angular, mass, relative);
  push(impulse.linear, impulse.angular, mass, still);
  // A share s of the impulse changes the energy by linear s + square s^2.
  const double square = kinetic_energy(still, mass), linear = kinetic_energy(relative, mass) - before - square;
  if (!(square > 0)) return 1;
  const auto gains = [&](double gain, int sign) {  // shares that add this energy, or come nearest to it
    return (sign * std::sqrt(std::max(0.0, linear * linear + 4 * square * gain)) - linear) / (2 * square);
  };
  double share = 1;
  if (!state.body.lost) {
    const double missing = state.spring - state.body.stored;
    const double stops = gains(missing, -1), returns = gains(missing, 1);
    share = std::clamp(std::fabs(stops - 1) < std::fabs(returns - 1) ? stops : returns, least_share, most_share);
  }
  if ((linear + square * share) * share > state.spring) share = std::clamp(gains(state.spring, 1), 0.0, share);
  state.spring -= (linear + square * share) * share;
  return share;
}

}  // namespace

void react(const StepInput& input, const Substep& now, double h, const ContactSet& contacts, std::span<const ContactForce> held,
           StepState& state) {
  auto& [body, motion, result, spring] = state;
  Eigen::Vector3d force = Eigen::Vector3d::Zero(), moment = Eigen::Vector3d::Zero();
  uint32_t touching = 0;
  for (size_t k = 0; k < held.size(); ++k) {
    if (!held[k].active) continue;
    const Contact& contact = contacts.contact[k];
    const Eigen::Vector3d f = held[k].force.cast<double>();
    const Vec3 slip = body.node[contact.node] - contact.carried;
    force += f;
    moment += (body.node[contact.node].cast<double>() - input.mass.center).cross(f);
    const Vec3 tangential = held[k].force - contact.normal.dot(held[k].force) * contact.normal;
    const double rubbed = double(std::max(0.0f, -tangential.dot(slip)));
    body.absorbed += rubbed;
    spring -= rubbed;
    result.deepest = std::max(result.deepest, -contact.after);
    ++touching;
  }
  // Mean of the forces at both ends of the sub-step; then scaled to balance the energy.
  const Eigen::Quaterniond& axes = motion.pose.orientation;
  Impulse impulse{0.5 * h * (body.force + axes * force), 0.5 * h * (body.moment + axes * moment)};
  const double share = balancing_share(input.mass, impulse, pressing_velocity(input, now, contacts, held, state), state);
  impulse.linear *= share;
  impulse.angular *= share;
  body.force = std::min(1.0, share) * (axes * force);
  body.moment = std::min(1.0, share) * (axes * moment);
  body.touching = touching > 0;
  push(impulse.linear, impulse.angular, input.mass, motion);
  result.impulse += impulse.linear;
  result.angular_impulse += impulse.angular;
  result.contacts = touching;
}

}  // namespace crumple

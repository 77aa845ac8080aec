#include "sim/substeps.h"

namespace crumple {

constexpr float shortest_substep = 0.01f;  // share of a whole sub-step: the shortest first one, which begins at the touch

int choose_substeps(const StepInput& input, const ContactSet& contacts, const DeformableState& body, const Motion& motion,
                    double closing) {
  for (const Candidates& near : contacts.candidate) {
    const Obstacle& obstacle = input.obstacles[near.obstacle];
    const double turning = motion.angular_velocity.norm() + obstacle.angular_velocity.norm();
    closing = std::max(closing, (motion.velocity - obstacle.velocity).norm() + double(body.reach) * turning);
  }
  // The car squeezed as one block: its stiffness is about 1.5 E times its reach.
  double modulus = 0;
  for (const Material& material : input.parameters.region) modulus = std::max(modulus, double(material.young_modulus));
  const double frequency = std::sqrt(1.5 * modulus * double(body.reach) / input.mass.mass);
  const int count = substep_count(input.parameters.substeps, input.seconds);
  int times = 1;
  for (int k = 0; k < halvings; ++k) {
    const double h = input.seconds / (count * times) / coarseness(input.parameters);
    if (closing * h > substep_travel || frequency * h > substep_turn) times *= 2;
  }
  return count * times;
}

Pose path(const Mass& mass, const DeformableState& body, const Motion& motion, double h) {
  Motion middle = motion;
  push(0.5 * h * body.force, 0.5 * h * body.moment, mass, middle);
  return advance(middle, mass, h);
}

float Touchdown::rest() const { return earliest_ < 1 ? std::max(shortest_substep, 1 - earliest_) : 1; }

}  // namespace crumple

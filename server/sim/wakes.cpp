#include "sim/wakes.h"

#include "sim/rest.h"
#include "sim/scratch.h"

namespace crumple {

bool wakes(const StepInput& input, Scratch& scratch, const DeformableState& body, Motion motion) {
  ContactSet& contacts = scratch.contacts;
  find_candidates(input, body, motion, contacts);
  if (contacts.candidate.empty()) return body.touching;
  const bool whole = input.parameters.solver == Solver::classic;
  const int count = whole ? 1 : choose_substeps(input, contacts, body, motion);
  const double h = input.seconds / count;
  float drift = body.drift;
  motion.velocity -= input.seconds * input.pull;
  for (int k = 0; k < count; ++k) {
    motion.velocity += 0.5 * h * input.pull;
    const Pose to = path(input.mass, body, motion, h);
    find_contacts(body, input.obstacles, {motion.pose, to, k * h, h}, contacts);
    motion.pose = to;
    Met met;
    for (const Contact& contact : contacts.contact) met.add(contact, body);
    if (is_woken(h, met, body, drift)) return true;
    if (body.touching) push(h * body.force, h * body.moment, input.mass, motion);
    motion.velocity += 0.5 * h * input.pull;
  }
  return false;
}

}  // namespace crumple

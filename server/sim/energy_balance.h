// How contact forces change the rigid motion: the impulse is scaled so that the motion loses what the body takes. The mean of
// the forces at both ends of a sub-step is not exact: it does not see when in between a tet began to flow or a node met the
// obstacle, and sweeps leave an error in it. It alone creates or loses some 3 % of a crash's energy at 4 sub-steps a tick, and
// only shorter sub-steps make that smaller.
#pragma once

#include <span>

#include "sim/contacts.h"
#include "sim/step.h"

namespace crumple {

// After a sub-step was solved for h seconds: pushes state.motion with one impulse of the contact forces, adds the work of
// friction to body.absorbed, and keeps the forces in the body for the next sub-step. held: the solver's result per contact.
// state.spring: energy that the body should store by what the motion gave it, J; impulse and friction are subtracted from it.
void react(const StepInput&, const Substep&, double h, const ContactSet&, std::span<const ContactForce> held, StepState&);

}  // namespace crumple

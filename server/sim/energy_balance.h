// How the contacts' forces change the rigid motion: by so much that what the motion loses is what the body takes. The forces at
// both ends of a sub-step do not know where between them a tet began to flow or a node met the obstacle, and sweeps leave them
// an error: their mean alone creates or loses some 3 % of a crash's energy at 4 sub-steps a tick, and it falls only with the
// sub-step's length.
#pragma once

#include <span>

#include "sim/contacts.h"
#include "sim/step.h"

namespace crumple {

// After a sub-step was solved for h seconds: pushes state.motion by the contacts' forces as one impulse, adds the work that
// friction took to body.absorbed, and keeps the forces in the body for the next sub-step. held: per contact, as the solver left
// it. state.spring: what the body should store by what the motion gave it, J; the impulse and friction are taken from it.
void react(const StepInput&, const Substep&, double h, const ContactSet&, std::span<const ContactForce> held, StepState&);

}  // namespace crumple

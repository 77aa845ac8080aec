// How contact forces change the rigid motions: impulses are chosen so that the motions lose what the bodies take. The mean of
// the forces at both ends of a sub-step is not exact: it does not see when in between a tet began to flow or a node met an
// obstacle, and sweeps leave an error in it. It alone creates or loses some 3 % of a crash's energy at 4 sub-steps a tick, and
// only shorter sub-steps make that smaller. A car among obstacles gets its whole impulse scaled. Cars that touch one another
// get one more impulse each, equal and opposite for the two sides of a contact, against their way over each other: scaling
// would change the impulses along the surfaces too.
#pragma once

#include <span>

#include "sim/contacts.h"
#include "sim/island.h"
#include "sim/pairs.h"

namespace crumple {

// After the group's sub-step was solved for h seconds: pushes the motions with the impulses of the contact forces, adds the
// work of friction to body.absorbed, and keeps the forces in the bodies for the next sub-step. state.spring: energy that the
// body should store by what the motion gave it, J; impulse and friction are subtracted from it.
void react(std::span<Member>, const PairGroup&, const Substep&, double h);

}  // namespace crumple

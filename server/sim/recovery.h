// Bodies that have lost their shape: a tick that ended in numbers that are not finite is undone, and tets that stay inverted
// once a car is at rest give back the plastic flow that keeps them so.
#pragma once

#include "sim/step.h"

namespace crumple {

// The body as a tick found it. One a worker; its lists are reused.
struct Backup {
  DeformableState body;  // without the solver's history: there is nothing to go back to if the tick fails
  bool taken = false;    // in this tick
};

// Before a tick changes the body for the first time.
void back_up(DeformableState&, Backup&);

// Whether the tick may stand.
[[nodiscard]] bool is_finite(const DeformableState&, const Motion&);

// Undoes it: the body as backed up, its motion where it began and at rest. What was not finite before the tick is as baked
// again.
void restore(const Model&, const Motion& begin, Backup&, DeformableState&, Motion&);

// A body that nothing holds has come to rest, and some tets are inverted or flat: they stick between others that flowed while
// all of them were crushed beyond what is left of them. No car has that shape: the flow around them goes back, a part a tick,
// until the body is sound; that of the whole body where there is none around them. Returns whether there was any to take back.
bool revert_inverted(const Model&, DeformableState&);

}  // namespace crumple

// Recovers bodies that have lost their shape. A tick that ends with a number that is not finite is undone. Tets that stay
// inverted while the car is at rest give back the plastic flow that keeps them inverted.
#pragma once

#include "sim/step.h"

namespace crumple {

// A copy of the body from before the tick. One per worker; its lists are reused.
struct Backup {
  DeformableState body;  // without the solver's history, which is of no use after a failed tick
  bool taken = false;    // back_up() was called in this tick
};

// Saves the body before a tick changes it for the first time.
void back_up(DeformableState&, Backup&);

// False: the tick must be undone.
[[nodiscard]] bool is_finite(const DeformableState&, const Motion&);

// Undoes the tick: the body is restored from the backup, the motion from `begin` but with zero velocities. Numbers that were
// not finite even before the tick get their baked values.
void restore(const Model&, const Motion& begin, Backup&, DeformableState&, Motion&);

// Call it every tick in which a free body is at rest. Some of its tets may be inverted or flat: they are stuck between tets
// that flowed while all of them were crushed further than now. No crash leaves a car in that shape, so this reverts a part of
// the flow around them, or of the whole body if there is none around them. Returns whether there was any flow to revert.
bool revert_inverted(const Model&, DeformableState&);

}  // namespace crumple

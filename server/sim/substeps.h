// How a tick is cut into sub-steps. They are a share of time, not of a tick, so that the tick rate does not change the crush.
// They are halved, up to halvings times, while in one of them the car would meet an obstacle by more than substep_travel, or
// contacts would turn its motion by more than substep_turn (their force is stepped explicitly). Fewer sub-steps than the
// default raise both limits in proportion; coarse meshes lose little accuracy.
#pragma once

#include <algorithm>
#include <cmath>
#include <span>

#include "sim/contacts.h"
#include "sim/step.h"

namespace crumple {

inline constexpr double substep_travel = 0.08;  // m: an edge of a 10,000-node car
inline constexpr double substep_turn = 1.1;     // radians
inline constexpr int halvings = 3;

inline double substep_seconds(int substeps) { return 1.0 / (60.0 * substeps); }
inline double substep_seconds(const Parameters& parameters) { return substep_seconds(parameters.substeps); }
inline double coarseness(const Parameters& parameters) {
  return std::max(1.0, double(Parameters{}.substeps) / double(parameters.substeps));
}

// Sub-steps of a tick, for so many in 1/60 s; before they are halved.
inline int substep_count(int substeps, double seconds) {
  return std::max(1, int(std::lround(seconds / substep_seconds(substeps))));
}

// How many the tick makes, for the candidates that were found.
int choose_substeps(const StepInput&, const ContactSet&, const DeformableState&, const Motion&);

// Where the car's frame goes in a sub-step: with the velocity half-way through it, if the contacts' force stays. With the
// velocity at its start each sub-step would create the energy impulse^2 / (2 mass).
Pose path(const Mass&, const DeformableState&, const Motion&, double h);

// Share of the sub-step that is left when the first contact closes, so that a crash begins at the touch; 1 if none closes.
float after_touch(std::span<const Contact>);

}  // namespace crumple

// How a tick is divided into sub-steps. Their length is a share of a second, not of a tick, so the tick rate does not change
// the crush. Sub-steps are halved, up to `halvings` times, while in one of them the car would meet an obstacle by more than
// substep_travel, or contacts would turn its motion by more than substep_turn (their force is integrated explicitly). Fewer
// sub-steps than the default raise both limits in proportion; coarse meshes lose little accuracy.
#pragma once

#include <algorithm>
#include <cmath>
#include <span>

#include "sim/contacts.h"
#include "sim/step.h"

namespace crumple {

inline constexpr double substep_travel = 0.08;  // m: edge length of a 10,000-node car
inline constexpr double substep_turn = 1.1;     // radians
inline constexpr int halvings = 3;

inline double substep_seconds(int substeps) { return 1.0 / (60.0 * substeps); }
inline double substep_seconds(const Parameters& parameters) { return substep_seconds(parameters.substeps); }
inline double coarseness(const Parameters& parameters) {
  return std::max(1.0, double(Parameters{}.substeps) / double(parameters.substeps));
}

// Sub-steps of a tick before halving; `substeps`: their number in 1/60 s.
inline int substep_count(int substeps, double seconds) {
  return std::max(1, int(std::lround(seconds / substep_seconds(substeps))));
}

// Sub-steps of this tick, halving included. Call it after find_candidates(). closing: the fastest at which a near car may come,
// m/s; 0: none is near.
int choose_substeps(const StepInput&, const ContactSet&, const DeformableState&, const Motion&, double closing = 0);

// The car's pose after a sub-step of h seconds, moved with the velocity half-way through it if the contact force stays the
// same. With the velocity at the start each sub-step would create the energy impulse^2 / (2 mass).
Pose path(const Mass&, const DeformableState&, const Motion&, double h);

// Share of the sub-step that remains when the first contact closes, so that a crash begins at the touch; 1 if none closes.
class Touchdown {
 public:
  // Gap of a contact at both ends of the sub-step if the bodies stood still in their frames, m.
  void add(float before, float after) {
    if (after < 0) earliest_ = std::min(earliest_, before > 0 ? before / (before - after) : 0.0f);
  }
  float rest() const;

 private:
  float earliest_ = 1;
};

}  // namespace crumple

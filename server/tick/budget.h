// Chooses how many sub-steps and sweeps each car may make in a tick, so that the tick fits the budget.
#pragma once

#include <cstdint>
#include <vector>

#include "tick/islands.h"
#include "tick/state.h"

namespace crumple {

// An input that sets the budget of this tick and all later ones, in tet visits per tick; 0: no limit. Only the program sends
// it. The world has no clock, so the caller measures time and the budget is recorded like every other input.
Message budget_message(uint64_t visits);

// Tet visits that a car's last tick took, and that a tick would take if the car crashed on this level.
double work_of(const Model&, const StepResult&);
double crash_work(const World&, const Instance&, const Car& level);
// Sets the sub-steps and sweeps of each car for this tick. All cars of an island get the same cuts, because they are solved
// together.
void ration(World&, const std::vector<Island>&);

}  // namespace crumple

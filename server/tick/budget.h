// How many sub-steps and sweeps each car may make in a tick, so that all of them fit the budget.
#pragma once

#include <cstdint>
#include <vector>

#include "tick/state.h"

namespace crumple {

// An input that sets the budget of the ticks from then on: tet visits a tick; 0: none. Only the program sends it: the world
// knows no clock, and so what it is measured by is recorded like all inputs.
Message budget_message(uint64_t visits);

// What a tick of a car has come to, in tet visits, and what it would come to if the car crashed on this level.
double work_of(const Model&, const StepResult&);
double crash_work(const World&, const Instance&, const Car& level);
// Sets the sub-steps and sweeps of each car for this tick.
void ration(World&, const std::vector<Instance*>&);

}  // namespace crumple

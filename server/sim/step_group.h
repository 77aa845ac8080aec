// One sub-step of an island: first all contacts, then group by group the new shapes, the plastic flow and the change of the
// motion. The cars of a group touch one another and are solved as one system.
#pragma once

#include <span>
#include <vector>

#include "sim/island.h"
#include "sim/pairs.h"
#include "sim/timer.h"

namespace crumple {

// Moves the cars' frames by a sub-step, finds all contacts in it, and groups the cars by those with each other.
std::vector<PairGroup> meet(std::span<Member> island, const Substep&, Timer*);

// Solves a group of cars, or one car. Cars at rest that nothing wakes are not solved.
void step_group(std::span<Member> island, PairGroup&, const Substep&, Timer*);

}  // namespace crumple

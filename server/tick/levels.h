// Levels of a car: baked cars of one surface with fewer and fewer nodes. A car that nothing touches may change its level.
#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "car/car.h"
#include "tick/state.h"

namespace crumple {

// A car that may be spawned from now on; to be called between ticks. Assets with the same surface are levels of one car.
void add_asset(World&, std::shared_ptr<const Car>);
// How many levels below it an asset has.
size_t coarser_levels(const World&, const std::string& asset);

// Finds what comes near the car, so that it may change its level. woken: in this very tick.
void look_ahead(const World&, Instance&, bool woken);
// The cars that change their level now: to the one that the importance asks for, or to a coarser one that the budget has room
// for.
std::vector<Instance*> choose_levels(const World&, const std::vector<Instance*>&);
void change_level(const World&, Instance&, Worker&);

}  // namespace crumple

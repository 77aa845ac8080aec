// Levels of a car: baked cars of one surface with different numbers of nodes. A car that nothing touches may change its level.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "car/car.h"
#include "tick/state.h"

namespace crumple {

// Adds a car that hosts may spawn. Call it between ticks. Assets with the same surface are levels of one car.
void add_asset(World&, std::shared_ptr<const Car>);
// Number of levels coarser than this asset.
size_t coarser_levels(const World&, const std::string& asset);

inline constexpr double notice = 0.5;  // s: a car may change its level this long before something can touch it

// Finds the things that are about to touch the car, so that it may change its level. woken: an obstacle wakes it in this tick.
void look_ahead(const World&, Instance&, std::span<const Obstacle>, bool woken);
// Sets next_level of the cars that change their level now and returns these cars. The level follows from the car's importance,
// or is a coarser one that fits the budget.
std::vector<Instance*> choose_levels(const World&, const std::vector<Instance*>&);
void change_level(const World&, Instance&);

}  // namespace crumple

// Which cars may touch one another: found once a tick, in the order of the cars' ids, before the cars are advanced.
#pragma once

#include <vector>

#include "tick/state.h"

namespace crumple {

// Most cars that one car notices around it: those that come nearest in this tick. More than these can hardly touch it, unless
// they stand inside each other.
inline constexpr size_t neighbour_limit = 16;

// Names a car to the others in all ticks.
uint64_t key_of(const std::string& id);

// Lets all cars forget that they touched cars that were placed in this tick, so that no force of the last tick goes on, and it
// is tested anew whether the cars stand inside each other. Cars that pass through each other do so until they have parted.
void forget_placed(const std::vector<Instance*>& cars);

// Fills Instance::near with the cars that may come near within the time that a car looks ahead. Two cars that stand and do not
// touch do not notice each other. Wakes idle cars that something comes near to.
void find_neighbours(const World&, const std::vector<Instance*>& cars);

// The neighbours of a car as obstacles, for look_ahead(): boxes around their bodies that move as they do.
void add_boxes(const std::vector<Instance*>& cars, const Instance& car, std::vector<Obstacle>& out);

// Divides all cars into islands: cars that may touch one another within this tick, ascending. Most islands are one car.
using Island = std::vector<Instance*>;
std::vector<Island> find_islands(const World&, const std::vector<Instance*>& cars);

}  // namespace crumple

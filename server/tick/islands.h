// Finds the cars that may touch one another: once a tick, in the order of the cars' ids, before the cars are advanced.
#pragma once

#include <span>
#include <vector>

#include "tick/state.h"

namespace crumple {

// Most cars that one car notices, and so may touch: first the cars that pressed against it in the last tick, then the cars that
// come nearest in this tick. More cars can hardly touch it, unless they stand inside each other. It passes through all others.
inline constexpr size_t neighbour_limit = 16;
// Most cars of an island. They are solved together by one worker, which keeps 1 MB for each car of 1,000 nodes and 5 MB for
// each of 5,000. Cars that are in different islands because of this limit pass through each other.
inline constexpr size_t island_limit = 128;

// The key by which other cars know a car, in all ticks.
uint64_t key_of(const std::string& id);

// Lets all cars forget their contacts with cars that were placed in this tick: no force of the last tick goes on, and the tick
// tests anew whether these cars stand inside each other. Cars that pass through each other do so until they have parted.
void forget_placed(const std::vector<Instance*>& cars);

// Fills Instance::near with the cars that may come near within the time that a car looks ahead. Two cars that stand and do not
// touch do not notice each other. Wakes idle cars that something comes near to.
void find_neighbours(const World&, const std::vector<Instance*>& cars);

// The neighbours of a car as obstacles, for look_ahead(): boxes around their bodies that move as they do.
void add_boxes(const std::vector<Instance*>& cars, const Instance& car, std::vector<Obstacle>& out);

// Divides all cars into islands: cars that may touch one another within this tick, ascending. Most islands are one car. If an
// island would have more than island_limit cars, the cars that pressed against each other in the last tick stay together first.
using Island = std::vector<Instance*>;
std::vector<Island> find_islands(const World&, const std::vector<Instance*>& cars);

// For each car of an island: the cars of the island that it notices, as positions in the island, ascending.
std::vector<std::vector<uint32_t>> near_in(std::span<Instance* const> island);

}  // namespace crumple

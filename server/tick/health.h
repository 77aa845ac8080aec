// What the server tells about itself: times of its rooms, counts against their limits, refusals by reason.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "tick/world.h"
#include "wire/refusal.h"

namespace crumple {

// A count of the caller, such as what the transport dropped. limit 0: none.
struct MoreCount {
  std::string name;
  uint64_t value, limit = 0;
};
// Key "health": times of the ticks since the last call, counts and refusals since the start. late: ticks that the caller could
// not start in time.
Message health(World&, uint64_t late, const std::vector<MoreCount>& more_counts);

// Counts a refusal.
void count(World&, const Refusal&);
// Refusals since the start, and the sentence of the last one, for the log of whoever runs the server.
uint64_t refusal_count(const World&);
const std::string& last_refusal(const World&);

}  // namespace crumple

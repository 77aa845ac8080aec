// The server's report about itself: times of its parts, counts with their limits, refusals by reason.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "tick/world.h"
#include "wire/refusal.h"

namespace crumple {

// A count that the caller adds, such as messages dropped by the transport. limit 0: no limit.
struct MoreCount {
  std::string name;
  uint64_t value, limit = 0;
};
// The message with key "health": times of the ticks since the last call, counts and refusals since the start. late: ticks that
// the caller could not start in time.
Message health(World&, uint64_t late, const std::vector<MoreCount>& more_counts);

// Counts a refusal, or several of the same kind.
void count(World&, const Refusal&, uint64_t times = 1);
// Number of refusals since the start, and the sentence of the last one, for the server's log.
uint64_t refusal_count(const World&);
const std::string& last_refusal(const World&);

}  // namespace crumple

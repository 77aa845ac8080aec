// The messages of a tick, in the order in which they came. A bad one is refused whole, counted, answered if it was a query, and
// changes nothing.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "protocol/message.h"
#include "tick/world.h"
#include "wire/refusal.h"

namespace crumple {

struct Host;

// A query for a keyframe, which is answered when the tick is done.
struct Asked {
  std::string key, car;
  size_t level;  // of the surface
  uint64_t ticket;
};

void read(World&, const Inbox&, Outbox&, std::vector<Asked>&);

// The host of this id, new where there was none; null where there are too many.
Host* find_or_add_host(World&, const std::string& id);
// Drops a host that has neither cars nor obstacles.
void release_host(World&, const std::string& id);
// Answers a query with a refusal or with ok; a sample (ticket 0) gets no answer. state: of a car that was saved.
void answer(const World&, const std::string& key, uint64_t ticket, const std::optional<Refusal>&, const Bytes& state,
            bool failed, Outbox&);

}  // namespace crumple

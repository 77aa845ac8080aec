// Reads the messages of a tick in the order in which they came. A bad message is refused whole: it is counted, answered if it
// was a query, and changes nothing.
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

// A query for a keyframe. The tick answers it at its end.
struct Asked {
  std::string key, car;
  size_t level;  // surface level
  uint64_t ticket;
};

void read(World&, const Inbox&, Outbox&, std::vector<Asked>&);

// Finds the host with this id, or adds it; null if there are too many hosts.
Host* find_or_add_host(World&, const std::string& id);
// Removes the host if it has neither cars nor obstacles.
void release_host(World&, const std::string& id);
// Answers a query with a refusal or with ok; a sample (ticket 0) gets no answer. state: the answer to Save.
void answer(const World&, const std::string& key, uint64_t ticket, const std::optional<Refusal>&, const Bytes& state,
            bool failed, Outbox&);

}  // namespace crumple

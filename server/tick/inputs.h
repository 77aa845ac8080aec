// The inputs of one tick as one message, for servers that make the same ticks.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "tick/world.h"

namespace crumple {

struct TickInputs {
  uint64_t tick = 0;
  uint64_t hash = 0;  // of the world after it; 0: not known
  Inbox inbox;
};

// Key "replica/inputs". Messages that are no inputs are left out.
Message inputs_message(uint64_t tick, const Inbox&, uint64_t hash);
// Bytes must be aligned to 8. Empty if they are no Inputs of schema/message.fbs.
std::optional<TickInputs> read_inputs(std::span<const std::byte>);

}  // namespace crumple

// The inputs of one tick as one message, for servers that compute the same ticks.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "tick/world.h"

namespace crumple {

struct TickInputs {
  uint64_t tick = 0;
  uint64_t hash = 0;  // of the world after the tick; 0: unknown
  Inbox inbox;
};

// The message with key "replica/inputs". It leaves out messages that are no inputs.
Message inputs_message(uint64_t tick, const Inbox&, uint64_t hash);
// The bytes must be aligned to 8. Returns nothing if they are no Inputs of schema/message.fbs.
std::optional<TickInputs> read_inputs(std::span<const std::byte>);

}  // namespace crumple

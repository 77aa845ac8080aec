// A whole world as bytes. A standby starts from it, and so does a recording that begins while cars are there.
#pragma once

#include <span>

#include "tick/world.h"

namespace crumple {

// Saves everything that the next tick depends on. Call it between ticks. Undamaged bodies take no room.
std::vector<std::byte> save_world(const World&);

// Replaces the world by the saved one; the next ticks are the same, bit for bit. The world needs the same assets (add_asset),
// rate and quantum. Throws std::runtime_error with one sentence if the bytes are damaged, have another format, or name an
// unknown asset; the world is then empty. Any world that loads can compute ticks.
void load_world(std::span<const std::byte>, World&);

// The same, but accepts a wrong checksum: tests build worlds with it. Returns whether the checksum is right.
bool load_unsummed_world(std::span<const std::byte>, World&);

}  // namespace crumple

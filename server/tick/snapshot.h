// A whole world as bytes: what a server that stands by begins with, and a recording that does not begin with an empty world.
#pragma once

#include <span>

#include "tick/world.h"

namespace crumple {

// Everything that the next tick depends on; between ticks. Bodies that are as baked take no room.
std::vector<std::byte> save_world(const World&);

// Puts it in place of what the world holds; the next ticks are the same, bit for bit. The world needs the same assets
// (add_asset), rate and quantum. Throws std::runtime_error with one sentence, and the world is then empty: the bytes are
// damaged, of another format, or name an asset that is not here. Whatever is loaded, ticks can be made of.
void load_world(std::span<const std::byte>, World&);

// The same for bytes whose sum was not made by save_world: tests make up worlds with it. Returns whether the sum is right.
bool load_unsummed_world(std::span<const std::byte>, World&);

}  // namespace crumple

// Everything that the next tick depends on, as one number.
#pragma once

#include <cstdint>

#include "tick/world.h"

namespace crumple {

// The same after the same inboxes, for any thread count and instruction set.
uint64_t hash(const World&);

}  // namespace crumple

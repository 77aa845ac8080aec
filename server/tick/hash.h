// One hash of everything that the next tick depends on.
#pragma once

#include <cstdint>

#include "tick/world.h"

namespace crumple {

// Equal after equal inboxes, for any thread count and instruction set.
uint64_t hash(const World&);

}  // namespace crumple

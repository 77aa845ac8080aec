// Commands on a car: spawn, despawn, repair, parameters, save, load, replace. Each is done completely or refused with a
// sentence.
#pragma once

#include <string>

#include "tick/world.h"
#include "wire/decode.h"

namespace crumple {

// Executes the order. state receives the answer to Save.
[[nodiscard]] std::optional<Refusal> obey(World&, const std::string& car, Order&&, Bytes& state);

}  // namespace crumple

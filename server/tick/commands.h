// Commands on a car: spawn, despawn, repair, parameters, save, load, replace. Each is done whole or refused with a sentence.
#pragma once

#include <string>

#include "tick/world.h"
#include "wire/decode.h"

namespace crumple {

// state: the answer to Save.
[[nodiscard]] std::optional<Refusal> obey(World&, const std::string& car, Order&&, Bytes& state);

}  // namespace crumple

// What health says, as the page that Prometheus reads: text format 0.0.4, names by its conventions (seconds, metres, _total).
#pragma once

#include <string>

#include "tick/world.h"

namespace crumple {

// health: as health() of world.h gives it. Every count of it is on the page.
std::string metrics_page(const Message& health, const std::string& scene);

}  // namespace crumple

// Converts health to the page that Prometheus reads: text format 0.0.4, names by its conventions (seconds, metres, _total).
#pragma once

#include <string>

#include "tick/world.h"

namespace crumple {

// health: the message of health() in tick/health.h. The page has all its counts.
std::string metrics_page(const Message& health, const std::string& scene);

}  // namespace crumple

// A recording played to viewers: its outputs at their times, and keyframes and assets for those who ask.
#pragma once

#include "replay.h"

namespace crumple {

// Every file once, or for ever with options.loop. Throws std::runtime_error with one sentence.
void show_films(const ReplayOptions&, const std::atomic<bool>& stop);

}  // namespace crumple

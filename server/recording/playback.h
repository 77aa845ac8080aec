// A recording played to viewers: at their times its outputs and where hosts had cars and obstacles, and keyframes and assets
// for those who ask.
#pragma once

#include "io/net.h"
#include "recording/replay.h"

namespace crumple {

// Every file once, or for ever with options.loop. Throws std::runtime_error with one sentence.
void serve_playback(const ReplayOptions&, const std::atomic<bool>& stop);
// The same on a session that is open.
void play_recordings(Net*, const ReplayOptions&, const std::atomic<bool>& stop);

}  // namespace crumple

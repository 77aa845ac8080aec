// Plays a recording to viewers: publishes its outputs, poses and obstacles at their times, and answers queries for keyframes
// and assets.
#pragma once

#include "io/net.h"
#include "recording/replay.h"

namespace crumple {

// Plays every file once, or for ever with options.loop. Throws std::runtime_error with one sentence.
void serve_playback(const ReplayOptions&, const std::atomic<bool>& stop);
// The same on an open session.
void play_recordings(Net*, const ReplayOptions&, const std::atomic<bool>& stop);

}  // namespace crumple

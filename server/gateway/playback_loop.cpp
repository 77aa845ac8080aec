#include "gateway/playback_loop.h"

#include <cstdio>
#include <exception>

#include "gateway/need.h"
#include "recording/playback.h"
#include "recording/recording.h"

namespace crumple {

void PlaybackLoop::start(const std::string& file, double speed) {
  scene_ = RecordingReader(file).head().scene;
  need(net_open("peer", "tcp/127.0.0.1:0", nullptr, nullptr, 0, &net_));
  thread_ = std::thread([this, file, speed] {
    try {
      ReplayOptions replay;
      replay.files = {file};
      replay.speed = speed;
      replay.loop = true;
      play_recordings(net_, replay, stop_);
    } catch (const std::exception& error) {
      std::fprintf(stderr, "crumple view: %s\n", error.what());
    }
  });
}

std::string PlaybackLoop::endpoint() const { return net_endpoint(net_); }

PlaybackLoop::~PlaybackLoop() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
  if (net_) net_close(net_);
}

}  // namespace crumple

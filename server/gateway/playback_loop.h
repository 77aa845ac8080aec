// Plays a recording again and again on its own session, as if it were a server.
#pragma once

#include <atomic>
#include <string>
#include <thread>

#include "io/net.h"

namespace crumple {

class PlaybackLoop {
 public:
  ~PlaybackLoop();
  void start(const std::string& file, double speed);
  // The scene of the recording, and the endpoint that serves it.
  std::string scene() const { return scene_; }
  std::string endpoint() const;

 private:
  Net* net_ = nullptr;
  std::string scene_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

}  // namespace crumple

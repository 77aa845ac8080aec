// `crumple replay FILE...`: plays a recording as an experiment (--verify: computes the ticks from their inputs again and
// compares every hash and output) or as a film (--publish: sends the outputs again, at any speed, to all viewers).
#pragma once

#include <atomic>
#include <string>
#include <vector>

namespace crumple {

struct ReplayOptions {
  std::vector<std::string> files;
  bool verify = false;
  bool publish = false;
  int threads = 0;                            // for verify; 0: as many as there are cores
  std::string listen = "tcp/127.0.0.1:7447";  // for publish
  std::string network;                        // for publish: JSON5 of zenoh's own configuration, overrides ours; empty: none
  double speed = 1;
  double from = 0;  // s since the first tick
  bool loop = false;
};

// Returns the exit code: 1 if some tick differs. Throws std::runtime_error with one sentence if it cannot start.
int replay(const ReplayOptions&, const std::atomic<bool>& stop);

}  // namespace crumple

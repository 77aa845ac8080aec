// `crumple replay FILE...`: a recording as an experiment (--verify: the inputs run again, of every tick its hash and all that
// it gave compared) or as a film (--publish: the outputs sent again, at any speed, to whoever watches).
#pragma once

#include <atomic>
#include <string>
#include <vector>

namespace crumple {

struct ReplayOptions {
  std::vector<std::string> files;
  bool verify = false;
  bool publish = false;
  int threads = 0;                            // of verify; 0: as many as there are cores
  std::string listen = "tcp/127.0.0.1:7447";  // of publish
  std::string network;                        // of publish: JSON5 of zenoh's own configuration, laid over ours; empty: none
  double speed = 1;
  double from = 0;  // s since the first tick
  bool loop = false;
};

// Returns the exit code: 1 if some tick differs. Throws std::runtime_error with one sentence if it cannot start.
int replay(const ReplayOptions&, const std::atomic<bool>& stop);

}  // namespace crumple

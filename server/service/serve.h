// `crumple serve`: the world on the network. A fixed tick on an absolute schedule: what arrived before it is its inbox, what
// it gives back is published after it; with --record both go to a file as well. A signal ends it between two ticks.
#pragma once

#include <atomic>
#include <string>
#include <vector>

namespace crumple {

struct ServeOptions {
  std::vector<std::string> cars;  // baked files that may be spawned
  std::string scene = "main";
  std::string listen = "tcp/127.0.0.1:7447";  // port 0: any free one, printed
  std::string connect;                        // endpoints of routers, in place of listen; empty: none
  bool standby = false;                       // waits until the scene's server is gone, and goes on in its place
  std::string network;                        // JSON5 of zenoh's own configuration, laid over ours; empty: none
  double rate = 60;                           // ticks a second
  int threads = 0;                            // 0: as many as there are cores
  double budget_ms = 12;                      // that the cars of a tick may take; 0: no limit
  double quantum_mm = 0.5;
  std::string record;         // file, with the start's time (UTC) for %F and the like; empty: none
  double record_minutes = 0;  // then goes on in a file of its own, named anew; 0: all in one
  double record_most = 0;     // GB of its files together, beyond which the oldest go; 0: all are kept
  std::string metrics;        // HOST:PORT for Prometheus; empty: none
  double seconds = 0;         // ends after these; 0: by SIGINT or SIGTERM
  bool check = false;         // only says whether all this is good
};

// Returns the exit code. Throws std::runtime_error with one sentence if it cannot start.
int serve(const ServeOptions&, const std::atomic<bool>& stop);

}  // namespace crumple

// `crumple serve`: the world on the network. Ticks run on a fixed schedule: the messages that arrived before a tick are its
// inbox, and its outbox is published after it. With --record both are also written to a file. A signal ends it between two
// ticks.
#pragma once

#include <atomic>
#include <string>
#include <vector>

namespace crumple {

struct ServeOptions {
  std::vector<std::string> cars;  // baked files that hosts may spawn
  std::string scene = "main";
  std::string listen = "tcp/127.0.0.1:7447";  // port 0: any free one, printed
  std::string connect;                        // endpoints of routers, instead of listen; empty: none
  bool standby = false;                       // wait until the scene's server is gone, then take over
  std::string network;                        // JSON5 of zenoh's own configuration, overrides ours; empty: none
  double rate = 60;                           // ticks a second
  int threads = 0;                            // 0: as many as there are cores
  double budget_ms = 12;                      // ms that the cars of one tick may take; 0: no limit
  double quantum_mm = 0.5;
  std::string record;         // file name; %F and the like become the start's time (UTC); empty: none
  double record_minutes = 0;  // minutes per file, then a new one begins; 0: all in one file
  double record_most = 0;     // GB of all its files together; beyond it the oldest are deleted; 0: all are kept
  std::string metrics;        // HOST:PORT for Prometheus; empty: none
  double seconds = 0;         // end after this many seconds; 0: at SIGINT or SIGTERM
  bool check = false;         // only check the options
};

// Returns the exit code. Throws std::runtime_error with one sentence if it cannot start.
int serve(const ServeOptions&, const std::atomic<bool>& stop);

}  // namespace crumple

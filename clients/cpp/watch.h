// `crumple watch` is a viewer. Once a second it prints what it holds: tick, nodes, how many of them are displaced, the quantum,
// the hash, which must be the server's, and bytes a second.
#pragma once

#include <atomic>
#include <string>

namespace crumple::client {

struct WatchOptions {
  std::string connect = "tcp/127.0.0.1:7447";
  std::string network;  // as CrumpleOptions.network; empty: none
  std::string scene = "main";
  std::string car;     // empty: all
  int level = 0;       // of the surface
  bool once = false;   // prints and ends as soon as a surface is held
  double seconds = 0;  // ends after these; 0: by SIGINT (with once: 10)
  std::string obj;     // where to write the surface held at the end
};

// Returns the exit code: 1 if nothing was held at the end. Throws std::runtime_error with one sentence if it cannot start.
int watch(const WatchOptions&, const std::atomic<bool>& stop);

}  // namespace crumple::client

// `crumple router`: passes messages between servers, hosts and viewers that connect to it, and holds nothing of a scene.
#pragma once

#include <atomic>
#include <string>

namespace crumple {

struct RouterOptions {
  std::string listen = "tcp/127.0.0.1:7447";  // port 0: any free one, printed
  std::string connect;                        // endpoints of other routers; empty: none
  std::string network;                        // JSON5 of zenoh's own configuration, overrides ours; empty: none
};

// Returns the exit code. Throws std::runtime_error with one sentence if it cannot start.
int router(const RouterOptions&, const std::atomic<bool>& stop);

}  // namespace crumple

// `crumple view`: shows a scene in browsers. It serves one page over HTTP and one WebSocket, on which each browser gets the
// bytes that zenoh carries. clients/web/src/live.ts is the other end.
#pragma once

#include <atomic>
#include <string>
#include <vector>

namespace crumple {

struct ViewOptions {
  // One recording: played again and again instead of a server's scene. Two: the page compares them.
  std::vector<std::string> files;
  double speed = 1;  // of the recording
  std::string connect = "tcp/127.0.0.1:7447";
  std::string network;  // JSON5 of zenoh's own configuration, overrides ours; empty: none
  std::string scene = "main";
  std::string listen = "127.0.0.1:8080";  // HOST:PORT; port 0: any free one, printed
  bool control = false;                   // browsers may command and paint cars
  std::string page;                       // HTML file; empty: web/index.html beside the program
};

// Returns the exit code. Throws std::runtime_error with one sentence if it cannot start.
int view(const ViewOptions&, const std::atomic<bool>& stop);

}  // namespace crumple

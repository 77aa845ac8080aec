// `crumple drive SCENE` is a host that behaves well, for others to copy from. It moves its car along a script until the car
// hits something, takes pose and velocity from the reactions, brakes to rest, and says what happened.
#pragma once

#include <atomic>
#include <string>

namespace crumple::client {

struct DriveOptions {
  std::string file;  // the scene
  std::string connect = "tcp/127.0.0.1:7447";
  std::string network;         // as CrumpleOptions.network; empty: none
  std::string scene = "main";  // of the server
  std::string host = "drive";
  std::string id = "car";  // of the car that it spawns
  std::string car;         // baked car: file or hash; empty: the scene's
  std::string preset;      // file of parameters that override the scene's; empty: none
  double rate = 0;         // poses a second; 0: the scene's
  bool leave = false;      // the car stays in the scene when drive ends
};

// Returns the exit code. Throws std::runtime_error with one sentence if it cannot start.
int drive(const DriveOptions&, const std::atomic<bool>& stop);

}  // namespace crumple::client

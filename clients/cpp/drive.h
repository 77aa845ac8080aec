// `crumple drive SCENE` is a host that behaves well, for others to copy from; or several hosts, as the scene says. They move
// their cars along a script until the cars hit something, take pose and velocity from the reactions, brake to rest, and say
// what happened.
#pragma once

#include <atomic>
#include <string>

namespace crumple::client {

struct DriveOptions {
  std::string file;  // the scene
  std::string connect = "tcp/127.0.0.1:7447";
  std::string network;         // as CrumpleOptions.network; empty: none
  std::string scene = "main";  // of the server
  std::string host = "drive";  // of the cars for which the scene names none
  std::string id;              // of the car of a scene that names none; empty: "car"
  std::string car;             // baked car of all cars: file or hash; empty: the scene's
  std::string preset;          // file of parameters that override the scene's; empty: none
  double rate = 0;             // poses a second; 0: the scene's
  bool leave = false;          // the cars stay in the scene when drive ends
};

// Returns the exit code. Throws std::runtime_error with one sentence if it cannot start.
int drive(const DriveOptions&, const std::atomic<bool>& stop);

}  // namespace crumple::client

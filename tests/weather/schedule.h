// One schedule, drawn from a seed: real servers, hosts and viewers, strangers, and faults; then calm, in which all laws must
// hold in the end.
#pragma once

#include <cstdint>
#include <string>

namespace crumple::weather {

struct Ended {
  std::string broken;  // the broken law with details; empty: none
  uint64_t digest = 0;
  double seconds = 0;  // simulated
};

// car_file: the baked car of all hosts; asset: its hash.
Ended run_schedule(uint64_t seed, const std::string& car_file, const std::string& asset);

}  // namespace crumple::weather

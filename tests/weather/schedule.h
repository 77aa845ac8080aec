// One schedule: what the seed draws. Servers, hosts and viewers as they are, strangers, and what befalls them; then calm, in
// which all laws must come to hold.
#pragma once

#include <cstdint>
#include <string>

namespace crumple::weather {

struct Ended {
  std::string broken;  // the law, and how; empty: none
  uint64_t digest = 0;
  double seconds = 0;  // simulated
};

// car_file: the baked car that all drive; asset: its hash.
Ended run_schedule(uint64_t seed, const std::string& car_file, const std::string& asset);

}  // namespace crumple::weather

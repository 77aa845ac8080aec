// Encodes all messages except surfaces (protocol/surface_codec.h). schema/message.fbs describes the fields.
#pragma once

#include <string>
#include <vector>

#include "schema/message_generated.h"
#include "sim/deform.h"
#include "wire/decode.h"

namespace crumple {

// What one tick did to one car.
struct CarReaction {
  std::string car;
  Motion motion;  // at the end of the tick
  StepResult result;
  double absorbed = 0, stored = 0;  // J
  struct Partner {
    std::string car, host;
    Eigen::Vector3d impulse;  // N s, world axes
    uint32_t contacts;
  };
  std::vector<Partner> partners;  // in the order of the message
};
Bytes encode_reactions(uint64_t tick, double time, const std::vector<CarReaction>&);

Bytes encode_answer(uint64_t tick, const std::optional<Refusal>&, const Bytes& state = {});
Bytes encode_state(const std::string& asset, const DeformableState&);
Bytes encode_tick_end(const TickEnd&);
Bytes encode_budget(uint64_t work);

struct HealthReport {
  struct Room {
    std::string name;
    double mean, worst;  // seconds per tick
  };
  struct Count {
    std::string name;
    uint64_t value, limit;  // limit 0: no limit
  };
  uint64_t tick = 0;
  double rate = 0;  // ticks a second
  uint64_t late = 0;
  std::vector<Room> rooms;
  std::vector<Count> counts, refusals;
  struct CarTold {
    std::string car;
    std::vector<uint64_t> ticks;  // by surface level
  };
  std::vector<CarTold> told;
};
Bytes encode_health(const HealthReport&);

}  // namespace crumple

// Host and server both move a car: the host along its intended path, the server where contacts stop it. Each learns late of the
// other's changes. In: the car's own motion, the host's intent, and the velocity changes by contacts since the tick that the
// host has seen. Out: the motion from which the tick starts. Law: an impulse that the host has not seen is never lost or
// counted twice.
#pragma once

#include <array>
#include <cstdint>

#include "wire/decode.h"

namespace crumple {

// Changes of a car's velocity by contacts, tick by tick. 64 ticks: the intent of a host one second behind can still be used.
struct ImpulseLog {
  struct Change {
    uint64_t tick = 0;
    Eigen::Vector3d velocity = Eigen::Vector3d::Zero();          // m/s
    Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  // rad/s
  };
  std::array<Change, 64> changes;  // tick k is at k % 64

  void add(const Change& change) { changes[change.tick % changes.size()] = change; }
  // Sum of all changes in the ticks (seen, now). Its tick is the last of them; 0 if there was none.
  Change since(uint64_t seen, uint64_t now) const;
};

uint64_t hash(const ImpulseLog&);

inline constexpr double teleport = 5;  // m: a pose farther than this from the car's own means a new place, not a disagreement

// now: the current tick. touching: in the previous tick an obstacle or a car touched the car, or a car was near.
Motion reconcile(const Motion& own, const Intent&, const ImpulseLog&, uint64_t now, bool touching);

}  // namespace crumple

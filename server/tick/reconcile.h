// Host and server both move a car: the host along the path it intends, the server where contacts stop it, and each hears of the
// other late. In: the car's own motion, what the host sent, and what contacts did since the tick the host has seen. Out: the
// motion the tick starts from. Law: an impulse that the host has not seen yet is never lost and never counted twice.
#pragma once

#include <array>
#include <cstdint>

#include "wire/decode.h"

namespace crumple {

// What contacts did to a car's velocity, tick by tick. 64 ticks: a host that is a second behind is still understood.
struct ImpulseLog {
  struct Change {
    uint64_t tick = 0;
    Eigen::Vector3d velocity = Eigen::Vector3d::Zero();          // m/s
    Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  // rad/s
  };
  std::array<Change, 64> changes;  // that of tick k at k % 64

  void add(const Change& change) { changes[change.tick % changes.size()] = change; }
  // The sum of all changes of ticks in (seen, now); its tick is that of the last one, 0 if there was none.
  Change since(uint64_t seen, uint64_t now) const;
};

uint64_t hash(const ImpulseLog&);

inline constexpr double teleport = 5;  // m: a pose farther than this from the car's own is a new place, not a disagreement

// now: the tick about to be done. touching: an obstacle touched the car in the tick before.
Motion reconcile(const Motion& own, const Intent&, const ImpulseLog&, uint64_t now, bool touching);

}  // namespace crumple

// What viewers are told of a car's surface, tick by tick.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "protocol/surface_codec.h"
#include "sim/model.h"

namespace crumple {

inline constexpr uint64_t keyframe_interval = 60;  // ticks between keyframes while deltas flow

// Displacements (m) in quanta, 3 a node: rounded half away from zero, clamped to +-32767. Weights of the skin are not negative
// and sum to 1, so that no vertex is farther off than half a quantum on each axis.
void quantise(std::span<const Vec3> displacement, float quantum, std::span<int16_t> quanta);

// What the viewers of one car on one level were told last.
struct ViewerState {
  std::vector<int16_t> keyframe;  // quanta of the last keyframe
  std::vector<int16_t> latest;    // quanta of the last message
  uint64_t tick = 0;              // of the last message
  uint64_t keyframe_tick = 0;     // 0: nothing was sent yet
  bool due = true;                // a keyframe must follow whatever comes: spawned, loaded, repaired
  bool flowing = false;           // deltas were sent since the keyframe
};

// The next message of a car, if there is anything to tell.
struct SurfaceUpdate {
  enum class Kind { none, keyframe, delta } kind = Kind::none;
  std::vector<Bytes> parts;
};

// A keyframe where one is due, where the body came to rest after deltas, and every `keyframe_interval` ticks while they flow; a
// delta where anything changed; otherwise nothing. settled: the body is at rest.
SurfaceUpdate update_viewers(const SurfaceHead&, bool settled, std::span<const int16_t> quanta, ViewerState&);

}  // namespace crumple

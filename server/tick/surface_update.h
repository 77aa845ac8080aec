// The messages about a car's surface that viewers receive, tick by tick.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "protocol/surface_codec.h"
#include "sim/model.h"

namespace crumple {

inline constexpr uint64_t keyframe_interval = 60;  // ticks between keyframes while deltas flow

// Converts displacements (m) to quanta, 3 per node: rounded half away from zero, clamped to +-32767. The skin's weights are not
// negative and sum to 1, so no vertex is off by more than half a quantum on each axis.
void quantise(std::span<const Vec3> displacement, float quantum, std::span<int16_t> quanta);

// The last messages that the viewers of one car received at one surface level.
struct ViewerState {
  std::vector<int16_t> keyframe;  // quanta of the last keyframe
  std::vector<int16_t> latest;    // quanta of the last message
  uint64_t tick = 0;              // of the last message
  uint64_t keyframe_tick = 0;     // 0: no keyframe was sent yet
  bool due = true;                // the next message must be a keyframe: spawned, loaded, repaired
  bool flowing = false;           // deltas were sent since the keyframe
};

// The next message about a car's surface, if there is news.
struct SurfaceUpdate {
  enum class Kind { none, keyframe, delta } kind = Kind::none;
  std::vector<Bytes> parts;
};

// Returns a keyframe if one is due, if the body came to rest after deltas, or every `keyframe_interval` ticks while deltas are
// sent; a delta if anything changed; otherwise nothing. settled: the body is at rest.
SurfaceUpdate update_viewers(const SurfaceHead&, bool settled, std::span<const int16_t> quanta, ViewerState&);

}  // namespace crumple

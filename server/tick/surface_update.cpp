#include "tick/surface_update.h"

#include <cstring>

namespace crumple {

void quantise(std::span<const Vec3> displacement, float quantum, std::span<int16_t> quanta) {
  static_assert(sizeof(Vec3) == 3 * sizeof(float));
  const auto* from = reinterpret_cast<const float*>(displacement.data());
  // Rounds away from zero by hand: std::round, fmin and fmax are function calls.
  for (size_t i = 0; i < 3 * displacement.size(); ++i) {
    const float number = from[i] / quantum;
    const float high = number > -32767.0f ? number : -32767.0f;  // also for NaN
    const float within = high < 32767.0f ? high : 32767.0f;
    const auto whole = int32_t(within);
    const float rest = within - float(whole);
    quanta[i] = int16_t(whole + (rest >= 0.5f) - (rest <= -0.5f));
  }
}

SurfaceUpdate update_viewers(const SurfaceHead& head, bool settled, std::span<const int16_t> quanta, ViewerState& told) {
  const bool changed =
      told.latest.size() != quanta.size() || std::memcmp(told.latest.data(), quanta.data(), quanta.size_bytes());
  const bool refresh = told.flowing && (settled || head.tick - told.keyframe_tick >= keyframe_interval);
  if (!told.due && !refresh && !changed) return {};
  told.latest.assign(quanta.begin(), quanta.end());
  told.tick = head.tick;
  if (told.due || refresh) {
    told.keyframe = told.latest;
    told.keyframe_tick = head.tick;
    told.due = told.flowing = false;
    return {SurfaceUpdate::Kind::keyframe, encode_keyframe(head, quanta)};
  }
  told.flowing = true;
  return {SurfaceUpdate::Kind::delta, encode_delta(head, quanta, told.keyframe_tick, told.keyframe)};
}

}  // namespace crumple

// Holds the surface of one car. In: keyframes and deltas, perhaps lost, repeated, reordered or hostile. Out: the surface, in
// quanta, of the newest complete tick. A surface is complete if and only if its XXH64 is the hash that its parts state.
// Messages older than the surface are dropped.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace crumple::viewer {

using Quanta = std::vector<int16_t>;  // 3 for each node of the skin

struct Gathering {  // the parts of one tick, until their hash is right
  uint64_t tick = 0;
  uint64_t hash = 0;
  Quanta quanta;
};

struct Surface {
  std::string asset;
  float quantum = 0;  // m
  uint64_t tick = 0;  // of the newest whole surface; meaningless while quanta is empty
  uint64_t hash = 0;
  Quanta quanta;
  uint64_t key_tick = 0;  // of the newest whole keyframe
  Quanta key;
  Gathering key_parts, delta_parts;
};

enum class Applied {
  whole,             // the surface has a newer tick now
  part,              // the part was taken in, and others are missing
  old,               // not newer than the surface
  missing_keyframe,  // the part was added; others are missing
  refused,           // malformed: `why` says how; the surface did not change
};

struct Outcome {
  Applied applied;
  std::string why;
};

// The bytes must be aligned to 8.
[[nodiscard]] Outcome apply_keyframe(std::span<const uint8_t>, Surface&);
[[nodiscard]] Outcome apply_delta(std::span<const uint8_t>, Surface&);

}  // namespace crumple::viewer

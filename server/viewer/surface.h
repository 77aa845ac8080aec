// What a viewer holds of one car. In: keyframes and deltas as they come, lost, doubled, reordered or hostile. Out: the
// quantised surface of the newest tick of which every part is there. Law: a surface is whole when its XXH64 is the one that
// its parts state, and nothing else makes it whole; what is older than what is held is dropped.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace crumple::client {

using Quanta = std::vector<int16_t>;  // 3 a node of the skin

struct Gathering {  // the parts of one tick, until its hash is met
  uint64_t tick = 0;
  uint64_t hash = 0;
  Quanta quanta;
};

struct Surface {
  std::string asset;
  float quantum = 0;  // m
  uint64_t tick = 0;  // newest whole tick; meaningless while quanta is empty
  uint64_t hash = 0;
  Quanta quanta;
  uint64_t key_tick = 0;  // newest whole keyframe
  Quanta key;
  Gathering key_parts, delta_parts;
};

enum class Applied {
  whole,             // the surface stands at a newer tick now
  part,              // taken in, more parts are to come
  old,               // not newer than what is held
  missing_keyframe,  // a delta against a keyframe that is not held: ask for it
  refused,           // malformed; `why` says so, the surface is untouched
};

struct Outcome {
  Applied applied;
  std::string why;
};

// Bytes must be aligned to 8.
[[nodiscard]] Outcome apply_keyframe(std::span<const uint8_t>, Surface&);
[[nodiscard]] Outcome apply_delta(std::span<const uint8_t>, Surface&);

}  // namespace crumple::client

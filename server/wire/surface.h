// A car's surface on its way to the viewers. In: displacements from rest of the nodes that its skin uses; there are fewer of
// them than vertices, and the viewer has the weights. Out: keyframes and deltas, each message below 64,000 bytes, so that it
// travels in one batch. Law: a delta is against the last keyframe, never against another delta; what a viewer holds after
// keyframe and delta is what the server holds, or is told from it by the hash.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "sim/model.h"
#include "wire/decode.h"

namespace crumple {

// The surface levels: how finely and how often viewers are told. 0 is for who is near. 1 is for who is far: half of 4 mm on
// each axis is a pixel of 1,920 over 90 degrees from 4 m on, and ten times a second is what positions of far players are sent
// at.
struct SurfaceLevel {
  int quanta;      // of the scene's that are one of its own
  uint64_t ticks;  // from message to message while the car moves; at rest it is told at once
};
inline constexpr std::array<SurfaceLevel, surface_level_count> surface_levels = {{{1, 1}, {8, 6}}};

inline constexpr size_t part_size = 64'000;        // bytes that no keyframe or delta message reaches
inline constexpr uint64_t keyframe_interval = 60;  // ticks between keyframes while deltas flow

// Displacements (m) in quanta, 3 a node: rounded half away from zero, clamped to +-32767. Weights of the skin are not negative
// and sum to 1, so that no vertex is farther off than half a quantum on each axis.
void quantise(std::span<const Vec3> displacement, float quantum, std::span<int16_t> quanta);

// Numbers of three axes as schema/message.fbs describes them: `now`, or its differences from `then` where that is not empty.
std::vector<uint16_t> pack(std::span<const int16_t> now, std::span<const int16_t> then);

// XXH64 of the displacements, little endian, seed 0.
uint64_t hash(std::span<const int16_t> displacement);

// What all messages about one surface state.
struct SurfaceHead {
  uint64_t tick = 0;
  std::string asset;
  float quantum = 0;  // m
};

// The displacements in parts of consecutive nodes, each at most `largest` nodes.
inline constexpr uint32_t part_nodes = 10'000;  // 61,250 bytes, where nothing can be packed
std::vector<Bytes> encode_keyframe(const SurfaceHead&, std::span<const int16_t> displacement, uint32_t largest = part_nodes);

// The differences from the keyframe of tick `keyframe_tick`, in parts.
std::vector<Bytes> encode_delta(const SurfaceHead&, std::span<const int16_t> displacement, uint64_t keyframe_tick,
                                std::span<const int16_t> keyframe);

// What the viewers of one car on one level were told last.
struct Told {
  std::vector<int16_t> keyframe;  // displacement of the last keyframe
  std::vector<int16_t> latest;    // of the last message
  uint64_t tick = 0;              // of the last message
  uint64_t keyframe_tick = 0;     // 0: nothing was sent yet
  bool due = true;                // a keyframe must follow whatever comes: spawned, loaded, repaired
  bool flowing = false;           // deltas were sent since the keyframe
};

// The next message of a car, if there is anything to tell: a keyframe where one is due, where the body came to rest after
// deltas and every `keyframe_interval` ticks while they flow; a delta where anything changed; otherwise nothing.
struct News {
  enum class Kind { none, keyframe, delta } kind = Kind::none;
  std::vector<Bytes> parts;
};
News tell(const SurfaceHead&, bool settled, std::span<const int16_t> displacement, Told&);

}  // namespace crumple

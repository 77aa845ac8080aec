// Encodes a car's surface as keyframes and deltas. A surface is the displacements from rest of the nodes that its skin uses, in
// quanta: 3 int16 per node. These nodes are fewer than the vertices, and the viewer has the weights. A delta is the difference
// from the last keyframe, never from another delta. Each message contains the hash of the whole surface, so a viewer knows
// whether its surface is correct.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "protocol/key.h"
#include "protocol/message.h"

namespace crumple {

// The precision and rate at which viewers receive a surface. Level 0 is for near viewers. Level 1 is for far viewers. Its error
// (half of 4 mm on each axis) is one pixel from a distance of 4 m on, if the view has 1,920 pixels over 90 degrees. It sends
// ten times a second, as games do for the positions of far players.
struct SurfaceLevel {
  int quanta;      // its quantum, in quanta of the scene
  uint64_t ticks;  // between messages while the car moves; a car that comes to rest is sent at once
};
inline constexpr std::array<SurfaceLevel, surface_level_count> surface_levels = {{{1, 1}, {8, 6}}};

inline constexpr uint32_t surface_node_limit = 200'000;  // the same limit as for a baked car
inline constexpr size_t part_size = 64'000;     // bytes: every keyframe or delta is shorter, so it travels in one batch
inline constexpr uint32_t part_nodes = 10'000;  // of a part: 61,250 bytes if nothing can be compressed

// Packs numbers of three axes as schema/message.fbs describes: `now`, or its differences from `then` if `then` is not empty.
std::vector<uint16_t> pack(std::span<const int16_t> now, std::span<const int16_t> then);
// Returns 3 * `count` numbers; nothing if the words do not hold exactly these.
std::optional<std::vector<int16_t>> unpack(std::span<const uint16_t> words, uint32_t count);

// XXH64 of the quanta, little endian, seed 0.
uint64_t surface_hash(std::span<const int16_t> quanta);

// The common fields of all messages about one state of a surface.
struct SurfaceHead {
  uint64_t tick = 0;
  std::string asset;
  float quantum = 0;  // m
};

// The keyframe in parts of consecutive nodes, at most `largest` each.
std::vector<Bytes> encode_keyframe(const SurfaceHead&, std::span<const int16_t> quanta, uint32_t largest = part_nodes);
// The differences from the keyframe of tick `keyframe_tick`, in parts.
std::vector<Bytes> encode_delta(const SurfaceHead&, std::span<const int16_t> quanta, uint64_t keyframe_tick,
                                std::span<const int16_t> keyframe);

}  // namespace crumple

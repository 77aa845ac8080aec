// A car's surface as keyframes and deltas. A surface is what its skin's nodes are displaced by from rest, in quanta: 3 int16 a
// node. There are fewer of these nodes than vertices, and the viewer has the weights. A delta is against the last keyframe,
// never against another delta. Each message states the hash of the whole surface, so that a viewer knows whether it holds it.
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

// How finely and how often viewers are told. Level 0 is for those that are near. Level 1 is for those that are far: half of 4
// mm on each axis is a pixel of 1,920 over 90 degrees from 4 m on, and ten times a second is what positions of far players are
// sent at.
struct SurfaceLevel {
  int quanta;      // of the scene's that are one of its own
  uint64_t ticks;  // from message to message while the car moves; at rest it is told at once
};
inline constexpr std::array<SurfaceLevel, surface_level_count> surface_levels = {{{1, 1}, {8, 6}}};

inline constexpr uint32_t surface_node_limit = 200'000;  // as a baked car's
inline constexpr size_t part_size = 64'000;              // bytes that no keyframe or delta reaches: it travels in one batch
inline constexpr uint32_t part_nodes = 10'000;           // 61,250 bytes, where nothing can be packed

// Numbers of three axes as schema/message.fbs describes them: `now`, or its differences from `then` where that is not empty.
std::vector<uint16_t> pack(std::span<const int16_t> now, std::span<const int16_t> then);
// 3 `count` numbers; nothing if the words are not just theirs.
std::optional<std::vector<int16_t>> unpack(std::span<const uint16_t> words, uint32_t count);

// XXH64 of the quanta, little endian, seed 0.
uint64_t surface_hash(std::span<const int16_t> quanta);

// What all messages about one state of a surface have in common.
struct SurfaceHead {
  uint64_t tick = 0;
  std::string asset;
  float quantum = 0;  // m
};

// Parts of consecutive nodes, each of at most `largest`.
std::vector<Bytes> encode_keyframe(const SurfaceHead&, std::span<const int16_t> quanta, uint32_t largest = part_nodes);
// The differences from the keyframe of tick `keyframe_tick`, in parts.
std::vector<Bytes> encode_delta(const SurfaceHead&, std::span<const int16_t> quanta, uint64_t keyframe_tick,
                                std::span<const int16_t> keyframe);

}  // namespace crumple

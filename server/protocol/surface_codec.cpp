#include "protocol/surface_codec.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <bit>

#include "schema/message_generated.h"

namespace crumple {
namespace {

static_assert(std::endian::native == std::endian::little, "the hash is of little-endian numbers");

constexpr uint32_t block = 16;  // nodes: of 8, 16 and 32 this gives the shortest messages, or is within 2 % of them

// Appends 16 numbers of `width` bits each, the first in the lowest bits.
void append(const uint16_t numbers[block], int width, std::vector<uint16_t>& words) {
  uint32_t waiting = 0;
  int bits = 0;
  for (size_t k = 0; k < block; ++k) {
    waiting |= uint32_t(numbers[k]) << bits;
    bits += width;
    if (bits < 16) continue;
    words.push_back(uint16_t(waiting));
    waiting >>= 16;
    bits -= 16;
  }
}

}  // namespace

std::vector<uint16_t> pack(std::span<const int16_t> now, std::span<const int16_t> then) {
  std::vector<uint16_t> words;
  const size_t nodes = now.size() / 3;
  uint16_t last[3] = {};
  for (size_t first = 0; first < nodes; first += block) {
    uint16_t numbers[3][block] = {}, all[3] = {};
    for (size_t k = 0; k < std::min<size_t>(block, nodes - first); ++k) {
      for (int axis = 0; axis < 3; ++axis) {
        const size_t i = 3 * (first + k) + axis;
        const uint16_t value = uint16_t(now[i] - (then.empty() ? 0 : then[i]));
        const int16_t step = int16_t(value - last[axis]);
        last[axis] = value;
        all[axis] |= numbers[axis][k] = uint16_t(uint16_t(step << 1) ^ uint16_t(step >> 15));
      }
    }
    const int width[3] = {std::bit_width(all[0]), std::bit_width(all[1]), std::bit_width(all[2])};
    words.push_back(uint16_t(width[0] | width[1] << 5 | width[2] << 10));
    for (int axis = 0; axis < 3; ++axis) append(numbers[axis], width[axis], words);
  }
  return words;
}

std::optional<std::vector<int16_t>> unpack(std::span<const uint16_t> words, uint32_t count) {
  std::vector<int16_t> out(size_t{3} * count);
  size_t at = 0;
  uint16_t last[3] = {};
  for (uint32_t first = 0; first < count; first += block) {
    if (at == words.size()) return std::nullopt;
    const uint32_t head = words[at++];
    const uint32_t width[3] = {head & 31, head >> 5 & 31, head >> 10 & 31};
    if (head >> 15 || std::max({width[0], width[1], width[2]}) > 16) return std::nullopt;
    if (width[0] + width[1] + width[2] > words.size() - at) return std::nullopt;
    const uint32_t nodes = std::min(block, count - first);
    for (size_t axis = 0; axis < 3; ++axis) {
      const uint32_t mask = (1u << width[axis]) - 1;
      uint32_t waiting = 0, bits = 0;
      const uint16_t* from = words.data() + at;
      for (uint32_t k = 0; k < nodes; ++k) {
        if (bits < width[axis]) {
          waiting |= uint32_t{*from++} << bits;
          bits += 16;
        }
        const uint32_t zigzag = waiting & mask;
        waiting >>= width[axis];
        bits -= width[axis];
        last[axis] = static_cast<uint16_t>(last[axis] + ((zigzag >> 1) ^ (0 - (zigzag & 1))));
        out[size_t{3} * (first + k) + axis] = static_cast<int16_t>(last[axis]);
      }
      at += width[axis];
    }
  }
  if (at != words.size()) return std::nullopt;
  return out;
}

uint64_t surface_hash(std::span<const int16_t> quanta) { return XXH64(quanta.data(), quanta.size_bytes(), 0); }

std::vector<Bytes> encode_keyframe(const SurfaceHead& head, std::span<const int16_t> quanta, uint32_t largest) {
  const uint64_t sum = surface_hash(quanta);
  const auto nodes = uint32_t(quanta.size() / 3);
  std::vector<Bytes> parts;
  for (uint32_t first = 0; first < nodes; first += largest) {
    const uint32_t count = std::min(largest, nodes - first);
    const auto words = pack(quanta.subspan(3 * first, 3 * count), {});
    flatbuffers::FlatBufferBuilder builder(2 * words.size() + 256);
    const auto asset = builder.CreateString(head.asset);
    const auto packed = builder.CreateVector(words);
    parts.push_back(
        finish(builder, schema::CreateKeyframe(builder, head.tick, asset, head.quantum, nodes, first, count, packed, sum)));
  }
  return parts;
}

std::vector<Bytes> encode_delta(const SurfaceHead& head, std::span<const int16_t> quanta, uint64_t keyframe_tick,
                                std::span<const int16_t> keyframe) {
  const uint64_t sum = surface_hash(quanta);
  const auto nodes = uint32_t(quanta.size() / 3);
  std::vector<Bytes> parts;
  for (uint32_t first = 0; first < nodes; first += part_nodes) {
    const uint32_t count = std::min(part_nodes, nodes - first);
    const auto words = pack(quanta.subspan(3 * first, 3 * count), keyframe.subspan(3 * first, 3 * count));
    flatbuffers::FlatBufferBuilder builder(2 * words.size() + 256);
    const auto packed = builder.CreateVector(words);
    parts.push_back(finish(builder, schema::CreateDelta(builder, head.tick, keyframe_tick, nodes, first, count, packed, sum)));
  }
  return parts;
}

}  // namespace crumple

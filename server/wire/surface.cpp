#include "wire/surface.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <bit>
#include <cstring>

#include "wire/encode.h"

namespace crumple {
namespace {

static_assert(std::endian::native == std::endian::little, "the hash is of little-endian numbers");

constexpr size_t block = 16;  // nodes: of 8, 16 and 32 the one with the shortest messages, or within 2 % of it

// 16 numbers of `width` bits, the first lowest.
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

void quantise(std::span<const Vec3> displacement, float quantum, std::span<int16_t> quanta) {
  static_assert(sizeof(Vec3) == 3 * sizeof(float));
  const auto* from = reinterpret_cast<const float*>(displacement.data());
  // Away from zero by hand: std::round, fmin and fmax are calls.
  for (size_t i = 0; i < 3 * displacement.size(); ++i) {
    const float number = from[i] / quantum;
    const float high = number > -32767.0f ? number : -32767.0f;  // also for NaN
    const float within = high < 32767.0f ? high : 32767.0f;
    const auto whole = int32_t(within);
    const float rest = within - float(whole);
    quanta[i] = int16_t(whole + (rest >= 0.5f) - (rest <= -0.5f));
  }
}

std::vector<uint16_t> pack(std::span<const int16_t> now, std::span<const int16_t> then) {
  std::vector<uint16_t> words;
  const size_t nodes = now.size() / 3;
  uint16_t last[3] = {};
  for (size_t first = 0; first < nodes; first += block) {
    uint16_t numbers[3][block] = {}, all[3] = {};
    for (size_t k = 0; k < std::min(block, nodes - first); ++k) {
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

uint64_t hash(std::span<const int16_t> displacement) { return XXH64(displacement.data(), displacement.size_bytes(), 0); }

std::vector<Bytes> encode_keyframe(const SurfaceHead& head, std::span<const int16_t> displacement, uint32_t largest) {
  const uint64_t sum = hash(displacement);
  const auto nodes = uint32_t(displacement.size() / 3);
  std::vector<Bytes> parts;
  for (uint32_t first = 0; first < nodes; first += largest) {
    const uint32_t count = std::min(largest, nodes - first);
    const auto words = pack(displacement.subspan(3 * first, 3 * count), {});
    flatbuffers::FlatBufferBuilder builder(2 * words.size() + 256);
    const auto asset = builder.CreateString(head.asset);
    const auto packed = builder.CreateVector(words);
    parts.push_back(
        finish(builder, schema::CreateKeyframe(builder, head.tick, asset, head.quantum, nodes, first, count, packed, sum)));
  }
  return parts;
}

std::vector<Bytes> encode_delta(const SurfaceHead& head, std::span<const int16_t> displacement, uint64_t keyframe_tick,
                                std::span<const int16_t> keyframe) {
  const uint64_t sum = hash(displacement);
  const auto nodes = uint32_t(displacement.size() / 3);
  std::vector<Bytes> parts;
  for (uint32_t first = 0; first < nodes; first += part_nodes) {
    const uint32_t count = std::min(part_nodes, nodes - first);
    const auto words = pack(displacement.subspan(3 * first, 3 * count), keyframe.subspan(3 * first, 3 * count));
    flatbuffers::FlatBufferBuilder builder(2 * words.size() + 256);
    const auto packed = builder.CreateVector(words);
    parts.push_back(finish(builder, schema::CreateDelta(builder, head.tick, keyframe_tick, nodes, first, count, packed, sum)));
  }
  return parts;
}

News tell(const SurfaceHead& head, bool settled, std::span<const int16_t> displacement, Told& told) {
  const bool changed = told.latest.size() != displacement.size() ||
                       std::memcmp(told.latest.data(), displacement.data(), displacement.size_bytes());
  const bool refresh = told.flowing && (settled || head.tick - told.keyframe_tick >= keyframe_interval);
  if (!told.due && !refresh && !changed) return {};
  told.latest.assign(displacement.begin(), displacement.end());
  told.tick = head.tick;
  if (told.due || refresh) {
    told.keyframe = told.latest;
    told.keyframe_tick = head.tick;
    told.due = told.flowing = false;
    return {News::Kind::keyframe, encode_keyframe(head, displacement)};
  }
  told.flowing = true;
  return {News::Kind::delta, encode_delta(head, displacement, told.keyframe_tick, told.keyframe)};
}

}  // namespace crumple

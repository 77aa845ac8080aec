#include "wire/surface.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

#include "wire/encode.h"

namespace crumple {
namespace {

static_assert(std::endian::native == std::endian::little, "the hash is of little-endian numbers");

constexpr size_t block = 64;          // vertices
constexpr size_t group = 64 * block;  // of one word of `changed`: 24,576 bytes if all of it changed
constexpr size_t room = 60'000;       // bytes of differences a part; the rest is for the words and the table

// Bit i: block i of the group differs. Appends the differences of those blocks.
uint64_t compare_group(std::span<const int16_t> now, std::span<const int16_t> then, std::vector<int16_t>& difference) {
  uint64_t changed = 0;
  for (size_t i = 0; i * 3 * block < now.size(); ++i) {
    const size_t start = i * 3 * block, size = std::min(3 * block, now.size() - start);
    if (std::memcmp(&now[start], &then[start], size * sizeof(int16_t)) == 0) continue;
    changed |= uint64_t(1) << i;
    for (size_t k = start; k < start + size; ++k) difference.push_back(int16_t(uint16_t(now[k]) - uint16_t(then[k])));
  }
  return changed;
}

}  // namespace

void quantise(std::span<const Vec3> vertex, std::span<const Vec3> rest, float quantum, std::span<int16_t> displacement) {
  for (size_t v = 0; v < vertex.size(); ++v) {
    for (int axis = 0; axis < 3; ++axis) {
      const float quanta = std::round((vertex[v][axis] - rest[v][axis]) / quantum);
      displacement[3 * v + axis] = int16_t(std::fmin(std::fmax(quanta, -32767.0f), 32767.0f));
    }
  }
}

uint64_t hash(std::span<const int16_t> displacement) { return XXH64(displacement.data(), displacement.size_bytes(), 0); }

std::vector<Bytes> encode_keyframe(const SurfaceHead& head, std::span<const int16_t> displacement, uint32_t largest) {
  const uint64_t sum = hash(displacement);
  const size_t count = displacement.size() / 3;
  std::vector<Bytes> parts;
  for (size_t first = 0; first < count; first += largest) {
    const auto part = displacement.subspan(3 * first, 3 * std::min<size_t>(largest, count - first));
    flatbuffers::FlatBufferBuilder builder(part.size_bytes() + 256);
    const auto asset = builder.CreateString(head.asset);
    const auto numbers = builder.CreateVector(part.data(), part.size());
    parts.push_back(finish(builder, schema::CreateKeyframe(builder, head.tick, asset, head.quantum, uint32_t(count),
                                                           uint32_t(first), numbers, sum)));
  }
  return parts;
}

std::vector<Bytes> encode_delta(const SurfaceHead& head, std::span<const int16_t> displacement, uint64_t keyframe_tick,
                                std::span<const int16_t> keyframe) {
  const uint64_t sum = hash(displacement);
  const size_t count = displacement.size() / 3;
  std::vector<Bytes> parts;
  std::vector<uint64_t> changed;
  std::vector<int16_t> difference;
  size_t first = 0;
  const auto close_part = [&](size_t difference_count) {
    flatbuffers::FlatBufferBuilder builder(2 * difference_count + 8 * changed.size() + 256);
    const auto words = builder.CreateVector(changed);
    const auto numbers = builder.CreateVector(difference.data(), difference_count);
    parts.push_back(finish(builder, schema::CreateDelta(builder, head.tick, keyframe_tick, uint32_t(count), uint32_t(first),
                                                        words, numbers, sum)));
    first += group * changed.size();
    changed.clear();
    difference.erase(difference.begin(), difference.begin() + ptrdiff_t(difference_count));
  };
  for (size_t start = 0; start < count; start += group) {
    const size_t before = difference.size(), size = 3 * std::min(group, count - start);
    const uint64_t word = compare_group(displacement.subspan(3 * start, size), keyframe.subspan(3 * start, size), difference);
    if (difference.size() * sizeof(int16_t) > room) close_part(before);
    changed.push_back(word);
  }
  close_part(difference.size());
  return parts;
}

News tell(const SurfaceHead& head, bool settled, std::span<const int16_t> displacement, Told& told) {
  const bool changed = told.latest.size() != displacement.size() ||
                       std::memcmp(told.latest.data(), displacement.data(), displacement.size_bytes());
  const bool refresh = told.flowing && (settled || head.tick - told.keyframe_tick >= keyframe_interval);
  if (!told.due && !refresh && !changed) return {};
  told.latest.assign(displacement.begin(), displacement.end());
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

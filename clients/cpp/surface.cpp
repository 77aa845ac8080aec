// Keyframe and delta decoding. The FlatBuffers verifier bounds every offset; what it cannot know (counts that must fit each
// other, ranges inside the surface) is checked here before anything is written.
#include "cpp/surface.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <bit>
#include <cmath>

#include "schema/message_generated.h"

namespace crumple::client {
namespace {

static_assert(std::endian::native == std::endian::little, "the hash is of little-endian numbers");

constexpr uint32_t block_vertices = 64;

uint64_t hash_of(const Quanta& quanta) { return XXH64(quanta.data(), quanta.size() * sizeof(int16_t), 0); }

template <class Table>
const Table* verified(std::span<const uint8_t> bytes) {
  flatbuffers::Verifier::Options options;
  options.max_depth = 4;
  options.max_tables = 4;
  flatbuffers::Verifier verifier(bytes.data(), bytes.size(), options);
  if (bytes.empty() || !verifier.VerifyBuffer<Table>(nullptr)) return nullptr;
  return flatbuffers::GetRoot<Table>(bytes.data());
}

Outcome refuse(const char* why) { return {Applied::refused, why}; }

// Begins to gather another tick, from `base` (nothing: zeros), unless these parts belong to the tick being gathered.
void gather(uint64_t tick, uint64_t hash, size_t size, const Quanta* base, Gathering& parts) {
  if (parts.tick == tick && parts.hash == hash && parts.quanta.size() == size) return;
  parts.tick = tick;
  parts.hash = hash;
  if (base)
    parts.quanta = *base;
  else
    parts.quanta.assign(size, 0);
}

}  // namespace

Outcome apply_keyframe(std::span<const uint8_t> bytes, Surface& surface) {
  const auto* message = verified<schema::Keyframe>(bytes);
  if (!message) return refuse("a keyframe is not a well-formed FlatBuffers table");
  const uint32_t count = message->vertex_count();
  const auto& part = *message->displacement();
  if (count == 0 || count > surface_vertex_limit) return refuse("vertex_count of a keyframe is not in [1, 200000]");
  if (!(message->quantum() > 0 && message->quantum() <= 1)) return refuse("quantum of a keyframe is not in (0, 1] m");
  if (message->asset()->size() != 16) return refuse("asset of a keyframe is not a hash of 16 digits");
  if (part.size() % 3 != 0) return refuse("displacement of a keyframe is not 3 numbers a vertex");
  if (message->first() > count || part.size() / 3 > count - message->first())
    return refuse("a keyframe's part reaches beyond vertex_count");

  // A keyframe of the very tick that deltas already gave is still wanted: as the base of what follows.
  const bool holds_key = !surface.key.empty();
  if (holds_key && message->tick() <= surface.key_tick) return {Applied::old, {}};
  if (message->tick() < surface.key_parts.tick && !surface.key_parts.quanta.empty()) return {Applied::old, {}};
  gather(message->tick(), message->hash(), size_t{3} * count, nullptr, surface.key_parts);
  std::copy(part.begin(), part.end(), surface.key_parts.quanta.begin() + size_t{3} * message->first());
  if (hash_of(surface.key_parts.quanta) != message->hash()) return {Applied::part, {}};

  const bool newer = surface.quanta.empty() || message->tick() > surface.tick;
  surface.asset = message->asset()->str();
  surface.quantum = message->quantum();
  surface.key_tick = message->tick();
  surface.key = std::move(surface.key_parts.quanta);
  surface.key_parts = {};
  if (!newer) return {Applied::old, {}};
  surface.tick = message->tick();
  surface.hash = message->hash();
  surface.quanta = surface.key;
  return {Applied::whole, {}};
}

Outcome apply_delta(std::span<const uint8_t> bytes, Surface& surface) {
  const auto* message = verified<schema::Delta>(bytes);
  if (!message) return refuse("a delta is not a well-formed FlatBuffers table");
  const uint32_t count = message->vertex_count();
  const auto& changed = *message->changed();
  const auto& difference = *message->difference();
  if (count == 0 || count > surface_vertex_limit) return refuse("vertex_count of a delta is not in [1, 200000]");
  if (message->first() >= count) return refuse("a delta's part begins beyond vertex_count");
  if (message->keyframe() > message->tick()) return refuse("a delta is older than its keyframe");
  if (changed.size() > surface_vertex_limit / (64 * block_vertices) + 1)
    return refuse("changed of a delta is longer than any car");

  // Sizes first, so that a message that is refused has changed nothing.
  size_t vertices = 0;
  for (uint32_t word = 0; word < changed.size(); ++word)
    for (uint64_t bits = changed.Get(word); bits; bits &= bits - 1) {
      const uint32_t block = 64 * word + static_cast<uint32_t>(std::countr_zero(bits));
      const uint32_t start = message->first() + block * block_vertices;
      if (start >= count) return refuse("a changed block of a delta lies beyond vertex_count");
      vertices += std::min(block_vertices, count - start);
    }
  if (difference.size() != 3 * vertices) return refuse("difference of a delta does not fit its changed blocks");

  if (!surface.quanta.empty() && message->tick() <= surface.tick) return {Applied::old, {}};
  if (surface.key.empty() || message->keyframe() > surface.key_tick) return {Applied::missing_keyframe, {}};
  if (message->keyframe() < surface.key_tick) return {Applied::old, {}};
  if (surface.key.size() != size_t{3} * count) return refuse("vertex_count of a delta is not that of its keyframe");
  if (message->tick() < surface.delta_parts.tick && !surface.delta_parts.quanta.empty()) return {Applied::old, {}};

  gather(message->tick(), message->hash(), surface.key.size(), &surface.key, surface.delta_parts);
  uint32_t at = 0;
  for (uint32_t word = 0; word < changed.size(); ++word)
    for (uint64_t bits = changed.Get(word); bits; bits &= bits - 1) {
      const uint32_t start = message->first() + (64 * word + static_cast<uint32_t>(std::countr_zero(bits))) * block_vertices;
      const uint32_t end = std::min(start + block_vertices, count);
      for (size_t i = size_t{3} * start; i < size_t{3} * end; ++i, ++at)
        surface.delta_parts.quanta[i] =
            static_cast<int16_t>(static_cast<uint16_t>(surface.key[i]) + static_cast<uint16_t>(difference.Get(at)));
    }
  if (hash_of(surface.delta_parts.quanta) != message->hash()) return {Applied::part, {}};
  surface.tick = message->tick();
  surface.hash = message->hash();
  surface.quanta.swap(surface.delta_parts.quanta);
  surface.delta_parts = {};
  return {Applied::whole, {}};
}

}  // namespace crumple::client

// Decodes keyframes and deltas. FlatBuffers' verifier checks every offset. This file checks what the verifier cannot know
// (counts that must agree, ranges within the surface) before it writes anything.
#include "viewer/surface.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "protocol/message.h"
#include "protocol/surface_codec.h"
#include "schema/message_generated.h"

namespace crumple::viewer {
namespace {

Outcome refuse(std::string why) { return {Applied::refused, std::move(why)}; }

// Starts to gather the parts of another tick, from `base` (null: zeros), unless the part belongs to the tick being gathered.
void gather(uint64_t tick, uint64_t hash, size_t size, const Quanta* base, Gathering& parts) {
  if (parts.tick == tick && parts.hash == hash && parts.quanta.size() == size) return;
  parts.tick = tick;
  parts.hash = hash;
  if (base)
    parts.quanta = *base;
  else
    parts.quanta.assign(size, 0);
}

// Checks the fields common to keyframes and deltas, and unpacks the part's numbers. Returns why it is refused, or NULL.
template <class Message>
const char* read_part(const Message& message, Quanta& out) {
  const uint32_t nodes = message.node_count(), count = message.count();
  if (nodes == 0 || nodes > surface_node_limit) return "node_count is not in [1, 200000]";
  if (count == 0 || count > nodes || message.first() > nodes - count) return "the part reaches beyond node_count";
  auto numbers = unpack({message.packed()->data(), message.packed()->size()}, count);
  if (!numbers) return "packed is not count nodes long, or a width is over 16";
  out = std::move(*numbers);
  return nullptr;
}

}  // namespace

Outcome apply_keyframe(std::span<const uint8_t> bytes, Surface& surface) {
  const auto* message = verified<schema::Keyframe>(bytes, 1);
  if (!message) return refuse("a keyframe is not a well-formed FlatBuffers table");
  Quanta part;
  if (const char* why = read_part(*message, part)) return refuse(std::string("a keyframe is refused: ") + why);
  if (!(message->quantum() > 0 && message->quantum() <= 1)) return refuse("quantum of a keyframe is not in (0, 1] m");
  if (message->asset()->size() != 16) return refuse("asset of a keyframe is not a hash of 16 digits");

  // Deltas may have given the surface of this tick already. The keyframe is still needed, because the next deltas refer to it.
  const bool holds_key = !surface.key.empty();
  if (holds_key && message->tick() <= surface.key_tick) return {Applied::old, {}};
  if (message->tick() < surface.key_parts.tick && !surface.key_parts.quanta.empty()) return {Applied::old, {}};
  gather(message->tick(), message->hash(), size_t{3} * message->node_count(), nullptr, surface.key_parts);
  std::copy(part.begin(), part.end(), surface.key_parts.quanta.begin() + size_t{3} * message->first());
  if (surface_hash(surface.key_parts.quanta) != message->hash()) return {Applied::part, {}};

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
  const auto* message = verified<schema::Delta>(bytes, 1);
  if (!message) return refuse("a delta is not a well-formed FlatBuffers table");
  Quanta part;
  if (const char* why = read_part(*message, part)) return refuse(std::string("a delta is refused: ") + why);
  if (message->keyframe() > message->tick()) return refuse("a delta is older than its keyframe");

  if (!surface.quanta.empty() && message->tick() <= surface.tick) return {Applied::old, {}};
  if (surface.key.empty() || message->keyframe() > surface.key_tick) return {Applied::missing_keyframe, {}};
  if (message->keyframe() < surface.key_tick) return {Applied::old, {}};
  if (surface.key.size() != size_t{3} * message->node_count())
    return refuse("node_count of a delta differs from node_count of its keyframe");
  if (message->tick() < surface.delta_parts.tick && !surface.delta_parts.quanta.empty()) return {Applied::old, {}};

  gather(message->tick(), message->hash(), surface.key.size(), &surface.key, surface.delta_parts);
  const size_t first = size_t{3} * message->first();
  for (size_t i = 0; i < part.size(); ++i)
    surface.delta_parts.quanta[first + i] =
        static_cast<int16_t>(static_cast<uint16_t>(surface.key[first + i]) + static_cast<uint16_t>(part[i]));
  if (surface_hash(surface.delta_parts.quanta) != message->hash()) return {Applied::part, {}};
  surface.tick = message->tick();
  surface.hash = message->hash();
  surface.quanta.swap(surface.delta_parts.quanta);
  surface.delta_parts = {};
  return {Applied::whole, {}};
}

}  // namespace crumple::viewer

// Keyframes and deltas as a viewer takes them, each also with the hash that fits it.
#include "cpp/surface.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <random>

#include "fuzz/entries.h"
#include "schema/message_generated.h"
#include "wire/surface.h"

namespace crumple::fuzz {
namespace {

using client::Applied;

template <class Message>
bool take(std::vector<uint8_t>& bytes, client::Outcome (*apply)(std::span<const uint8_t>, client::Surface&),
          client::Gathering client::Surface::*parts, client::Surface& surface) {
  const client::Surface before = surface;
  const client::Outcome outcome = apply(bytes, surface);
  expect((outcome.applied == Applied::refused) == !outcome.why.empty(), "a refusal says why");
  if (outcome.applied == Applied::refused)
    expect(surface.quanta == before.quanta && surface.key == before.key, "a refusal leaves the surface as it was");
  if (outcome.applied == Applied::whole)
    expect(surface.hash == XXH64(surface.quanta.data(), 2 * surface.quanta.size(), 0), "what is whole has its hash");
  if (outcome.applied != Applied::part) return outcome.applied != Applied::refused;
  auto* table = flatbuffers::GetMutableRoot<flatbuffers::Table>(bytes.data());
  const client::Quanta quanta = (surface.*parts).quanta;
  if (!table->SetField<uint64_t>(Message::VT_HASH, XXH64(quanta.data(), 2 * quanta.size(), 0), 0)) return true;
  surface = before;
  if (apply(bytes, surface).applied == Applied::whole) expect(surface.quanta == quanta, "the hash changes no number");
  return true;
}

void put_all(uint8_t kind, const std::vector<Bytes>& parts, std::vector<uint8_t>& to) {
  for (const Bytes& part : parts) put(kind, 0, input_of(part), to);
}

}  // namespace

bool surface_run(Input input) {
  client::Surface surface;
  bool taken = true;
  for (Part& part : parts_of(input)) {
    if (part.kind % 2 == 0)
      taken &= take<schema::Keyframe>(part.bytes, client::apply_keyframe, &client::Surface::key_parts, surface);
    else
      taken &= take<schema::Delta>(part.bytes, client::apply_delta, &client::Surface::delta_parts, surface);
  }
  return taken;
}

std::vector<std::vector<uint8_t>> surface_seeds() {
  std::mt19937 random(1);
  client::Quanta key(3 * 40), later(key);
  for (auto& quantum : key) quantum = int16_t(random() % 4000);
  for (size_t i = 0; i < key.size(); ++i) later[i] = int16_t(key[i] + int(random() % 9));
  const std::string asset(16, 'a');
  std::vector<uint8_t> whole, parts;
  put_all(0, encode_keyframe({3, asset, 0.0005f}, key), whole);
  put_all(1, encode_delta({4, asset, 0.0005f}, later, 3, key), whole);
  put_all(1, encode_delta({6, asset, 0.0005f}, key, 5, later), whole);
  put_all(0, encode_keyframe({3, asset, 0.0005f}, key, 17), parts);
  put_all(1, encode_delta({4, asset, 0.0005f}, later, 3, key), parts);
  return {whole, parts};
}

}  // namespace crumple::fuzz

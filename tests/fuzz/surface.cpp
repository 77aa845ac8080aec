// Fuzzes keyframes and deltas in a viewer.
#include "fuzz/surface.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <random>

#include "fuzz/entries.h"
#include "protocol/surface_codec.h"
#include "schema/message_generated.h"

namespace crumple::fuzz {
namespace {

using viewer::Applied;

viewer::Outcome apply(bool keyframe, const std::vector<uint8_t>& bytes, viewer::Surface& surface) {
  return keyframe ? viewer::apply_keyframe(bytes, surface) : viewer::apply_delta(bytes, surface);
}

bool take(bool keyframe, const std::vector<uint8_t>& bytes, viewer::Surface& surface) {
  const viewer::Surface before = surface;
  const viewer::Outcome outcome = apply(keyframe, bytes, surface);
  expect((outcome.applied == Applied::refused) == !outcome.why.empty(), "a refusal says why");
  if (outcome.applied == Applied::refused)
    expect(surface.quanta == before.quanta && surface.key == before.key, "a refusal leaves the surface as it was");
  if (outcome.applied == Applied::whole)
    expect(surface.hash == XXH64(surface.quanta.data(), 2 * surface.quanta.size(), 0), "what is whole has its hash");
  return outcome.applied != Applied::refused;
}

void put_all(uint8_t kind, const std::vector<Bytes>& parts, std::vector<uint8_t>& to) {
  for (const Bytes& part : parts) put(kind, 1, input_of(part), to);
}

}  // namespace

void fit_hash(bool keyframe, const viewer::Surface& before, std::vector<uint8_t>& bytes) {
  viewer::Surface surface = before;
  if (apply(keyframe, bytes, surface).applied != Applied::part) return;
  const viewer::Quanta& quanta = (keyframe ? surface.key_parts : surface.delta_parts).quanta;
  const auto field = keyframe ? int(schema::Keyframe::VT_HASH) : int(schema::Delta::VT_HASH);
  auto* table = flatbuffers::GetMutableRoot<flatbuffers::Table>(bytes.data());
  table->SetField<uint64_t>(flatbuffers::voffset_t(field), XXH64(quanta.data(), 2 * quanta.size(), 0), 0);
}

// which: bit 0: the hash is corrected.
bool surface_run(Input input) {
  viewer::Surface surface;
  bool taken = true;
  for (Part& part : parts_of(input)) {
    const bool keyframe = part.kind % 2 == 0;
    if (part.which & 1) fit_hash(keyframe, surface, part.bytes);
    taken &= take(keyframe, part.bytes, surface);
  }
  return taken;
}

std::vector<std::vector<uint8_t>> surface_seeds() {
  std::mt19937 random(1);
  viewer::Quanta key(3 * 40), later(key);
  for (auto& quantum : key) quantum = int16_t(random() % 4000);
  for (size_t i = 0; i < key.size(); ++i) later[i] = int16_t(key[i] + int(random() % 9));
  const std::string asset(16, 'a');
  std::vector<uint8_t> whole, parts;
  put_all(0, encode_keyframe({3, asset, 0.0005f}, key), whole);
  put_all(1, encode_delta({4, asset, 0.0005f}, later, 3, key), whole);
  put_all(1, encode_delta({6, asset, 0.0005f}, key, 5, later), whole);
  for (const Bytes& part : encode_keyframe({3, asset, 0.0005f}, key, 17)) put(0, 0, input_of(part), parts);
  put_all(1, encode_delta({4, asset, 0.0005f}, later, 3, key), parts);
  return {whole, parts};
}

}  // namespace crumple::fuzz

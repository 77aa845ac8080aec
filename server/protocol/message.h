// A message of the protocol as bytes: a table of schema/message.fbs, verified before any field is read.
#pragma once

#include <flatbuffers/flatbuffers.h>

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace crumple {

using Bytes = std::vector<std::byte>;

// The root table if every offset below it is valid; otherwise null. The bytes must be aligned to 8, as zenoh's and the
// recorder's are. tables: the most tables that the message may have, because a forged message could name a single table a
// million times.
template <class Table>
const Table* verified(std::span<const uint8_t> bytes, uint32_t tables = 1'000'000) {
  flatbuffers::Verifier::Options options;
  options.max_depth = 4;  // a Load command with its state needs 3
  options.max_tables = tables;
  if (bytes.empty() || !flatbuffers::Verifier(bytes.data(), bytes.size(), options).VerifyBuffer<Table>(nullptr)) return nullptr;
  return flatbuffers::GetRoot<Table>(bytes.data());
}
template <class Table>
const Table* verified(std::span<const std::byte> bytes, uint32_t tables = 1'000'000) {
  return verified<Table>(std::span(reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()), tables);
}

inline constexpr flatbuffers::voffset_t sequence_field = 4;  // the first field of Poses and of Obstacles
// Reads the sequence of a host's poses or obstacles, and verifies nothing else of them. Returns none if the bytes are no table.
inline std::optional<uint64_t> sequence_of(std::span<const std::byte> bytes) {
  struct Sequence : flatbuffers::Table {
    bool Verify(flatbuffers::Verifier& verifier) const {
      return VerifyTableStart(verifier) && VerifyField<uint64_t>(verifier, sequence_field, sizeof(uint64_t)) &&
             verifier.EndTable();
    }
  };
  const auto* table = verified<Sequence>(bytes);
  if (!table) return std::nullopt;
  return table->GetField<uint64_t>(sequence_field, 0);
}

// Whether a host's sample is newer than another: a NetIsNewer (io/net.h).
inline int has_later_sequence(const uint8_t* data, size_t size, const uint8_t* other, size_t other_size) {
  return sequence_of(std::as_bytes(std::span(data, size))) > sequence_of(std::as_bytes(std::span(other, other_size)));
}

template <class Table>
Bytes finish(flatbuffers::FlatBufferBuilder& builder, flatbuffers::Offset<Table> root) {
  builder.Finish(root);
  const auto* data = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return Bytes(data, data + builder.GetSize());
}

}  // namespace crumple

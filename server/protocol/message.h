// A message of the protocol as bytes: a table of schema/message.fbs, verified before any field is read.
#pragma once

#include <flatbuffers/flatbuffers.h>

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace crumple {

using Bytes = std::vector<std::byte>;

// The root table if every offset below it is valid; otherwise null. The bytes must be aligned to 8, as zenoh's and the
// recorder's are. tables: the most tables that the message may have; a forged message could name a single table a million
// times.
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

template <class Table>
Bytes finish(flatbuffers::FlatBufferBuilder& builder, flatbuffers::Offset<Table> root) {
  builder.Finish(root);
  const auto* data = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return Bytes(data, data + builder.GetSize());
}

}  // namespace crumple

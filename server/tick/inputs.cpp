#include "tick/inputs.h"

#include "protocol/key.h"
#include "schema/message_generated.h"

namespace crumple {

Message inputs_message(uint64_t tick, const Inbox& inbox, uint64_t hash) {
  flatbuffers::FlatBufferBuilder builder;
  std::vector<flatbuffers::Offset<schema::Input>> list;
  for (const Message& message : inbox) {
    if (!is_input(parse_key(message.key).value_or(Key{}).channel)) continue;
    const auto payload = builder.CreateVector(reinterpret_cast<const uint8_t*>(message.bytes.data()), message.bytes.size());
    list.push_back(schema::CreateInput(builder, builder.CreateString(message.key), payload, message.ticket != 0));
  }
  builder.Finish(schema::CreateInputsDirect(builder, tick, &list, hash));
  const auto* data = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return {"replica/inputs", {data, data + builder.GetSize()}};
}

std::optional<TickInputs> read_inputs(std::span<const std::byte> bytes) {
  const auto* data = reinterpret_cast<const uint8_t*>(bytes.data());
  if (bytes.empty() || !flatbuffers::Verifier(data, bytes.size()).VerifyBuffer<schema::Inputs>(nullptr)) return std::nullopt;
  const auto* from = flatbuffers::GetRoot<schema::Inputs>(data);
  TickInputs out{from->tick(), from->hash(), {}};
  size_t left = bytes.size();
  for (const auto* input : *from->inputs()) {
    // A forged message may name one long payload a million times.
    const size_t size = size_t{input->key()->size()} + input->payload()->size();
    if (size > left) return std::nullopt;
    left -= size;
    const auto* payload = reinterpret_cast<const std::byte*>(input->payload()->data());
    // Any ticket but 0 will do: it only says that an answer is wanted.
    out.inbox.push_back({input->key()->str(), {payload, payload + input->payload()->size()}, input->is_query() ? 1u : 0u});
  }
  return out;
}

}  // namespace crumple

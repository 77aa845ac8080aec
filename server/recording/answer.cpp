#include "recording/answer.h"

#include <algorithm>
#include <cstring>
#include <string>
#include <string_view>

#include "protocol/key.h"
#include "tick/inputs.h"

namespace crumple {

void answer_asset(Net* net, const NetEvent& query, std::string_view hash, const std::vector<std::shared_ptr<const Car>>& cars) {
  uint64_t offset = 0;
  if (query.size == sizeof offset) std::memcpy(&offset, query.data, sizeof offset);
  for (const auto& car : cars) {
    if (car->hash != hash || offset > car->bytes.size()) continue;
    const auto piece = car->bytes.subspan(offset, std::min<size_t>(asset_piece, car->bytes.size() - offset));
    net_reply(net, query.ticket, piece.data(), piece.size(), 0);
    return;
  }
  const std::string sentence =
      "this server does not have asset " + std::string(hash) + ": give its file to `crumple serve --car`";
  net_reply(net, query.ticket, sentence.data(), sentence.size(), 1);
}

void LatestInputs::keep(const Message& message) {
  constexpr size_t most = size_t{16} << 20;  // 64 hosts of 1,000 cars each have 13 MB
  size_t size = message.bytes.size();
  for (const auto& [key, other] : messages) size += key == message.key ? 0 : other.bytes.size();
  if (size > most || (messages.size() >= 2 * Limits{}.hosts && !messages.contains(message.key))) return;
  messages[message.key] = message;
}

void LatestInputs::forget_others(const std::vector<std::string>& hosts) {
  std::erase_if(messages, [&](const auto& each) {
    return std::find(hosts.begin(), hosts.end(), parse_key(each.first).value_or(Key{}).id) == hosts.end();
  });
}

void LatestInputs::answer(Net* net, uint64_t ticket) const {
  Inbox inputs;
  for (const auto& [key, message] : messages) inputs.push_back(message);
  const Message answer = inputs_message(0, inputs, 0);
  net_reply(net, ticket, answer.bytes.data(), answer.bytes.size(), 0);
}

}  // namespace crumple

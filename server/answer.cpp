#include "answer.h"

#include <algorithm>
#include <cstring>
#include <string>
#include <string_view>

#include "standby.h"

namespace crumple {

void answer_asset(Net* net, const NetEvent& query, const std::vector<std::shared_ptr<const Car>>& cars) {
  const std::string_view key = query.key;
  const std::string_view hash = key.substr(key.rfind('/') + 1);
  uint64_t offset = 0;
  if (query.size == sizeof offset) std::memcpy(&offset, query.data, sizeof offset);
  for (const auto& car : cars) {
    if (car->hash != hash || offset > car->bytes.size()) continue;
    const auto piece = car->bytes.subspan(offset, std::min<size_t>(asset_piece, car->bytes.size() - offset));
    net_reply(net, query.ticket, piece.data(), piece.size(), 0);
    return;
  }
  const std::string sentence =
      "asset " + std::string(hash.substr(0, 64)) + " is not here: give its file to `crumple serve --car`";
  net_reply(net, query.ticket, sentence.data(), sentence.size(), 1);
}

void LatestInputs::keep(const Message& message) {
  if (messages.size() < 2 * Limits{}.hosts || messages.contains(message.key)) messages[message.key] = message;
}

void LatestInputs::answer(Net* net, uint64_t ticket) const {
  Inbox inputs;
  for (const auto& [key, message] : messages) inputs.push_back(message);
  const Message answer = inputs_message(0, inputs, 0);
  net_reply(net, ticket, answer.bytes.data(), answer.bytes.size(), 0);
}

}  // namespace crumple

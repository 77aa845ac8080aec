// Answers that need no tick: pieces of assets, and the latest inputs of hosts.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "car/car.h"
#include "io/net.h"
#include "protocol/asset.h"
#include "tick/world.h"

namespace crumple {

// Bytes of a question that is answered here. A question for the world has 16 and the name of the program.
inline constexpr size_t question_limit = 256;
void answer_asset(Net*, const NetEvent&, std::string_view hash, const std::vector<std::shared_ptr<const Car>>&);

// The last poses and obstacles of every host, for viewers that come late: key "inputs". It keeps at most two messages for each
// of the hosts that a scene may have, and 16 MiB.
struct LatestInputs {
  std::map<std::string, Message, std::less<>> messages;
  void keep(const Message&);
  // Forgets all hosts but these.
  void forget_others(const std::vector<std::string>& hosts);
  void answer(Net*, uint64_t ticket) const;
};

}  // namespace crumple

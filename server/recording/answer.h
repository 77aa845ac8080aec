// Answers that need no tick: assets, in pieces, and what hosts told last.
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

// Bytes of a question for what stands here: one for the world has 24 and the name of a program.
inline constexpr size_t question_limit = 256;
void answer_asset(Net*, const NetEvent&, std::string_view hash, const std::vector<std::shared_ptr<const Car>>&);

// Of every host its last poses and obstacles, for who comes late: key "inputs". Of as many hosts as a scene may have, and 16
// MiB.
struct LatestInputs {
  std::map<std::string, Message, std::less<>> messages;
  void keep(const Message&);
  // Of hosts that a scene does not have any more.
  void forget_others(const std::vector<std::string>& hosts);
  void answer(Net*, uint64_t ticket) const;
};

}  // namespace crumple

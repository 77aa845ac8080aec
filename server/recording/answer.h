// Answers that need no tick: assets, in pieces, and what hosts told last.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "car/car.h"
#include "io/transport.h"
#include "tick/world.h"

namespace crumple {

// Bytes of a question for what stands here: one for the world has 24 and the name of a program.
inline constexpr size_t question_limit = 256;
// Of a baked car a query gets at most so much, from the offset that its payload states (8 bytes, little endian; none: 0);
// less than a piece is the end. 256 KiB: the 10 s that a client waits for it are enough on a line of 210 kbit/s, and a car of
// 20 MB takes 80 questions.
inline constexpr size_t asset_piece = size_t{256} << 10;

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

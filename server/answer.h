// Answers that need no tick: assets, in pieces.
#pragma once

#include <memory>
#include <vector>

#include "asset/car.h"
#include "transport/transport.h"

namespace crumple {

// Of a baked car a query gets at most so much, from the offset that its payload states (8 bytes, little endian; none: 0);
// less than a piece is the end. 256 KiB: the 10 s that a client waits for it are enough on a line of 210 kbit/s, and a car of
// 20 MB takes 80 questions.
inline constexpr size_t asset_piece = size_t{256} << 10;

// key: "crumple/1/asset/{hash}".
void answer_asset(Net*, const NetEvent&, const std::vector<std::shared_ptr<const Car>>&);

}  // namespace crumple

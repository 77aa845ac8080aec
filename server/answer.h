// Answers that need no tick: assets, in pieces.
#pragma once

#include <memory>
#include <vector>

#include "asset/car.h"
#include "transport/transport.h"

namespace crumple {

// Of a baked car a query gets at most so much, from the offset that its payload states (8 bytes, little endian; none: 0);
// less than a piece is the end. Below the size limit of a message.
inline constexpr size_t asset_piece = size_t{4} << 20;

// key: "crumple/1/asset/{hash}".
void answer_asset(Net*, const NetEvent&, const std::vector<std::shared_ptr<const Car>>&);

}  // namespace crumple

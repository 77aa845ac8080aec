// Who owns a scene stands in a token, owner/{epoch}-{id}. The epoch counts up with each takeover: a server that was only cut
// off, and meets the token of a later epoch when it is back, knows that it was replaced.
#pragma once

#include <atomic>
#include <chrono>
#include <compare>
#include <cstdint>
#include <string>

#include "io/net.h"
#include "protocol/key.h"

namespace crumple {

struct Owner {
  uint64_t epoch = 0;
  std::string id;
  friend auto operator<=>(const Owner&, const Owner&) = default;
};
std::string random_id();

// A server that looked away from the network for longer, because the machine slept or had no time, knows nothing of who is
// there now: its own line may be cut, which it learns a little later.
inline constexpr std::chrono::milliseconds longest_blink{1000};

// Announces this owner at a router, after a look for another one. False if `stop` came first. Throws std::runtime_error: the
// scene has an owner.
bool claim_scene(Net*, const std::string& scene, const Owner&, const std::atomic<bool>& stop);

// Whether the token of this key says that a later owner is there.
bool is_replaced(const Owner&, const Key&);

}  // namespace crumple

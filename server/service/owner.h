// The owner of a scene announces a token, owner/{epoch}-{id}. Each takeover increases the epoch. A server that was only cut off
// and sees the token of a later epoch when it is back knows that it was replaced.
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

// If a server did not look at the network for longer than this, because the machine slept or was busy, it does not know which
// servers are there: its own link may be down, which it learns only a little later.
inline constexpr std::chrono::milliseconds longest_blink{1000};

// Waits to see whether the scene has another owner, then announces this one at a router. Returns false if `stop` came first.
// Throws std::runtime_error if the scene has an owner.
bool claim_scene(Net*, const std::string& scene, const Owner&, const std::atomic<bool>& stop);

// Whether this key is the token of a later owner.
bool is_replaced(const Owner&, const Key&);

}  // namespace crumple

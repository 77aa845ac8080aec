// How long a server does not hear a host.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <cstring>

#include "io/net.h"

namespace crumple {

inline constexpr const char* heard_key = "crumple/1/main/host/game/poses";

// Sends a sample on `heard_key` and returns the time until `server`, which subscribes to it, has it: at most `patience`.
inline std::chrono::duration<double> until_heard(Net* host, Net* server, uint64_t said, std::chrono::seconds patience) {
  NetEvent events[64];
  const auto begun = std::chrono::steady_clock::now();
  const auto waited = [&] { return std::chrono::steady_clock::now() - begun; };
  EXPECT_EQ(net_put(host, heard_key, &said, sizeof said, NET_REAL_TIME), 0) << transport_error();
  for (bool heard = false; !heard && waited() < patience;) {
    const int got = net_poll(server, events, 64, 50'000);
    for (int k = 0; k < got; ++k) heard |= events[k].kind == NET_SAMPLE && std::memcmp(events[k].data, &said, sizeof said) == 0;
  }
  return waited();
}

}  // namespace crumple

// How long a server does not hear a host, and viewers that freeze meanwhile.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "io/net.h"
#include "program.h"

namespace crumple {

inline constexpr const char* heard_key = "crumple/1/main/host/game/poses";

// Sends a sample on `heard_key` and returns the time until `server`, which subscribes to it, has it: at most `patience`.
inline std::chrono::duration<double> until_heard(Net* host, Net* server, uint64_t said) {
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

// Lets four viewers, started with this command, follow the car box of a `server` that does nothing else; then stops them, and
// sends more than their links take.
inline std::vector<std::unique_ptr<Process>> freeze_viewers(Net* server, const std::vector<std::string>& command) {
  std::vector<std::unique_ptr<Process>> frozen;
  for (const char* token : {"crumple/1/main/server", "crumple/1/main/car/box"})
    EXPECT_EQ(net_announce(server, token), 0) << transport_error();
  EXPECT_EQ(net_queryable(server, "crumple/1/main/car/*/key/*", 100, NET_LONGEST), 0);
  EXPECT_EQ(net_subscribe(server, "crumple/1/main/host/*/poses", 1000, NET_LONGEST), 0);
  while (frozen.size() < 4) {
    frozen.push_back(std::make_unique<Process>(command));
    // A viewer has arrived when it asks for the keyframe of its car.
    bool asked = false;
    NetEvent events[64];
    for (const auto end = Clock::now() + patience; !asked && Clock::now() < end;) {
      const int got = net_poll(server, events, 64, 50'000);
      for (int k = 0; k < got; ++k) asked |= events[k].kind == NET_QUERY;
    }
    EXPECT_TRUE(asked);
    frozen.back()->send(SIGSTOP);
  }
  const std::string batch(60'000, 'x');
  for (int i = 0; i < 200; ++i)
    EXPECT_EQ(net_put(server, "crumple/1/main/car/box/delta/0", batch.data(), batch.size(), NET_DATA), 0);
  return frozen;
}

// The host sends again as soon as the server has heard it, for 8 s, in which links of frozen viewers expire. Returns the
// longest time that the server took to hear it, s.
inline double longest_unheard(Net* host, Net* server) {
  std::chrono::duration<double> longest{};
  const auto end = Clock::now() + std::chrono::seconds(8);
  for (uint64_t said = 1; Clock::now() < end; ++said) longest = std::max(longest, until_heard(host, server, said));
  testing::Test::RecordProperty("longest_ms", int(1000 * longest.count()));
  std::printf("a host was unheard for %.3f s at most\n", longest.count());
  return longest.count();
}

}  // namespace crumple

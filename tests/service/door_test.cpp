// Tests messages, connections and declarations of strangers, during which the server must go on. Each test was once an attack
// that stopped a server, made it deaf, or filled its memory.
#include "host.h"
#include "io/net.h"
#include "program.h"

namespace crumple {
namespace {

struct CloseNet {
  void operator()(Net* net) const { net_close(net); }
};
using Session = std::unique_ptr<Net, CloseNet>;

Session open_session(const char* mode, const char* listen, const char* connect) {
  Net* net = nullptr;
  EXPECT_EQ(net_open(mode, listen, connect, nullptr, 10'000, &net), 0) << transport_error();
  return Session(net);
}

// Zenoh closes a link whose peer is silent for 3 s. Unsent data on this link must not delay the readers of other links.
TEST(Door, ViewersThatFreezeUntilTheirLinksExpireDeafenNobody) {
  constexpr int viewers = 4;
  constexpr const char* delta = "crumple/1/main/car/box/delta/0";
  const Session server = open_session("peer", "tcp/127.0.0.1:0", nullptr);
  const std::string endpoint = net_endpoint(server.get());
  for (const char* token : {"crumple/1/main/server", "crumple/1/main/car/box"})
    ASSERT_EQ(net_announce(server.get(), token), 0) << transport_error();
  ASSERT_EQ(net_queryable(server.get(), "crumple/1/main/car/*/key/*", 100, NET_LONGEST), 0);
  ASSERT_EQ(net_subscribe(server.get(), "crumple/1/main/host/*/poses", 1000, NET_LONGEST), 0);

  // A viewer has arrived when it asks for the keyframe of its car.
  NetEvent events[64];
  std::vector<std::unique_ptr<Process>> frozen;
  for (int i = 0; i < viewers; ++i) {
    frozen.push_back(std::make_unique<Process>(std::vector<std::string>{"watch", "--connect", endpoint}));
    bool asked = false;
    for (const auto end = Clock::now() + patience; !asked && Clock::now() < end;) {
      const int got = net_poll(server.get(), events, 64, 50'000);
      for (int k = 0; k < got; ++k) asked |= events[k].kind == NET_QUERY;
    }
    ASSERT_TRUE(asked);
    frozen.back()->send(SIGSTOP);
  }
  const std::string batch(60'000, 'x');
  for (int i = 0; i < 200; ++i) ASSERT_EQ(net_put(server.get(), delta, batch.data(), batch.size(), NET_DATA), 0);

  // The host sends again as soon as the server has heard it. All links of frozen viewers expire in this time.
  const Session host = open_session("client", nullptr, endpoint.c_str());
  Clock::duration longest{};
  const auto end = Clock::now() + std::chrono::seconds(8);
  for (uint64_t said = 1; Clock::now() < end; ++said) {
    const auto begun = Clock::now();
    ASSERT_EQ(net_put(host.get(), "crumple/1/main/host/tester/poses", &said, sizeof said, NET_REAL_TIME), 0);
    for (bool heard = false; !heard && Clock::now() < begun + patience;) {
      const int got = net_poll(server.get(), events, 64, 50'000);
      for (int k = 0; k < got; ++k)
        heard |= events[k].kind == NET_SAMPLE && std::memcmp(events[k].data, &said, sizeof said) == 0;
    }
    longest = std::max(longest, Clock::now() - begun);
  }
  EXPECT_LT(longest, std::chrono::seconds(3)) << "a host was unheard";
  RecordProperty("longest_ms", int(std::chrono::duration_cast<std::chrono::milliseconds>(longest).count()));
  std::printf("a host was unheard for %.3f s at most\n", std::chrono::duration<double>(longest).count());
}

}  // namespace
}  // namespace crumple

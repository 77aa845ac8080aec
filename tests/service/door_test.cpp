// Tests messages, connections and declarations of strangers, during which the server must go on. Each test was once an attack
// that stopped a server, made it deaf, or filled its memory.
#include "heard.h"
#include "host.h"
#include "impaired_link.h"
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

// Zenoh closes a link whose peer is silent for 3 s. Unsent data on this link must not delay the readers of other links. The
// twin with TLS is Guarded.ViewersThatFreeze...
TEST(Door, ViewersThatFreezeUntilTheirLinksExpireDeafenNobody) {
  const Session server = open_session("peer", "tcp/127.0.0.1:0", nullptr);
  const char* endpoint = net_endpoint(server.get());
  const Session host = open_session("client", nullptr, endpoint);
  const auto frozen = freeze_viewers(server.get(), {"watch", "--connect", endpoint});
  EXPECT_LT(longest_unheard(host.get(), server.get()), 3) << "a host was unheard";
}

// Answers to a slow asker wait in the server for a long time. Other questions of the same asker end at once, as nobody answers
// them; the threads that end them also receive from all hosts, so they must not wait behind the long answer.
TEST(Door, AskersThatTakeALongAnswerSlowlyDeafenNobody) {
  constexpr int askers = 4;
  const Session server = open_session("peer", "tcp/127.0.0.1:0", nullptr);
  const std::string endpoint = net_endpoint(server.get());
  ASSERT_EQ(net_queryable(server.get(), "crumple/1/main/car/*/key/*", 100, NET_LONGEST), 0);
  ASSERT_EQ(net_subscribe(server.get(), "crumple/1/main/host/*/poses", 1000, NET_LONGEST), 0);

  const std::string answer(20 << 20, 'x');
  NetEvent events[64];
  uint64_t ticket = 0;
  std::vector<std::unique_ptr<ImpairedLink>> lines;
  std::vector<Session> slow;
  for (int i = 0; i < askers; ++i) {
    lines.push_back(std::make_unique<ImpairedLink>(endpoint, Weather{.kbit = 4000}));
    slow.push_back(open_session("client", nullptr, lines.back()->endpoint().c_str()));
    ASSERT_EQ(net_get(slow.back().get(), "crumple/1/main/car/box/key/0", nullptr, 0, 60'000, &ticket), 0);
    bool asked = false;
    for (const auto end = Clock::now() + patience; !asked && Clock::now() < end;) {
      const int got = net_poll(server.get(), events, 64, 50'000);
      for (int k = 0; k < got; ++k) {
        if (events[k].kind != NET_QUERY) continue;
        asked = true;
        ASSERT_EQ(net_reply(server.get(), events[k].ticket, answer.data(), answer.size(), 0), 0);
      }
    }
    ASSERT_TRUE(asked);
  }
  const Session host = open_session("client", nullptr, endpoint.c_str());
  std::chrono::duration<double> longest{};
  const auto end = Clock::now() + std::chrono::seconds(4);
  for (uint64_t said = 1; Clock::now() < end; ++said) {
    if (said == 60) {
      for (const Session& one : slow) ASSERT_EQ(net_get(one.get(), "crumple/1/main/nothing", nullptr, 0, 60'000, &ticket), 0);
    }
    longest = std::max(longest, until_heard(host.get(), server.get(), said));
  }
  EXPECT_LT(longest, std::chrono::seconds(1)) << "a host was unheard";
  std::printf("a host was unheard for %.3f s at most\n", longest.count());
}

// Answers to an asker that takes nothing wait in several threads. Each waited in turn for its own second, and the thread that
// sends on all links waited for them when it closed this one.
TEST(Door, AnAskerThatTakesNoneOfManyAnswersDeafensNobody) {
  constexpr int questions = 16;  // twice the answering threads
  const Session server = open_session("peer", "tcp/127.0.0.1:0", nullptr);
  const std::string endpoint = net_endpoint(server.get());
  ASSERT_EQ(net_queryable(server.get(), "crumple/1/main/car/*/key/*", 100, NET_LONGEST), 0);
  ASSERT_EQ(net_subscribe(server.get(), "crumple/1/main/host/*/poses", 1000, NET_LONGEST), 0);
  const Session host = open_session("client", nullptr, endpoint.c_str());
  constexpr const char* reactions_key = "crumple/1/main/host/game/reactions";
  ASSERT_EQ(net_subscribe(host.get(), reactions_key, 1000, NET_LONGEST), 0);
  ImpairedLink line(endpoint, {});
  const Session asker = open_session("client", nullptr, line.endpoint().c_str());

  NetEvent events[64];
  uint64_t ticket = 0;
  std::vector<uint64_t> asked;
  for (int i = 0; i < questions; ++i)
    ASSERT_EQ(net_get(asker.get(), "crumple/1/main/car/box/key/0", nullptr, 0, 60'000, &ticket), 0);
  for (const auto end = Clock::now() + patience; asked.size() < questions && Clock::now() < end;) {
    const int got = net_poll(server.get(), events, 64, 50'000);
    for (int k = 0; k < got; ++k) {
      if (events[k].kind == NET_QUERY) asked.push_back(events[k].ticket);
    }
  }
  ASSERT_EQ(asked.size(), size_t{questions});
  line.set(LinkState::stalled);
  const std::string answer(8 << 20, 'x');
  for (const uint64_t one : asked) net_reply(server.get(), one, answer.data(), answer.size(), 0);  // refused if too many wait

  std::chrono::duration<double> longest{};
  const auto end = Clock::now() + std::chrono::seconds(8);
  for (uint64_t said = 1; Clock::now() < end; ++said) {
    const auto begun = Clock::now();
    until_heard(host.get(), server.get(), said);
    bool back = false;
    for (auto resent = begun; !back && Clock::now() < begun + patience;) {
      if (Clock::now() >= resent) {  // a sample may be lost
        ASSERT_EQ(net_put(server.get(), reactions_key, &said, sizeof said, NET_REAL_TIME), 0);
        resent = Clock::now() + std::chrono::milliseconds(50);
      }
      const int got = net_poll(host.get(), events, 64, 50'000);
      for (int k = 0; k < got; ++k)
        back |= events[k].kind == NET_SAMPLE && std::memcmp(events[k].data, &said, sizeof said) == 0;
    }
    longest = std::max<std::chrono::duration<double>>(longest, Clock::now() - begun);
  }
  EXPECT_LT(longest, std::chrono::seconds(1)) << "a host was unheard, or its reaction did not come";
  std::printf("a host waited for %.3f s at most\n", longest.count());
  line.set(LinkState::cut);
}

}  // namespace
}  // namespace crumple

// Tests server/io against its headers: real Zenoh sessions on loopback in one process, and real files in the test's folder. It
// includes only the headers of server/io. Each test waits for a message or a count with a deadline, never sleeps, and checks no
// times.
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "impaired_link.h"
#include "io/mcap.h"
#include "io/net.h"
#include "paths.h"

namespace crumple {
namespace {

// Rust's structs must have the layout of the structs in the header. The Rust code asserts the same numbers.
static_assert(sizeof(NetEvent) == 40 && sizeof(NetStats) == 104 && sizeof(ReaderMessage) == 72);

using Clock = std::chrono::steady_clock;
constexpr auto deadline = std::chrono::seconds(20);
constexpr uint32_t connect_ms = 10000;

struct CloseNet {
  void operator()(Net* net) const { net_close(net); }
};
using Session = std::unique_ptr<Net, CloseNet>;

Session open_peer(const char* endpoint = "tcp/127.0.0.1:0") {
  Net* net = nullptr;
  EXPECT_EQ(net_open("peer", endpoint, nullptr, nullptr, connect_ms, &net), TRANSPORT_OK) << transport_error();
  return Session(net);
}

Session open_client(const Session& server, const char* config = nullptr) {
  Net* net = nullptr;
  EXPECT_EQ(net_open("client", nullptr, net_endpoint(server.get()), config, connect_ms, &net), TRANSPORT_OK)
      << transport_error();
  return Session(net);
}

// An event with its own copies of its data.
struct Kept {
  uint32_t kind, failed;
  std::string key, data;
  uint64_t ticket;
};

std::vector<Kept> poll(const Session& net, uint64_t timeout_us = 20000, uint32_t capacity = 64) {
  std::vector<NetEvent> events(capacity);
  const int count = net_poll(net.get(), events.data(), capacity, timeout_us);
  EXPECT_GE(count, 0) << transport_error();
  std::vector<Kept> kept;
  for (int i = 0; i < count; ++i) {
    const NetEvent& event = events[static_cast<size_t>(i)];
    EXPECT_EQ(reinterpret_cast<uintptr_t>(event.data) % 16, 0u);
    kept.push_back(
        {event.kind, event.failed, event.key, {reinterpret_cast<const char*>(event.data), event.size}, event.ticket});
  }
  return kept;
}

// Polls until `wanted` events have come or the deadline has passed.
std::vector<Kept> collect(const Session& net, size_t wanted) {
  std::vector<Kept> all;
  for (const auto end = Clock::now() + deadline; all.size() < wanted && Clock::now() < end;) {
    for (Kept& event : poll(net)) all.push_back(std::move(event));
  }
  return all;
}

// Meanwhile it polls `idle`, a session that receives nothing.
bool wait_until(const Session& idle, const std::function<bool()>& holds) {
  for (const auto end = Clock::now() + deadline; Clock::now() < end; poll(idle, 2000)) {
    if (holds()) return true;
  }
  return holds();
}

bool wait_for_subscriber(const Session& publisher, const char* key) {
  return wait_until(publisher, [&] { return net_matching(publisher.get(), key) == 1; });
}

NetStats stats_of(const Session& net) {
  NetStats stats{};
  net_stats(net.get(), &stats);
  return stats;
}

int put(const Session& net, const char* key, const std::string& data, NetPriority priority = NET_DATA) {
  return net_put(net.get(), key, data.data(), data.size(), priority);
}

TEST(Net, DeliversSamplesOfAllKeysInTheOrderTheyWerePut) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_subscribe(client.get(), "t/*", 1000, NET_LONGEST), TRANSPORT_OK);
  ASSERT_TRUE(wait_for_subscriber(server, "t/a") && wait_for_subscriber(server, "t/b"));
  for (int i = 0; i < 400; ++i) ASSERT_EQ(put(server, i % 2 ? "t/a" : "t/b", std::to_string(i)), TRANSPORT_OK);
  const std::vector<Kept> events = collect(client, 400);
  ASSERT_EQ(events.size(), 400u);
  for (int i = 0; i < 400; ++i) {
    EXPECT_EQ(events[i].kind, NET_SAMPLE);
    EXPECT_EQ(events[i].key, i % 2 ? "t/a" : "t/b");
    EXPECT_EQ(events[i].data, std::to_string(i));
  }
  EXPECT_EQ(stats_of(server).put, 400u);
  EXPECT_EQ(stats_of(client).received, 400u);
}

TEST(Net, DeliversMessagesOfEverySizeUpToTheLimit) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_subscribe(client.get(), "t/size", 100, NET_LONGEST), TRANSPORT_OK);
  ASSERT_TRUE(wait_for_subscriber(server, "t/size"));
  for (const size_t size : {size_t{0}, size_t{1}, size_t{65535}, size_t{65536}, size_t{1000000}, size_t{8} << 20}) {
    std::string data(size, '\0');
    for (size_t i = 0; i < size; ++i) data[i] = static_cast<char>(i * 31 % 251);
    ASSERT_EQ(put(server, "t/size", data), TRANSPORT_OK) << transport_error();
    const std::vector<Kept> events = collect(client, 1);
    ASSERT_EQ(events.size(), 1u) << size;
    EXPECT_TRUE(events[0].data == data) << size;
  }
  EXPECT_EQ(put(server, "t/size", std::string((size_t{64} << 20) + 1, 'x')), TRANSPORT_BAD_ARGUMENT);
  EXPECT_NE(std::string(transport_error()).find("limit"), std::string::npos);
}

TEST(Net, KeepsOnlyTheLatestSampleOfEachKeyWhereAsked) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_subscribe(client.get(), "t/*", 0, NET_LONGEST), TRANSPORT_OK);
  ASSERT_TRUE(wait_for_subscriber(server, "t/0"));
  for (int i = 0; i < 99; ++i) {
    ASSERT_EQ(put(server, ("t/" + std::to_string(i % 3)).c_str(), std::to_string(i)), TRANSPORT_OK);
  }
  ASSERT_TRUE(wait_until(server, [&] { return stats_of(client).received == 99; }));
  const std::vector<Kept> events = poll(client);
  ASSERT_EQ(events.size(), 3u);
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(events[i].key, "t/" + std::to_string(i));
    EXPECT_EQ(events[i].data, std::to_string(96 + i));
  }
  EXPECT_EQ(stats_of(client).replaced, 96u);
  EXPECT_TRUE(poll(client, 0).empty());
}

TEST(Net, KeepsTheNewestSampleByTheSubscribersOrderWhateverTheOrderOfArrival) {
  const Session server = open_peer(), client = open_client(server);
  const NetIsNewer longer = [](const uint8_t*, size_t size, const uint8_t*, size_t waiting) { return int(size > waiting); };
  ASSERT_EQ(net_subscribe_newest(client.get(), "t/*", NET_LONGEST, longer), TRANSPORT_OK);
  EXPECT_EQ(net_subscribe_newest(client.get(), "t/*", NET_LONGEST, nullptr), TRANSPORT_BAD_ARGUMENT);
  ASSERT_TRUE(wait_for_subscriber(server, "t/a") && wait_for_subscriber(server, "t/b"));
  for (const char* key : {"t/a", "t/b"})
    for (const char* data : {"22", "", "1", "22", "55555", "333", "4444"}) ASSERT_EQ(put(server, key, data), TRANSPORT_OK);
  ASSERT_TRUE(wait_until(server, [&] { return stats_of(client).received + stats_of(client).overtaken == 14; }));
  const std::vector<Kept> events = poll(client);
  ASSERT_EQ(events.size(), 2u);
  for (const Kept& event : events) EXPECT_EQ(event.data, "55555") << event.key;
  EXPECT_EQ(stats_of(client).replaced, 2u);
  EXPECT_EQ(stats_of(client).overtaken, 10u);
  ASSERT_EQ(put(server, "t/a", "1"), TRANSPORT_OK) << "nothing waits any more";
  EXPECT_EQ(collect(client, 1).size(), 1u);
}

TEST(Net, RefusesAndCountsWhatABoundedQueueCannotHold) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_subscribe(client.get(), "t/q", 8, NET_LONGEST), TRANSPORT_OK);
  ASSERT_TRUE(wait_for_subscriber(server, "t/q"));
  for (int i = 0; i < 50; ++i) ASSERT_EQ(put(server, "t/q", std::to_string(i)), TRANSPORT_OK);
  ASSERT_TRUE(wait_until(server, [&] { return stats_of(client).received_dropped == 42; })) << stats_of(client).received_dropped;
  const std::vector<Kept> events = poll(client);
  ASSERT_EQ(events.size(), 8u);
  for (int i = 0; i < 8; ++i) EXPECT_EQ(events[i].data, std::to_string(i));
  ASSERT_EQ(put(server, "t/q", "after"), TRANSPORT_OK);
  const std::vector<Kept> after = collect(client, 1);
  ASSERT_EQ(after.size(), 1u);
  EXPECT_EQ(after[0].data, "after");
}

TEST(Net, FillsNoMoreThanTheCapacityAndKeepsTheRest) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_subscribe(client.get(), "t/c", 100, NET_LONGEST), TRANSPORT_OK);
  ASSERT_TRUE(wait_for_subscriber(server, "t/c"));
  for (int i = 0; i < 5; ++i) ASSERT_EQ(put(server, "t/c", std::to_string(i)), TRANSPORT_OK);
  ASSERT_TRUE(wait_until(server, [&] { return stats_of(client).received == 5; }));
  EXPECT_EQ(poll(client, 0, 2).size(), 2u);
  const std::vector<Kept> rest = poll(client, 0, 64);
  ASSERT_EQ(rest.size(), 3u);
  EXPECT_EQ(rest[0].data, "2");
}

TEST(Net, KnowsWhetherSomebodySubscribes) {
  const Session server = open_peer();
  EXPECT_EQ(net_matching(server.get(), "t/m"), 0);
  Session client = open_client(server);
  ASSERT_EQ(net_subscribe(client.get(), "t/*", 1, NET_LONGEST), TRANSPORT_OK);
  EXPECT_TRUE(wait_for_subscriber(server, "t/m"));
  client.reset();
  EXPECT_TRUE(wait_until(server, [&] { return net_matching(server.get(), "t/m") == 0; }));
}

TEST(Net, HearsNothingMoreOfWhatItUnsubscribedAndMaySubscribeAgain) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_subscribe(client.get(), "t/rest", 8, NET_LONGEST), TRANSPORT_OK);
  for (int k = 0; k < 3; ++k) {
    ASSERT_EQ(net_subscribe(client.get(), "t/u", k == 0 ? 0 : 8, NET_LONGEST),
              TRANSPORT_OK);  // its place in the inbox is free again
    ASSERT_TRUE(wait_for_subscriber(server, "t/u") && wait_for_subscriber(server, "t/rest"));
    const uint64_t before = stats_of(client).received;
    for (const char* each : {"heard", "heard as well"}) ASSERT_EQ(put(server, "t/u", each), TRANSPORT_OK);
    ASSERT_TRUE(wait_until(server, [&] { return stats_of(client).received == before + 2; }));
    ASSERT_EQ(poll(client).size(), k == 0 ? 1u : 2u);
    ASSERT_EQ(net_unsubscribe(client.get(), "t/u"), TRANSPORT_OK);
    ASSERT_TRUE(wait_until(server, [&] { return net_matching(server.get(), "t/u") == 0; }));
    ASSERT_EQ(put(server, "t/u", "not heard"), TRANSPORT_OK);
    ASSERT_EQ(put(server, "t/rest", "heard"), TRANSPORT_OK);
    const std::vector<Kept> events = collect(client, 1);
    ASSERT_EQ(events.size(), 1u);
    EXPECT_EQ(events[0].key, "t/rest");
  }
}

TEST(Net, DoesNotHearItself) {
  const Session server = open_peer();
  ASSERT_EQ(net_subscribe(server.get(), "t/**", 10, NET_LONGEST), TRANSPORT_OK);
  for (int i = 0; i < 10; ++i) EXPECT_EQ(net_matching(server.get(), "t/self"), 0);
  ASSERT_EQ(put(server, "t/self", "x"), TRANSPORT_OK);
  const Session client = open_client(server);
  ASSERT_EQ(net_subscribe(client.get(), "t/self", 10, NET_LONGEST), TRANSPORT_OK);
  ASSERT_TRUE(wait_for_subscriber(server, "t/self"));
  ASSERT_EQ(put(server, "t/self", "y"), TRANSPORT_OK);
  ASSERT_EQ(collect(client, 1).size(), 1u);
  EXPECT_TRUE(poll(server, 0).empty());
}

// Asks until the asker knows the queryable: the first queries may come before its declaration.
std::vector<Kept> ask(const Session& asker, const Session& answerer, const char* key, const std::string& data, int failed) {
  for (const auto end = Clock::now() + deadline; Clock::now() < end;) {
    uint64_t ticket = 0;
    EXPECT_EQ(net_get(asker.get(), key, data.data(), data.size(), 5000, &ticket), TRANSPORT_OK) << transport_error();
    std::vector<Kept> answers;
    while (answers.empty() || answers.back().kind != NET_REPLY_END) {
      if (Clock::now() > end) return answers;
      for (const Kept& query : poll(answerer, 1000)) {
        EXPECT_EQ(query.kind, NET_QUERY);
        EXPECT_EQ(query.key, key);
        const std::string answer = "answer to " + query.data;
        EXPECT_EQ(net_reply(answerer.get(), query.ticket, answer.data(), answer.size(), failed), TRANSPORT_OK);
      }
      for (Kept& event : poll(asker, 1000)) {
        EXPECT_EQ(event.ticket, ticket);
        answers.push_back(std::move(event));
      }
    }
    if (answers.size() > 1) return answers;
  }
  return {};
}

TEST(Net, AnswersAQueryAndThenSaysThatItWasTheLast) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_queryable(server.get(), "q/car", 4, NET_LONGEST), TRANSPORT_OK);
  std::vector<Kept> answers = ask(client, server, "q/car", "spawn", 0);
  ASSERT_EQ(answers.size(), 2u);
  EXPECT_EQ(answers[0].kind, NET_REPLY);
  EXPECT_EQ(answers[0].failed, 0u);
  EXPECT_EQ(answers[0].key, "q/car");
  EXPECT_EQ(answers[0].data, "answer to spawn");
  EXPECT_EQ(answers[1].kind, NET_REPLY_END);

  answers = ask(client, server, "q/car", "bad", 1);
  ASSERT_EQ(answers.size(), 2u);
  EXPECT_EQ(answers[0].failed, 1u);
  EXPECT_EQ(answers[0].data, "answer to bad");
}

TEST(Net, EndsAQuestionThatNobodyAnswers) {
  const Session server = open_peer(), client = open_client(server);
  uint64_t ticket = 0;
  ASSERT_EQ(net_get(client.get(), "q/nobody", nullptr, 0, 500, &ticket), TRANSPORT_OK);
  std::vector<Kept> events = collect(client, 1);
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(events[0].kind, NET_REPLY_END);
  EXPECT_EQ(events[0].ticket, ticket);

  // A queryable takes the query and stays silent: Zenoh reports the timeout as a failed answer, then the end.
  ASSERT_EQ(net_queryable(server.get(), "q/silent", 4, NET_LONGEST), TRANSPORT_OK);
  ASSERT_EQ(ask(client, server, "q/silent", "known", 0).size(), 2u);
  ASSERT_EQ(net_get(client.get(), "q/silent", nullptr, 0, 100, &ticket), TRANSPORT_OK);
  events.clear();
  for (const auto end = Clock::now() + deadline; Clock::now() < end;) {
    for (Kept& event : poll(client)) events.push_back(std::move(event));
    if (!events.empty() && events.back().kind == NET_REPLY_END) break;
  }
  ASSERT_FALSE(events.empty());
  EXPECT_EQ(events.back().kind, NET_REPLY_END);
  for (const Kept& event : events) {
    EXPECT_EQ(event.ticket, ticket);
    EXPECT_TRUE(event.kind == NET_REPLY_END || event.failed);
  }
}

TEST(Net, RefusesQueriesBeyondItsDepthAndSaysSo) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_queryable(server.get(), "q/busy", 1, NET_LONGEST), TRANSPORT_OK);
  ASSERT_EQ(ask(client, server, "q/busy", "known", 0).size(), 2u);
  uint64_t first = 0, second = 0;
  ASSERT_EQ(net_get(client.get(), "q/busy", "1", 1, 10000, &first), TRANSPORT_OK);
  ASSERT_EQ(net_get(client.get(), "q/busy", "2", 1, 10000, &second), TRANSPORT_OK);
  const std::vector<Kept> events = collect(client, 2);  // only the second query's events: the first waits for its answer
  ASSERT_EQ(events.size(), 2u);
  EXPECT_EQ(events[0].ticket, second);
  EXPECT_EQ(events[0].failed, 1u);
  EXPECT_EQ(events[1].kind, NET_REPLY_END);
  EXPECT_EQ(stats_of(server).queries_refused, 1u);
  ASSERT_EQ(poll(server).size(), 1u);
}

TEST(Net, KeepsNoMoreThanItsBytesOfWhatWaits) {
  const Session server = open_peer(), client = open_client(server), idle = open_client(server);
  ASSERT_EQ(net_queryable(server.get(), "q/long", 100, NET_LONGEST), TRANSPORT_OK);
  ASSERT_EQ(ask(client, server, "q/long", "known", 0).size(), 2u);
  const std::string data(size_t{60} << 20, 'x');  // four of them are 240 of 256 MiB
  uint64_t ticket = 0;
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(wait_until(idle, [&] {
      return net_get(client.get(), "q/long", data.data(), data.size(), 30000, &ticket) == TRANSPORT_OK;
    })) << transport_error();
    ASSERT_TRUE(wait_until(idle, [&] {
      const NetStats stats = stats_of(server);
      return stats.queries + stats.queries_refused == 2u + i;
    })) << i;
  }
  EXPECT_EQ(stats_of(server).queries_refused, 1u);
  const std::vector<Kept> events = poll(server);
  EXPECT_EQ(events.size(), 4u);
  for (const Kept& event : events) EXPECT_EQ(net_reply(server.get(), event.ticket, "", 0, 0), TRANSPORT_OK);
  EXPECT_EQ(collect(client, 10).size(), 10u) << "of each its answer and the end";
  EXPECT_GE(ask(client, server, "q/long", "there is room again", 0).size(), 2u);
}

TEST(Net, HearsWhomItPrefersWhileAnotherFillsAllThatMayWait) {
  const Session server = open_peer(), flood = open_client(server), known = open_client(server);
  ASSERT_EQ(net_prefer(server.get(), "t/known,t/silent"), TRANSPORT_OK) << transport_error();
  ASSERT_EQ(net_subscribe(server.get(), "t/*", 0, NET_LONGEST), TRANSPORT_OK);
  ASSERT_EQ(net_queryable(server.get(), "q/long", 100, NET_LONGEST), TRANSPORT_OK);
  ASSERT_TRUE(wait_for_subscriber(flood, "t/0") && wait_for_subscriber(known, "t/known"));
  for (uint64_t i = 1; i <= 4096; ++i) {
    ASSERT_EQ(put(flood, ("t/" + std::to_string(i)).c_str(), "x"), TRANSPORT_OK);
    ASSERT_TRUE(i % 64 != 0 || wait_until(known, [&] { return stats_of(server).received == i; })) << i;
  }
  ASSERT_EQ(put(flood, "t/unknown", "x"), TRANSPORT_OK);
  ASSERT_TRUE(wait_until(known, [&] { return stats_of(server).received_dropped == 1; }));
  ASSERT_EQ(put(known, "t/known", "one"), TRANSPORT_OK);
  ASSERT_TRUE(wait_until(known, [&] { return stats_of(server).received == 4097; })) << "no key is left for it";
  const std::string data(size_t{60} << 20, 'x');  // five of them are more than 256 MiB
  uint64_t ticket = 0;
  for (uint64_t i = 1; i <= 5; ++i) {
    ASSERT_TRUE(wait_until(known, [&] {
      return net_get(flood.get(), "q/long", data.data(), data.size(), 30000, &ticket) == TRANSPORT_OK;
    })) << transport_error();
    ASSERT_TRUE(wait_until(known, [&] { return stats_of(server).queries + stats_of(server).queries_refused == i; })) << i;
  }
  const std::string longer(size_t{20} << 20, 'y');
  ASSERT_EQ(put(known, "t/known", longer), TRANSPORT_OK);
  ASSERT_TRUE(wait_until(known, [&] { return stats_of(server).received == 4098; })) << "no bytes are left for it";
  std::string got;
  for (const Kept& event : poll(server, 0, 5000))
    if (event.key == "t/known") got += event.data;
  EXPECT_TRUE(got == longer) << got.size();
  std::string keys = "t/0";
  for (int i = 1; i <= 256; ++i) keys += ",t/" + std::to_string(i);
  EXPECT_EQ(net_prefer(server.get(), keys.c_str()), TRANSPORT_BAD_ARGUMENT);
  EXPECT_NE(std::string(transport_error()).find("256"), std::string::npos) << transport_error();
}

TEST(Net, AnAskerThatTakesNothingHoldsUpNoOtherAnswer) {
  const char* patient =
      "{transport: {link: {tx: {lease: 60000, queue: {congestion_control: {block: {wait_before_close: 60000000}}}}}}}";
  Net* opened = nullptr;
  ASSERT_EQ(net_open("peer", "tcp/127.0.0.1:0", nullptr, patient, 0, &opened), TRANSPORT_OK) << transport_error();
  const Session server(opened), other = open_client(server);
  ImpairedLink line(net_endpoint(server.get()), {});
  ASSERT_EQ(net_open("client", nullptr, line.endpoint().c_str(), patient, connect_ms, &opened), TRANSPORT_OK);
  const Session frozen(opened);
  ASSERT_EQ(net_queryable(server.get(), "q/any", 8, NET_LONGEST), TRANSPORT_OK);
  ASSERT_EQ(ask(other, server, "q/any", "known", 0).size(), 2u);
  uint64_t ticket = 0;
  ASSERT_EQ(net_get(frozen.get(), "q/any", "", 0, 30000, &ticket), TRANSPORT_OK);
  const std::vector<Kept> first = collect(server, 1);
  ASSERT_EQ(first.size(), 1u);
  line.set(LinkState::stalled);
  ASSERT_EQ(net_get(other.get(), "q/any", "", 0, 30000, &ticket), TRANSPORT_OK);
  const std::vector<Kept> second = collect(server, 1);
  ASSERT_EQ(second.size(), 1u);
  const std::string more(size_t{60} << 20, 'x');  // more than all buffers of a link hold
  ASSERT_EQ(net_reply(server.get(), first[0].ticket, more.data(), more.size(), 0), TRANSPORT_OK);
  ASSERT_EQ(net_reply(server.get(), second[0].ticket, "1", 1, 0), TRANSPORT_OK);
  const std::vector<Kept> answer = collect(other, 1);
  EXPECT_FALSE(answer.empty()) << "the other one waits until this one's line is given up";
  line.set(LinkState::up);
  const std::vector<Kept> whole = collect(frozen, 1);
  ASSERT_FALSE(whole.empty());
  EXPECT_EQ(whole[0].data.size(), more.size());
}

// A tick answers queries; it must not wait for an asker for whose answers there is no room.
TEST(Net, AnAnswerForWhichThereIsNoRoomIsRefusedAtOnce) {
  const char* patient =
      "{transport: {link: {tx: {lease: 60000, queue: {congestion_control: {block: {wait_before_close: 15000000}}}}}}}";
  Net* opened = nullptr;
  ASSERT_EQ(net_open("peer", "tcp/127.0.0.1:0", nullptr, patient, 0, &opened), TRANSPORT_OK) << transport_error();
  const Session server(opened);
  constexpr size_t questions = 40;
  ASSERT_EQ(net_queryable(server.get(), "q/any", questions, NET_LONGEST), TRANSPORT_OK);  // first: else questions may find none
  ImpairedLink line(net_endpoint(server.get()), {});
  ASSERT_EQ(net_open("client", nullptr, line.endpoint().c_str(), patient, connect_ms, &opened), TRANSPORT_OK);
  const Session frozen(opened);
  uint64_t ticket = 0;
  for (size_t i = 0; i < questions; ++i) ASSERT_EQ(net_get(frozen.get(), "q/any", "", 0, 30000, &ticket), TRANSPORT_OK);
  const std::vector<Kept> asked = collect(server, questions);
  ASSERT_EQ(asked.size(), questions);
  line.set(LinkState::stalled);
  const std::string answer(size_t{10} << 20, 'x');  // 8 are being sent, 7 wait
  const auto begun = std::chrono::steady_clock::now();
  int refused = 0;
  for (const Kept& question : asked)
    refused += net_reply(server.get(), question.ticket, answer.data(), answer.size(), 0) == TRANSPORT_DROPPED;
  EXPECT_GT(refused, 0);
  EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(10));
  line.set(LinkState::cut);
}

TEST(Net, AnswersEachTicketOnce) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_queryable(server.get(), "q/once", 4, NET_LONGEST), TRANSPORT_OK);
  ASSERT_EQ(ask(client, server, "q/once", "known", 0).size(), 2u);
  uint64_t ticket = 0;
  ASSERT_EQ(net_get(client.get(), "q/once", "1", 1, 10000, &ticket), TRANSPORT_OK);
  const std::vector<Kept> queries = collect(server, 1);
  ASSERT_EQ(queries.size(), 1u);
  EXPECT_EQ(net_reply(server.get(), queries[0].ticket, "x", 1, 0), TRANSPORT_OK);
  EXPECT_EQ(net_reply(server.get(), queries[0].ticket, "x", 1, 0), TRANSPORT_BAD_ARGUMENT);
  EXPECT_NE(std::string(transport_error()).find(std::to_string(queries[0].ticket)), std::string::npos);
}

TEST(Net, SeesAnotherSessionAppearAndGo) {
  const Session server = open_peer();
  Session early = open_client(server), late = open_client(server);
  ASSERT_EQ(net_announce(early.get(), "live/early"), TRANSPORT_OK);
  ASSERT_EQ(net_watch(server.get(), "live/*"), TRANSPORT_OK);
  std::vector<Kept> events = collect(server, 1);
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(events[0].kind, NET_ALIVE);
  EXPECT_EQ(events[0].key, "live/early");
  ASSERT_EQ(net_announce(late.get(), "live/late"), TRANSPORT_OK);
  events = collect(server, 1);
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(events[0].key, "live/late");
  early.reset();
  events = collect(server, 1);
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(events[0].kind, NET_GONE);
  EXPECT_EQ(events[0].key, "live/early");
}

TEST(Net, TakesAnAnnouncementBack) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_watch(server.get(), "live/*"), TRANSPORT_OK);
  ASSERT_EQ(net_announce(client.get(), "live/car"), TRANSPORT_OK);
  ASSERT_EQ(net_announce(client.get(), "live/other"), TRANSPORT_OK);
  ASSERT_EQ(collect(server, 2).size(), 2u);
  ASSERT_EQ(net_retract(client.get(), "live/never"), TRANSPORT_OK);
  ASSERT_EQ(net_retract(client.get(), "live/car"), TRANSPORT_OK);
  const std::vector<Kept> events = collect(server, 1);
  ASSERT_EQ(events.size(), 1u);
  EXPECT_EQ(events[0].kind, NET_GONE);
  EXPECT_EQ(events[0].key, "live/car");
}

TEST(Net, ClosesEitherEndWhileTrafficFlows) {
  Session server = open_peer();
  Session stays = open_client(server), leaves = open_client(server);
  ASSERT_EQ(net_subscribe(stays.get(), "t/flow", 100, NET_LONGEST), TRANSPORT_OK);
  ASSERT_EQ(net_subscribe(leaves.get(), "t/flow", 100, NET_LONGEST), TRANSPORT_OK);
  ASSERT_TRUE(wait_for_subscriber(server, "t/flow"));
  std::atomic<bool> stop{false};
  std::thread pump([&] {
    const std::string data(20000, 'x');
    while (!stop) put(server, "t/flow", data);
  });
  EXPECT_GE(collect(leaves, 10).size(), 10u);
  leaves.reset();
  EXPECT_GE(collect(stays, 10).size(), 10u);
  stop = true;
  pump.join();
  server.reset();  // while samples are queued
  poll(stays, 0);
}

TEST(Net, LeavesTheQueueBoundedWhenTheCallerIsFasterThanTheNetwork) {
  const Session server = open_peer(), client = open_client(server);
  ASSERT_EQ(net_subscribe(client.get(), "t/fast", 1, NET_LONGEST), TRANSPORT_OK);
  ASSERT_TRUE(wait_for_subscriber(server, "t/fast"));
  const std::string data(size_t{4} << 20, 'x');
  int status = TRANSPORT_OK;
  uint64_t calls = 0;
  for (const auto end = Clock::now() + deadline; status == TRANSPORT_OK && Clock::now() < end; ++calls) {
    status = put(server, "t/fast", data);
  }
  EXPECT_EQ(status, TRANSPORT_DROPPED);
  EXPECT_NE(std::string(transport_error()), "");
  const NetStats stats = stats_of(server);
  EXPECT_EQ(stats.put_dropped, 1u);
  EXPECT_EQ(stats.put + stats.put_dropped, calls);
}

// A scene runs for a month with new cars each second: the keys of their ids must go with them.
TEST(Net, PublishesOnSoManyKeysAndWithdrawsThoseThatNobodyNeeds) {
  const Session peer = open_peer();
  // Keys are in branches of 90, because Zenoh compares a new key with all its siblings, and 8,192 siblings take seconds.
  const auto id = [](int k) { return "t/" + std::to_string(k / 90) + "/" + std::to_string(k % 90) + "/"; };
  const auto key_of = [&](int k) { return id(k) + "key"; };
  ASSERT_EQ(put(peer, "t/stays", "x"), TRANSPORT_OK);
  int refused = 0, k = 0;
  for (; refused == 0; ++k) refused = put(peer, key_of(k).c_str(), "x");
  EXPECT_EQ(refused, TRANSPORT_DROPPED);
  EXPECT_NE(std::string(transport_error()).find("8192 keys"), std::string::npos) << transport_error();
  EXPECT_EQ(k, NET_KEYS);
  EXPECT_EQ(stats_of(peer).keys, uint64_t(NET_KEYS));
  EXPECT_EQ(put(peer, "t/stays", "x"), TRANSPORT_OK);
  while (k-- > 0) ASSERT_EQ(net_withdraw(peer.get(), id(k).c_str()), TRANSPORT_OK);
  EXPECT_EQ(stats_of(peer).keys, 1u);
}

TEST(Net, PublishesAnewOnAKeyThatWasWithdrawn) {
  const Session peer = open_peer(), client = open_client(peer);
  ASSERT_EQ(put(peer, "t/7/key", "x"), TRANSPORT_OK);
  ASSERT_EQ(net_withdraw(peer.get(), "t/7/"), TRANSPORT_OK);
  EXPECT_EQ(stats_of(peer).keys, 0u);
  ASSERT_EQ(net_subscribe(client.get(), "t/7/key", 10, NET_LONGEST), TRANSPORT_OK);
  ASSERT_TRUE(wait_for_subscriber(peer, "t/7/key"));
  ASSERT_EQ(put(peer, "t/7/key", "again"), TRANSPORT_OK);
  std::string last;  // the first may leave after the client has subscribed
  for (const auto end = Clock::now() + deadline; last != "again" && Clock::now() < end;)
    for (const Kept& event : poll(client, 50'000)) last = event.data;
  EXPECT_EQ(last, "again");
}

// A game with the client library does not handle SIGPIPE.
TEST(Net, NoThreadOfASessionIsEndedByAPeerThatHangsUp) {
  const Session peer = open_peer(), client = open_client(peer);
  int writers = 0;
  const auto until = std::chrono::steady_clock::now() + std::chrono::seconds(10);
  while (writers < 4 && std::chrono::steady_clock::now() < until) {  // a thread has its name only once it runs
    writers = 0;
    for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
      std::ifstream file(task.path() / "status");
      const std::string status{std::istreambuf_iterator<char>(file), {}};
      const bool writes =
          status.starts_with("Name:\ttx-") || status.starts_with("Name:\trx-") || status.starts_with("Name:\tnet");
      if (!writes) continue;
      ++writers;
      const uint64_t blocked = std::stoull(status.substr(status.find("SigBlk:\t") + 8), nullptr, 16);
      EXPECT_TRUE(blocked >> (SIGPIPE - 1) & 1) << status.substr(0, 20);
    }
  }
  EXPECT_GE(writers, 4);
}

// A session ends without delay (server/io/.cargo/config.toml).
TEST(Net, HandsOnWhatWasPutBeforeItClosed) {
  const Session server = open_peer();
  ASSERT_EQ(net_subscribe(server.get(), "t/last", 1000, NET_LONGEST), TRANSPORT_OK);
  constexpr size_t samples = 10;  // Zenoh has 16 batches, and each sample takes one
  for (int round = 0; round < 5; ++round) {
    Session client = open_client(server);
    ASSERT_TRUE(wait_for_subscriber(client, "t/last"));
    for (size_t k = 0; k < samples; ++k) ASSERT_EQ(put(client, "t/last", std::string(40'000, char(k))), TRANSPORT_OK);
    client.reset();
    EXPECT_EQ(collect(server, samples).size(), samples) << "round " << round;
  }
}

TEST(Net, RefusesBadArgumentsWithASentence) {
  Net* net = nullptr;
  EXPECT_EQ(net_open("router", nullptr, nullptr, nullptr, 100, &net), TRANSPORT_BAD_ARGUMENT);
  EXPECT_NE(std::string(transport_error()).find("router"), std::string::npos);
  EXPECT_EQ(net_open("peer", nullptr, nullptr, nullptr, 100, &net), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net_open("client", nullptr, nullptr, nullptr, 100, &net), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net_open("peer", "nonsense", nullptr, nullptr, 100, &net), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net_open("peer", "tcp/127.0.0.1:0", nullptr, "{ not json", 100, &net), TRANSPORT_BAD_ARGUMENT);
  EXPECT_NE(std::string(transport_error()).find("JSON5"), std::string::npos);
  EXPECT_EQ(net_open("peer", "tcp/127.0.0.1:0", nullptr, "{ nosuchkey: 1 }", 100, &net), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net_open("peer", "tcp/127.0.0.1:0", nullptr, nullptr, 100, nullptr), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net, nullptr);
  const Session peer = open_peer();
  for (const char* key : {"", "/a", "a/", "a//b", "a/*", "a#"}) {
    EXPECT_EQ(net_put(peer.get(), key, "x", 1, NET_DATA), TRANSPORT_BAD_ARGUMENT) << key;
  }
  EXPECT_EQ(net_put(peer.get(), nullptr, "x", 1, NET_DATA), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net_put(peer.get(), "a", nullptr, 1, NET_DATA), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net_put(peer.get(), "a", "x", 1, static_cast<NetPriority>(3)), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net_put(nullptr, "a", "x", 1, NET_DATA), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net_subscribe(peer.get(), "a//b", 1, NET_LONGEST), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net_announce(peer.get(), "a/*"), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(net_poll(peer.get(), nullptr, 1, 0), TRANSPORT_BAD_ARGUMENT);
}

// Keys with so many parts would overflow the stack of the program that reads them.
TEST(Net, RefusesAConfigurationOfBracketsWithinBrackets) {
  std::string list, map;
  for (int k = 0; k < 20'000; ++k) list += '[', map += "{a:";
  for (const std::string& text : {list + std::string(20'000, ']'), map + "1" + std::string(20'000, '}')}) {
    EXPECT_EQ(net_check(text.c_str()), TRANSPORT_BAD_ARGUMENT);
    EXPECT_NE(std::string(transport_error()).find("brackets"), std::string::npos) << transport_error();
  }
}

TEST(Net, SaysWhichEndpointItCannotUse) {
  const Session taken = open_peer();
  Net* net = nullptr;
  EXPECT_EQ(net_open("peer", net_endpoint(taken.get()), nullptr, nullptr, 100, &net), TRANSPORT_IO);
  EXPECT_NE(std::string(transport_error()).find(net_endpoint(taken.get())), std::string::npos) << transport_error();
  std::string free;  // a port that was free just now
  {
    const Session short_lived = open_peer();
    free = net_endpoint(short_lived.get());
  }
  EXPECT_EQ(net_open("client", nullptr, free.c_str(), nullptr, 300, &net), TRANSPORT_IO);
  EXPECT_NE(std::string(transport_error()).find(free), std::string::npos) << transport_error();
}

TEST(Net, TakesTheCallersConfigurationOverItsOwn) {
  const Session server = open_peer();
  const Session client = open_client(server, "{ transport: { link: { tx: { lease: 5000 } } }, /* a comment */ }");
  ASSERT_EQ(net_subscribe(client.get(), "t/conf", 1, NET_LONGEST), TRANSPORT_OK);
  EXPECT_TRUE(wait_for_subscriber(server, "t/conf"));
  Net* net = nullptr;  // the overlay also overrides the arguments
  EXPECT_EQ(net_open("client", nullptr, net_endpoint(server.get()), "{ connect: { endpoints: [\"x\"] } }", 100, &net),
            TRANSPORT_BAD_ARGUMENT);
}

// ---- recordings ----

std::string temporary(const std::string& name) {
  const testing::TestInfo* test = testing::UnitTest::GetInstance()->current_test_info();
  return testing::TempDir() + "transport_" + test->name() + "_" + name;
}

std::string read_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// Uses a new file each time, because ext4 waits for the disk when a file is truncated, rewritten and closed.
void write_file(const std::string& path, const std::string& bytes) {
  std::filesystem::remove(path);
  std::ofstream(path, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

struct Entry {
  std::string topic, schema, data;
  uint32_t sequence;
  uint64_t log_time, publish_time;
  bool operator==(const Entry&) const = default;
};

struct Recording {
  int opened = TRANSPORT_OK, ended = TRANSPORT_OK, cut = 0;  // ended: the last reader_next
  std::vector<Entry> entries;
  std::vector<std::string> attachments, metadata;
};

Recording read_recording(const std::string& path) {
  Recording recording;
  Reader* reader = nullptr;
  recording.opened = reader_open(path.c_str(), &reader);
  if (recording.opened != TRANSPORT_OK) return recording;
  recording.cut = reader_cut(reader);
  const char *name, *type;
  const uint8_t* data;
  size_t size;
  for (uint32_t i = 0; reader_attachment(reader, i, &name, &type, &data, &size) == 1; ++i) {
    EXPECT_EQ(reinterpret_cast<uintptr_t>(data) % 16, 0u);
    recording.attachments.push_back(std::string(name) + "|" + type + "|" +
                                    std::string(reinterpret_cast<const char*>(data), size));
  }
  const char* const* pairs;
  for (uint32_t i = 0; reader_metadata(reader, i, &name, &pairs) == 1; ++i) {
    std::string line = name;
    for (; *pairs; ++pairs) line += std::string("|") + *pairs;
    recording.metadata.push_back(line);
  }
  ReaderMessage m{};
  while ((recording.ended = reader_next(reader, &m)) == 1) {
    EXPECT_EQ(reinterpret_cast<uintptr_t>(m.data) % 16, 0u);
    recording.entries.push_back(
        {m.topic, m.schema, {reinterpret_cast<const char*>(m.data), m.size}, m.sequence, m.log_time_ns, m.publish_time_ns});
  }
  reader_close(reader);
  return recording;
}

// Two topics, an attachment and metadata first; bytes that compress somewhat.
std::vector<Entry> write_recording(const std::string& path, int count, size_t size) {
  Recorder* recorder = nullptr;
  EXPECT_EQ(recorder_open(path.c_str(), "crumple", "test", &recorder), TRANSPORT_OK) << transport_error();
  const char* pairs[] = {"tick", "60", "epsilon", "0.5", nullptr};
  EXPECT_EQ(recorder_metadata(recorder, "parameters", pairs), TRANSPORT_OK);
  EXPECT_EQ(recorder_attach(recorder, "car", "application/octet-stream", "\0body\0", 6), TRANSPORT_OK);
  const int schema = recorder_schema(recorder, "Poses", "schema bytes", 12);
  const int channels[] = {recorder_channel(recorder, "in/poses", schema), recorder_channel(recorder, "out/hash", schema)};
  EXPECT_TRUE(schema >= 0 && channels[0] >= 0 && channels[1] > channels[0]);
  std::vector<Entry> entries;
  uint32_t noise = 1;
  for (int i = 0; i < count; ++i) {
    std::string data(size + static_cast<size_t>(i % 7), 'a');
    for (size_t j = 0; j < data.size(); j += 3) data[j] = static_cast<char>((noise = noise * 1664525u + 1013904223u) >> 24);
    const uint32_t sequence = static_cast<uint32_t>(i);
    const uint64_t time = 1000u * sequence;
    EXPECT_EQ(recorder_write(recorder, channels[i % 2], sequence, time, time + 1, data.data(), data.size()), TRANSPORT_OK);
    entries.push_back({i % 2 ? "out/hash" : "in/poses", "Poses", data, sequence, time, time + 1});
  }
  EXPECT_EQ(recorder_lost(recorder), 0u);
  EXPECT_STREQ(recorder_trouble(recorder), "");
  EXPECT_EQ(recorder_close(recorder), TRANSPORT_OK) << transport_error();
  return entries;
}

TEST(Recording, ComesBackAsItWasWritten) {
  const std::string path = temporary("whole.mcap");
  const std::vector<Entry> written = write_recording(path, 5000, 300);
  const Recording read = read_recording(path);
  EXPECT_EQ(read.cut, 0);
  EXPECT_EQ(read.ended, 0) << transport_error();
  EXPECT_TRUE(read.entries == written) << read.entries.size();
  EXPECT_EQ(read.attachments, std::vector<std::string>{std::string("car|application/octet-stream|\0body\0", 35)});
  EXPECT_EQ(read.metadata, std::vector<std::string>{"parameters|epsilon|0.5|tick|60"});  // MCAP keeps maps sorted
}

TEST(Recording, CanBeReadAgainFromTheStart) {
  const std::string path = temporary("twice.mcap");
  write_recording(path, 10, 50);
  Reader* reader = nullptr;
  ASSERT_EQ(reader_open(path.c_str(), &reader), TRANSPORT_OK);
  for (int round = 0; round < 3; ++round) {
    ReaderMessage message{};
    uint32_t count = 0;
    for (; reader_next(reader, &message) == 1; ++count) EXPECT_EQ(message.sequence, count);
    EXPECT_EQ(count, 10u);
    ASSERT_EQ(reader_rewind(reader), TRANSPORT_OK);
  }
  reader_close(reader);
}

// Finds the chunks of a file without the reader: {end of a chunk, messages up to there, by the indexes after the chunk}.
std::vector<std::pair<size_t, size_t>> chunk_ends(const std::string& bytes) {
  std::vector<std::pair<size_t, size_t>> ends;
  size_t messages = 0;
  for (size_t at = 8; at + 9 <= bytes.size() - 8;) {
    uint64_t size = 0;
    std::memcpy(&size, bytes.data() + at + 1, 8);
    const unsigned char opcode = static_cast<unsigned char>(bytes[at]);
    if (opcode == 0x06) ends.push_back({at + 9 + size, 0});
    if (opcode == 0x07) {  // message index: channel u16, bytes u32, entries of 16 bytes
      uint32_t entries = 0;
      std::memcpy(&entries, bytes.data() + at + 11, 4);
      messages += entries / 16;
      ends.back().second = messages;
    }
    at += 9 + size;
  }
  return ends;
}

TEST(Recording, CutAnywhereIsReadableUpToTheLastWholeChunk) {
  const std::string path = temporary("whole.mcap"), cut_path = temporary("cut.mcap");
  const std::vector<Entry> written = write_recording(path, 3000, 300);
  const std::string bytes = read_file(path);
  const auto ends = chunk_ends(bytes);
  ASSERT_GE(ends.size(), 3u);
  ASSERT_EQ(ends.back().second, written.size());
  std::vector<size_t> cuts;
  for (size_t i = 0; i < 64; ++i) cuts.push_back(bytes.size() * i / 64);
  for (size_t i = 1; i <= 200; ++i) cuts.push_back(bytes.size() - i);
  for (size_t i = 0; i < 200; ++i) cuts.push_back(i);
  for (const auto& [end, count] : ends) cuts.insert(cuts.end(), {end - 1, end, end + 1});
  for (const size_t cut : cuts) {
    write_file(cut_path, bytes.substr(0, cut));
    size_t expected = 0;
    for (const auto& [end, count] : ends) expected = end <= cut ? count : expected;
    const Recording read = read_recording(cut_path);
    ASSERT_EQ(read.opened, TRANSPORT_OK) << cut << ": " << transport_error();
    EXPECT_EQ(read.cut, 1) << cut;
    EXPECT_EQ(read.ended, 0) << cut << ": " << transport_error();
    ASSERT_EQ(read.entries.size(), expected) << cut;
    EXPECT_TRUE(std::equal(read.entries.begin(), read.entries.end(), written.begin())) << cut;
  }
}

TEST(Recording, DamagedAnywhereNeverCrashesAndNeverPassesForWhole) {
  const std::string path = temporary("whole.mcap"), bad_path = temporary("damaged.mcap");
  const std::vector<Entry> written = write_recording(path, 12, 40);
  const std::string bytes = read_file(path);
  for (size_t at = 0; at < bytes.size(); ++at) {
    for (const int flip : {0x01, 0x80, 0xff}) {
      std::string damaged = bytes;
      damaged[at] = static_cast<char>(damaged[at] ^ flip);
      write_file(bad_path, damaged);
      const Recording read = read_recording(bad_path);
      if (read.opened == TRANSPORT_OK && read.ended == 0 && !read.cut) {
        EXPECT_TRUE(read.entries == written) << "byte " << at << " xor " << flip;
      } else if (read.opened != TRANSPORT_OK || read.ended != 0) {
        EXPECT_NE(std::string(transport_error()).find(bad_path), std::string::npos) << transport_error();
      }
    }
  }
}

TEST(Recording, RefusesWhatIsNoRecordingAndSaysSo) {
  Reader* reader = nullptr;
  EXPECT_EQ(reader_open(temporary("missing.mcap").c_str(), &reader), TRANSPORT_IO);
  EXPECT_NE(std::string(transport_error()).find("missing.mcap"), std::string::npos);
  const std::string path = temporary("text.mcap");
  write_file(path, "this is a text file, not a recording");
  EXPECT_EQ(reader_open(path.c_str(), &reader), TRANSPORT_BAD_FILE);
  EXPECT_NE(std::string(transport_error()).find("not an MCAP"), std::string::npos);
  // an attachment that claims more than any file may hold
  std::string hostile("\x89MCAP0\r\n\x09", 9);
  hostile += std::string("\xff\xff\xff\xff\xff\xff\xff\xff", 8) + std::string(100, 'x');
  write_file(path, hostile);
  const Recording read = read_recording(path);
  EXPECT_EQ(read.opened, TRANSPORT_OK);
  EXPECT_EQ(read.cut, 1);
  EXPECT_TRUE(read.entries.empty());
  EXPECT_EQ(reader_open(nullptr, &reader), TRANSPORT_BAD_ARGUMENT);
}

// A reader that trusts the length of a string would allocate memory before it sees that the bytes are missing.
TEST(Recording, RefusesStringsThatAreLongerThanTheirRecord) {
  using namespace std::string_literals;
  const std::string huge = "\xff\xff\xff\x7f"s, none = "\0\0\0\0"s, ids = "\1\0\1\0"s;
  const std::pair<char, std::string> records[] = {
      {'\x03', ids.substr(0, 2) + huge},                          // schema: name
      {'\x04', ids + none + huge},                                // channel: encoding
      {'\x04', ids + none + none + "\x08\0\0\0"s + none + huge},  // channel: a value of its metadata
      {'\x0c', huge},                                             // metadata: name
      {'\x0c', none + "\x04\0\0\0"s + huge},                      // metadata: a key
  };
  for (const auto& [opcode, body] : records) {
    const std::string path = temporary("hostile.mcap");
    write_file(path, "\x89MCAP0\r\n"s + opcode + char(body.size()) + std::string(7, '\0') + body);
    Reader* reader = nullptr;
    ASSERT_EQ(reader_open(path.c_str(), &reader), TRANSPORT_OK);
    ReaderMessage message;
    EXPECT_EQ(reader_next(reader, &message), TRANSPORT_BAD_FILE);
    EXPECT_NE(std::string(transport_error()).find("do not fit"), std::string::npos) << transport_error();
    reader_close(reader);
  }
}

// A record in a chunk claims 200 MB that do not exist.
TEST(Recording, MakesRoomForNoMoreThanTheFileHas) {
  std::string chunk(24 + 4, '\0');  // times, size, sum
  chunk += std::string(4, '\0');    // no compression
  const uint64_t records = 1 << 20, claimed = 200 << 20;
  const auto number = [](uint64_t value) { return std::string(reinterpret_cast<const char*>(&value), sizeof value); };
  chunk += number(records) + '\x05' + number(claimed) + std::string(records - 9, 'x');
  const std::string path = temporary("hostile.mcap");
  write_file(path, std::string("\x89MCAP0\r\n\x06", 9) + number(chunk.size()) + chunk);
  rusage before{}, after{};
  getrusage(RUSAGE_SELF, &before);
  const Recording read = read_recording(path);
  getrusage(RUSAGE_SELF, &after);
  EXPECT_EQ(read.opened, TRANSPORT_OK);
  EXPECT_EQ(read.ended, TRANSPORT_BAD_FILE);
  EXPECT_LT(after.ru_maxrss - before.ru_maxrss, 50'000) << "kB";
}

std::string number(uint64_t value, size_t bytes) { return {reinterpret_cast<const char*>(&value), bytes}; }

// A chunk of records of the unknown kind 0x80, each with 100 MiB of zeros, packed by zstd: 4 bytes give 128 KiB.
std::string zstd_bomb(int records, uint64_t claimed) {
  constexpr uint64_t block = 128 << 10, blocks = 800;
  const auto block_head = [](uint64_t size, uint64_t type, bool last) { return number(size << 3 | type << 1 | last, 3); };
  std::string packed("\x28\xb5\x2f\xfd\0\x38", 6);  // magic, no size, a window of 128 KiB
  for (int k = 0; k < records; ++k) {
    packed += block_head(9, 0, false) + '\x80' + number(block * blocks, 8);
    for (uint64_t i = 1; i <= blocks; ++i) packed += block_head(block, 1, k == records - 1 && i == blocks) + '\0';
  }
  const std::string body =
      std::string(16, '\0') + number(claimed, 8) + number(0, 4) + number(4, 4) + "zstd" + number(packed.size(), 8) + packed;
  return '\x06' + number(body.size(), 8) + body;
}

// 130 kB that expand to 4 GB, which takes a reader's time or fills its memory.
TEST(Recording, AChunkThatGivesFarMoreThanItTakesIsRefusedBeforeItIsUnpacked) {
  const std::string path = temporary("whole.mcap"), bomb = temporary("bomb.mcap");
  const std::vector<Entry> written = write_recording(path, 3000, 300);
  const std::string bytes = read_file(path);
  const size_t end = chunk_ends(bytes).back().first;
  constexpr uint64_t record = (100 << 20) + 9;
  for (const auto& [records, claimed] : {std::pair(40, 40 * record), {1, record}, {1, uint64_t{60} << 20}}) {
    write_file(bomb, bytes.substr(0, end) + zstd_bomb(records, claimed) + bytes.substr(end));
    const Recording read = read_recording(bomb);
    EXPECT_EQ(read.opened, TRANSPORT_OK);
    EXPECT_EQ(read.ended, TRANSPORT_BAD_FILE);
    EXPECT_NE(std::string(transport_error())
                  .find("the chunk at byte " + std::to_string(end) + " claims to hold " + std::to_string(claimed) + " bytes"),
              std::string::npos)
        << transport_error();
    EXPECT_TRUE(read.entries == written) << "what stands before it is sound";
  }
}

// LZ4 makes data at most 255 times smaller: the longest recorded message, of zeros.
TEST(Recording, WhatItPacksBestItReadsAgain) {
  const std::string path = temporary("zeros.mcap"), data(size_t{32} << 20, '\0');
  Recorder* recorder = nullptr;
  ASSERT_EQ(recorder_open(path.c_str(), "", "", &recorder), TRANSPORT_OK);
  const int channel = recorder_channel(recorder, "t", recorder_schema(recorder, "S", nullptr, 0));
  for (uint32_t k = 0; k < 2; ++k)
    ASSERT_EQ(recorder_write(recorder, channel, k, k, k, data.data(), data.size()), TRANSPORT_OK);
  ASSERT_EQ(recorder_close(recorder), TRANSPORT_OK);
  EXPECT_LT(std::filesystem::file_size(path), 2 * data.size() / 240);
  const Recording read = read_recording(path);
  EXPECT_EQ(read.ended, 0) << transport_error();
  ASSERT_EQ(read.entries.size(), 2u);
  EXPECT_TRUE(read.entries[0].data == data);
}

// A reader keeps schemas and topics to the end.
TEST(Recording, RefusesSchemasThatFillTheMemory) {
  const std::string path = temporary("schemas.mcap"), schema(size_t{10} << 20, '\0');
  for (const int distinct : {6, 7}) {
    Recorder* recorder = nullptr;
    ASSERT_EQ(recorder_open(path.c_str(), "", "", &recorder), TRANSPORT_OK);
    for (int k = 0; k < distinct; ++k) {
      const std::string name = "S" + std::to_string(k);
      const int channel =
          recorder_channel(recorder, name.c_str(), recorder_schema(recorder, name.c_str(), schema.data(), schema.size()));
      ASSERT_EQ(recorder_write(recorder, channel, 0, 0, 0, "x", 1), TRANSPORT_OK);
    }
    ASSERT_EQ(recorder_close(recorder), TRANSPORT_OK);
    const Recording read = read_recording(path);
    EXPECT_EQ(read.ended, distinct == 6 ? 0 : TRANSPORT_BAD_FILE) << transport_error();
    EXPECT_EQ(read.entries.size(), 6u);
  }
  EXPECT_NE(std::string(transport_error()).find("its schemas and channels take over 64 MiB"), std::string::npos)
      << transport_error();
}

TEST(Recording, IsReadableWhileItIsBeingWritten) {
  const std::string path = temporary("open.mcap");
  Recorder* recorder = nullptr;
  ASSERT_EQ(recorder_open(path.c_str(), "", "", &recorder), TRANSPORT_OK);
  const int channel = recorder_channel(recorder, "t", recorder_schema(recorder, "S", nullptr, 0));
  for (uint32_t i = 0; i < 10; ++i) ASSERT_EQ(recorder_write(recorder, channel, i, i, i, "x", 1), TRANSPORT_OK);
  // As if killed: nothing is closed, and data that was written a second ago must be in the file.
  Recording read;
  for (const auto end = Clock::now() + deadline; read.entries.size() < 10 && Clock::now() < end;) {
    read = read_recording(path);
    std::this_thread::yield();
  }
  EXPECT_EQ(read.entries.size(), 10u);
  EXPECT_EQ(read.cut, 1);
  EXPECT_EQ(recorder_close(recorder), TRANSPORT_OK);
  EXPECT_EQ(read_recording(path).cut, 0);
}

TEST(Recording, CountsEveryMessageThatAFullDiskDidNotTake) {
  if (!std::filesystem::exists("/dev/full")) GTEST_SKIP() << "no /dev/full here";
  Recorder* recorder = nullptr;
  ASSERT_EQ(recorder_open("/dev/full", "", "", &recorder), TRANSPORT_OK) << transport_error();
  const int channel = recorder_channel(recorder, "t", recorder_schema(recorder, "S", nullptr, 0));
  const std::string data(1000, 'x');
  for (uint32_t i = 0; i < 1000; ++i) {
    ASSERT_EQ(recorder_write(recorder, channel, i, i, i, data.data(), data.size()), TRANSPORT_OK);
  }
  for (const auto end = Clock::now() + deadline; recorder_lost(recorder) < 1000 && Clock::now() < end;) {
    std::this_thread::yield();
  }
  EXPECT_EQ(recorder_lost(recorder), 1000u);
  EXPECT_NE(std::string(recorder_trouble(recorder)).find("/dev/full"), std::string::npos);
  EXPECT_NE(std::string(recorder_trouble(recorder)).find("No space left"), std::string::npos) << recorder_trouble(recorder);
  EXPECT_EQ(recorder_close(recorder), TRANSPORT_IO);
}

TEST(Recording, RefusesAFolderThatIsNotThereAndIdsThatWereNotGiven) {
  Recorder* recorder = nullptr;
  EXPECT_EQ(recorder_open("/nonexistent/folder/x.mcap", "", "", &recorder), TRANSPORT_IO);
  EXPECT_NE(std::string(transport_error()).find("/nonexistent/folder/x.mcap"), std::string::npos);
  ASSERT_EQ(recorder_open(temporary("ids.mcap").c_str(), "", "", &recorder), TRANSPORT_OK);
  EXPECT_EQ(recorder_channel(recorder, "t", 0), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(recorder_channel(recorder, "t", -1), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(recorder_write(recorder, 0, 0, 0, 0, "x", 1), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(recorder_write(recorder, -1, 0, 0, 0, "x", 1), TRANSPORT_BAD_ARGUMENT);
  const char* twice[] = {"a", "1", "a", "2", nullptr};
  EXPECT_EQ(recorder_metadata(recorder, "m", twice), TRANSPORT_BAD_ARGUMENT);
  const char* half[] = {"a", nullptr};
  EXPECT_EQ(recorder_metadata(recorder, "m", half), TRANSPORT_BAD_ARGUMENT);
  EXPECT_EQ(recorder_close(recorder), TRANSPORT_OK);
}

// Returns the text after `marker`, up to the next quote or space.
std::string after(const std::string& text, const std::string& marker) {
  const size_t at = text.find(marker);
  if (at == std::string::npos) return "no " + marker;
  const size_t start = at + marker.size();
  return text.substr(start, text.find_first_of("\"\n ,", start) - start);
}

// All ends must use the same minor version of Zenoh: the Rust library and the Python tools.
TEST(Transport, AgreesWithPythonOnTheVersionOfZenoh) {
  const std::filesystem::path root = in_repository("");
  const std::string lock = after(read_file(root / "server/io/Cargo.lock"), "name = \"zenoh\"\nversion = \"");
  EXPECT_EQ(lock, after(read_file(root / "server/requirements.txt"), "eclipse-zenoh=="));
  EXPECT_EQ(lock, after(transport_version(), "zenoh "));
}

}  // namespace
}  // namespace crumple

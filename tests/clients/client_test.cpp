// Tests the viewer's decoder with messages of the server's encoder: unchanged, lost, repeated, reordered, and hostile. Also
// tests the scene files.
#include <crumple_client.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <random>
#include <thread>

#include "box_car.h"
#include "cpp/scene.h"
#include "io/net.h"
#include "paths.h"
#include "protocol/surface_codec.h"
#include "reference/pile_up.h"
#include "refusal.h"
#include "sanitized.h"
#include "schema/message_generated.h"
#include "viewer/surface.h"
#include "wheeled_car.h"
#include "wire/encode.h"

namespace crumple {
namespace {

using viewer::Applied;
using viewer::apply_delta;
using viewer::apply_keyframe;
using viewer::Quanta;

constexpr uint32_t nodes = 700;  // 44 blocks, the last one incomplete
const std::string asset = "0123456789abcdef";

std::span<const uint8_t> bytes_of(const Bytes& bytes) { return {reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}; }

Quanta random_quanta(std::mt19937& random, size_t count = nodes) {
  std::uniform_int_distribution<int> value(-32767, 32767);
  Quanta quanta(3 * count);
  for (auto& q : quanta) q = static_cast<int16_t>(value(random));
  return quanta;
}

std::vector<Bytes> keyframe(uint64_t tick, const Quanta& quanta, uint32_t largest = nodes, float quantum = 0.0005f) {
  return encode_keyframe({tick, asset, quantum}, quanta, largest);
}

std::vector<Bytes> delta(uint64_t tick, const Quanta& quanta, uint64_t key_tick, const Quanta& key) {
  return encode_delta({tick, asset, 0.0005f}, quanta, key_tick, key);
}

viewer::Surface holding(uint64_t tick, const Quanta& quanta) {
  viewer::Surface surface;
  EXPECT_EQ(apply_keyframe(bytes_of(keyframe(tick, quanta).front()), surface).applied, Applied::whole);
  return surface;
}

TEST(Client, HoldsAKeyframeAsTheServerEncodedIt) {
  std::mt19937 random(1);
  const Quanta quanta = random_quanta(random);
  const viewer::Surface surface = holding(7, quanta);
  EXPECT_EQ(surface.quanta, quanta);
  EXPECT_EQ(surface.tick, 7u);
  EXPECT_EQ(surface.hash, surface_hash(quanta));
  EXPECT_EQ(surface.asset, asset);
  EXPECT_FLOAT_EQ(surface.quantum, 0.0005f);
}

TEST(Client, AKeyframeInPartsIsWholeWithItsLastPartInAnyOrder) {
  std::mt19937 random(2);
  const Quanta quanta = random_quanta(random);
  auto parts = keyframe(7, quanta, 100);
  ASSERT_EQ(parts.size(), 7u);
  std::shuffle(parts.begin(), parts.end(), random);
  viewer::Surface surface;
  for (size_t i = 0; i + 1 < parts.size(); ++i) {
    EXPECT_EQ(apply_keyframe(bytes_of(parts[i]), surface).applied, Applied::part);
    EXPECT_TRUE(surface.quanta.empty());
  }
  EXPECT_EQ(apply_keyframe(bytes_of(parts.back()), surface).applied, Applied::whole);
  EXPECT_EQ(surface.quanta, quanta);
}

TEST(Client, ADeltaIsAgainstTheKeyframeAndWrapsModulo65536) {
  Quanta key(3 * nodes, 0), now(3 * nodes, 0);
  key[0] = 32767;
  now[0] = -32767;
  key[3 * nodes - 1] = -32767;
  now[3 * nodes - 1] = 32767;
  viewer::Surface surface = holding(1, key);
  EXPECT_EQ(apply_delta(bytes_of(delta(2, now, 1, key).front()), surface).applied, Applied::whole);
  EXPECT_EQ(surface.quanta, now);
  // The next delta does not build on this one.
  EXPECT_EQ(apply_delta(bytes_of(delta(3, key, 1, key).front()), surface).applied, Applied::whole);
  EXPECT_EQ(surface.quanta, key);
}

TEST(Client, ADeltaInPartsIsWholeOnlyWithAllOfThem) {
  std::mt19937 random(3);
  constexpr size_t many = 30'000;
  const Quanta key = random_quanta(random, many), now = random_quanta(random, many);
  viewer::Surface surface;
  for (const Bytes& part : encode_keyframe({1, asset, 0.0005f}, key))
    static_cast<void>(apply_keyframe(bytes_of(part), surface));
  ASSERT_EQ(surface.quanta, key);
  const auto parts = delta(2, now, 1, key);
  ASSERT_GT(parts.size(), 2u);
  for (size_t i = 0; i + 1 < parts.size(); ++i) {
    EXPECT_LT(parts[i].size(), 64'000u);
    EXPECT_EQ(apply_delta(bytes_of(parts[i]), surface).applied, Applied::part);
    EXPECT_EQ(surface.quanta, key);
  }
  EXPECT_EQ(apply_delta(bytes_of(parts.back()), surface).applied, Applied::whole);
  EXPECT_EQ(surface.quanta, now);
}

TEST(Client, DropsWhatIsOlderThanWhatItHolds) {
  std::mt19937 random(4);
  const Quanta a = random_quanta(random), b = random_quanta(random), c = random_quanta(random);
  viewer::Surface surface = holding(10, a);
  EXPECT_EQ(apply_delta(bytes_of(delta(12, b, 10, a).front()), surface).applied, Applied::whole);
  EXPECT_EQ(apply_delta(bytes_of(delta(11, c, 10, a).front()), surface).applied, Applied::old);
  EXPECT_EQ(apply_delta(bytes_of(delta(12, b, 10, a).front()), surface).applied, Applied::old);
  EXPECT_EQ(apply_keyframe(bytes_of(keyframe(9, c).front()), surface).applied, Applied::old);
  EXPECT_EQ(surface.quanta, b);
}

TEST(Client, ADeltaAgainstAKeyframeThatItLacksAsksForIt) {
  std::mt19937 random(5);
  const Quanta a = random_quanta(random), b = random_quanta(random), c = random_quanta(random);
  viewer::Surface empty;
  EXPECT_EQ(apply_delta(bytes_of(delta(12, b, 10, a).front()), empty).applied, Applied::missing_keyframe);
  viewer::Surface surface = holding(10, a);
  EXPECT_EQ(apply_delta(bytes_of(delta(22, c, 20, b).front()), surface).applied, Applied::missing_keyframe);
  EXPECT_EQ(surface.quanta, a);
  EXPECT_EQ(apply_keyframe(bytes_of(keyframe(20, b).front()), surface).applied, Applied::whole);
  EXPECT_EQ(apply_delta(bytes_of(delta(22, c, 20, b).front()), surface).applied, Applied::whole);
  EXPECT_EQ(surface.quanta, c);
}

TEST(Client, InBadWeatherItHoldsNothingThatTheServerNeverHadAndIsEqualAfterwards) {
  std::mt19937 random(6);
  std::vector<std::pair<bool, Bytes>> sent;  // keyframe?, message
  std::map<uint64_t, Quanta> truth;
  Quanta key, now = random_quanta(random);
  uint64_t key_tick = 0;
  for (uint64_t tick = 1; tick <= 300; ++tick) {
    for (int i = 0; i < 40; ++i) now[random() % now.size()] = static_cast<int16_t>(random());
    truth[tick] = now;
    const bool is_key = tick % 60 == 1;
    if (is_key) {
      key = now;
      key_tick = tick;
    }
    for (Bytes& part : is_key ? keyframe(tick, now, 300) : delta(tick, now, key_tick, key)) {
      if (random() % 5 == 0) continue;  // lost
      for (unsigned n = random() % 8 == 0 ? 2 : 1; n > 0; --n) sent.emplace_back(is_key, part);
    }
  }
  for (size_t i = 0; i + 1 < sent.size(); ++i)
    if (random() % 4 == 0) std::swap(sent[i], sent[std::min(sent.size() - 1, i + 1 + random() % 6)]);
  viewer::Surface surface;
  uint64_t last = 0, advanced = 0;
  for (const auto& [is_key, message] : sent) {
    const auto outcome = is_key ? apply_keyframe(bytes_of(message), surface) : apply_delta(bytes_of(message), surface);
    EXPECT_NE(outcome.applied, Applied::refused) << outcome.why;
    if (outcome.applied == Applied::missing_keyframe)  // it asks, and gets the present keyframe
      static_cast<void>(apply_keyframe(bytes_of(keyframe(key_tick, key).front()), surface));
    if (surface.quanta.empty()) continue;
    ASSERT_EQ(surface.quanta, truth.at(surface.tick));
    EXPECT_GE(surface.tick, last);
    advanced += surface.tick > last;
    last = surface.tick;
  }
  EXPECT_GT(advanced, 10u);
  static_cast<void>(apply_keyframe(bytes_of(keyframe(301, now).front()), surface));
  EXPECT_EQ(surface.quanta, now);
}

// For any bytes: if a surface is held afterwards, its hash is the one in the message.
void expect_sound(const viewer::Surface& surface) {
  if (!surface.quanta.empty()) {
    EXPECT_EQ(surface_hash(surface.quanta), surface.hash);
  }
}

using Apply = viewer::Outcome (*)(std::span<const uint8_t>, viewer::Surface&);

void try_every_prefix(const Bytes& message, Apply apply, const viewer::Surface& before) {
  for (size_t size = 0; size < message.size(); ++size) {
    const Bytes prefix(message.begin(), message.begin() + static_cast<ptrdiff_t>(size));
    viewer::Surface surface = before;
    const auto outcome = apply(bytes_of(prefix), surface);
    if (size + 8 > message.size() && outcome.applied == Applied::whole) continue;  // only padding was cut
    EXPECT_EQ(outcome.applied, Applied::refused) << "prefix of " << size << " bytes";
    EXPECT_FALSE(outcome.why.empty());
    EXPECT_EQ(surface.quanta, before.quanta);
  }
}

void try_every_bit_flip(Bytes message, Apply apply, const viewer::Surface& before) {
  for (size_t bit = 0; bit < 8 * message.size(); ++bit) {
    message[bit / 8] ^= static_cast<std::byte>(1u << bit % 8);
    viewer::Surface surface = before;
    static_cast<void>(apply(bytes_of(message), surface));
    expect_sound(surface);
    message[bit / 8] ^= static_cast<std::byte>(1u << bit % 8);
  }
}

TEST(Client, RefusesEveryPrefixOfAKeyframe) {
  std::mt19937 random(7);
  const Quanta quanta = random_quanta(random, 130);
  try_every_prefix(keyframe(5, quanta).front(), apply_keyframe, {});
}

TEST(Client, RefusesEveryPrefixOfADelta) {
  std::mt19937 random(8);
  const Quanta key = random_quanta(random, 130), now = random_quanta(random, 130);
  try_every_prefix(delta(6, now, 5, key).front(), apply_delta, holding(5, key));
}

TEST(Client, SurvivesEveryBitFlipOfAKeyframe) {
  std::mt19937 random(9);
  const Quanta quanta = random_quanta(random, 130);
  try_every_bit_flip(keyframe(5, quanta).front(), apply_keyframe, holding(4, random_quanta(random, 130)));
}

TEST(Client, SurvivesEveryBitFlipOfADelta) {
  std::mt19937 random(10);
  const Quanta key = random_quanta(random, 130), now = random_quanta(random, 130);
  try_every_bit_flip(delta(6, now, 5, key).front(), apply_delta, holding(5, key));
}

Bytes hand_made_delta(uint32_t total, uint32_t first, uint32_t count, std::vector<uint16_t> words) {
  flatbuffers::FlatBufferBuilder builder;
  const auto packed = builder.CreateVector(words);
  builder.Finish(schema::CreateDelta(builder, 6, 5, total, first, count, packed, 0));
  const auto* data = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return {data, data + builder.GetSize()};
}

TEST(Client, RefusesADeltaWhoseCountsDoNotFitEachOther) {
  const viewer::Surface held = holding(5, Quanta(3 * nodes, 0));
  const auto outcome = [&](const Bytes& message) {
    viewer::Surface surface = held;
    return apply_delta(bytes_of(message), surface).applied;
  };
  const uint16_t wide = 16 | 16 << 5 | 16 << 10;
  std::vector<uint16_t> block(49, 1);
  block[0] = wide;
  EXPECT_EQ(outcome(hand_made_delta(nodes, 0, 16, {0})), Applied::part);  // fits, but the hash does not match
  EXPECT_EQ(outcome(hand_made_delta(nodes, 0, 16, block)), Applied::part);
  EXPECT_EQ(outcome(hand_made_delta(nodes, 0, 16, {})), Applied::refused);
  EXPECT_EQ(outcome(hand_made_delta(nodes, 0, 16, {0, 0})), Applied::refused);
  EXPECT_EQ(outcome(hand_made_delta(nodes, 0, 17, {0})), Applied::refused);
  EXPECT_EQ(outcome(hand_made_delta(nodes, 0, 16, {1})), Applied::refused);       // its word is missing
  EXPECT_EQ(outcome(hand_made_delta(nodes, 0, 16, {0x8000})), Applied::refused);  // not a width
  EXPECT_EQ(outcome(hand_made_delta(nodes, 0, 16, std::vector<uint16_t>(18, 17))), Applied::refused);
  EXPECT_EQ(outcome(hand_made_delta(nodes, 0, 0, {})), Applied::refused);
  EXPECT_EQ(outcome(hand_made_delta(nodes, nodes - 15, 16, {0})), Applied::refused);  // beyond the last node
  EXPECT_EQ(outcome(hand_made_delta(nodes, UINT32_MAX, 16, {0})), Applied::refused);
  EXPECT_EQ(outcome(hand_made_delta(nodes, 0, UINT32_MAX, {0})), Applied::refused);
  EXPECT_EQ(outcome(hand_made_delta(0, 0, 16, {0})), Applied::refused);
  EXPECT_EQ(outcome(hand_made_delta(UINT32_MAX, 0, 16, {0})), Applied::refused);
  EXPECT_EQ(outcome(hand_made_delta(nodes + 1, 0, 16, {0})), Applied::refused);  // another car
}

TEST(Client, ASessionWithoutAServerSaysWhatToDo) {
  const CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 50, "tcp/127.0.0.1:1", "main", nullptr, nullptr};
  Crumple* session = nullptr;
  EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_CLOSED);
  EXPECT_EQ(session, nullptr);
  EXPECT_NE(std::strstr(crumple_error(), "crumple serve"), nullptr) << crumple_error();
}

TEST(Client, RefusesAHeaderOfAnotherVersionAndBadIds) {
  Crumple* session = nullptr;
  CrumpleOptions options{CRUMPLE_CLIENT_VERSION + 1, 50, "tcp/127.0.0.1:1", "main", nullptr, nullptr};
  EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_BAD_ARGUMENT);
  options.version = CRUMPLE_CLIENT_VERSION;
  options.scene = "ma/in";
  EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_BAD_ARGUMENT);
  options.scene = "main";
  options.host = "*";
  EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_BAD_ARGUMENT);
}

// The test's own server on the real network, and a viewer of its car "a". The server can hold back messages as if a link lost
// them.
struct OwnServer {
  std::unique_ptr<Net, decltype(&net_close)> net{nullptr, net_close};
  std::unique_ptr<Crumple, decltype(&crumple_close)> viewer{nullptr, crumple_close};
  uint64_t tick = 5, far_tick = 3, questions = 0, refuses = 0;
  const Quanta quanta = Quanta(3 * nodes, 1);

  void start(bool announced = true) {
    Net* opened = nullptr;
    ASSERT_EQ(net_open("peer", "tcp/127.0.0.1:0", nullptr, nullptr, 0, &opened), TRANSPORT_OK) << transport_error();
    net.reset(opened);
    ASSERT_EQ(net_queryable(opened, "crumple/1/main/car/a/key/*", 16, NET_LONGEST), TRANSPORT_OK);
    ASSERT_EQ(net_announce(opened, "crumple/1/main/server"), TRANSPORT_OK);
    if (announced) {
      ASSERT_EQ(net_announce(opened, "crumple/1/main/car/a"), TRANSPORT_OK);
    }
    const CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 5000, net_endpoint(opened), "main", nullptr, nullptr};
    Crumple* handle = nullptr;
    ASSERT_EQ(crumple_open(&options, &handle), CRUMPLE_OK) << crumple_error();
    viewer.reset(handle);
    ASSERT_EQ(crumple_follow(handle, "a", 0), CRUMPLE_OK);
  }
  void put(const char* key, const Bytes& bytes) { net_put(net.get(), key, bytes.data(), bytes.size(), NET_DATA); }
  void put_health() {
    HealthReport report;
    report.told.push_back({"a", {tick, far_tick}});
    put("crumple/1/main/health", encode_health(report));
  }
  void answer() {
    NetEvent events[16];
    const int count = net_poll(net.get(), events, 16, 5'000);
    for (int e = 0; e < count; ++e) {
      if (events[e].kind != NET_QUERY) continue;
      const bool is_far = std::string_view(events[e].key).ends_with("/1");
      const Bytes bytes = is_far ? keyframe(far_tick, quanta, nodes, 0.004f).front() : keyframe(tick, quanta).front();
      net_reply(net.get(), events[e].ticket, bytes.data(), bytes.size(), ++questions <= refuses);
    }
  }
  // The tick of the viewer's surface; 0: none.
  uint64_t held() {
    crumple_poll(viewer.get(), 5'000);
    CrumpleSurface surface{};
    return crumple_surface(viewer.get(), "a", &surface) == CRUMPLE_OK ? surface.tick : 0;
  }
  float quantum() const {
    CrumpleSurface surface{};
    return crumple_surface(viewer.get(), "a", &surface) == CRUMPLE_OK ? surface.quantum : 0;
  }
  uint64_t surfaces() const {
    CrumpleStatistics statistics;
    crumple_statistics(viewer.get(), &statistics);
    return statistics.surface;
  }
  // Waits until the viewer subscribes to the key, or no longer subscribes.
  bool heard(const char* key, bool wanted) {
    for (int k = 0; k < 3000 && (net_matching(net.get(), key) == 1) != wanted; ++k) held();
    return (net_matching(net.get(), key) == 1) == wanted;
  }
  bool comes_to_hold(uint64_t wanted, bool healths) {
    for (int k = 0; k < 500; ++k) {
      if (healths && k % 20 == 0) put_health();
      answer();
      if (held() == wanted) return true;
    }
    return false;
  }
};

TEST(Client, AsksForWhatHealthSaysThatItLost) {
  OwnServer server;
  ASSERT_NO_FATAL_FAILURE(server.start());
  ASSERT_TRUE(server.comes_to_hold(5, false)) << "the first keyframe";
  const uint64_t asked = server.questions;
  server.tick = 9;  // and nobody was sent it
  EXPECT_TRUE(server.comes_to_hold(9, true)) << "asked " << server.questions - asked << " times more";
}

// A token and the messages of its car travel separately, so either may come first.
TEST(Client, ACarIsAliveFromItsFirstKeyframeUntilItsTokenGoes) {
  const char *token = "crumple/1/main/car/a", *key = "crumple/1/main/car/a/key/0";
  OwnServer server;
  ASSERT_NO_FATAL_FAILURE(server.start(false));
  ASSERT_TRUE(server.heard(key, true));
  server.put(key, keyframe(5, server.quanta).front());
  CrumpleSurface surface{};
  for (int k = 0; k < 1000 && server.held() == 0; ++k) {
  }
  ASSERT_EQ(crumple_surface(server.viewer.get(), "a", &surface), CRUMPLE_OK);
  EXPECT_TRUE(surface.alive);
  for (const bool alive : {true, false, true}) {
    ASSERT_EQ((alive ? net_announce : net_retract)(server.net.get(), token), TRANSPORT_OK);
    const uint64_t asked = server.questions;
    for (int k = 0; k < 1000 && (alive ? server.questions == asked : surface.alive); ++k) {
      server.answer();
      ASSERT_EQ(server.held(), 5u);
      ASSERT_EQ(crumple_surface(server.viewer.get(), "a", &surface), CRUMPLE_OK);
    }
    EXPECT_EQ(surface.alive, alive);
  }
}

TEST(Client, AsksAgainWhereItsFirstQuestionIsRefused) {
  OwnServer server;
  server.refuses = 2;
  ASSERT_NO_FATAL_FAILURE(server.start());
  EXPECT_TRUE(server.comes_to_hold(5, false)) << server.questions;
}

TEST(Client, WhoGoesFarHoldsWhatItHadUntilTheFirstKeyframeOfThatLevelHoweverOld) {
  const char *near_delta = "crumple/1/main/car/a/delta/0", *far_delta = "crumple/1/main/car/a/delta/1";
  OwnServer server;
  ASSERT_NO_FATAL_FAILURE(server.start());
  ASSERT_TRUE(server.comes_to_hold(5, false)) << "the first keyframe";
  EXPECT_EQ(crumple_follow(server.viewer.get(), "a", 2), CRUMPLE_BAD_ARGUMENT);
  ASSERT_EQ(crumple_follow(server.viewer.get(), "a", 1), CRUMPLE_OK);
  ASSERT_TRUE(server.heard(far_delta, true));
  ASSERT_TRUE(server.heard(near_delta, false)) << "what is not wanted is not sent";
  // A delta that would fit the held keyframe if both were of one level.
  const uint64_t before = server.surfaces();
  server.put(far_delta, delta(7, server.quanta, 5, server.quanta).front());
  for (int k = 0; k < 1000 && server.surfaces() == before; ++k) ASSERT_EQ(server.held(), 5u);
  ASSERT_EQ(server.surfaces(), before + 1);
  EXPECT_EQ(server.held(), 5u);
  EXPECT_EQ(server.quantum(), 0.0005f);
  ASSERT_TRUE(server.comes_to_hold(3, false)) << "asked " << server.questions << " times";
  EXPECT_EQ(server.quantum(), 0.004f);
  server.put(far_delta, delta(9, server.quanta, 3, server.quanta).front());
  const uint64_t asked = server.questions;
  EXPECT_TRUE(server.comes_to_hold(9, false));
  for (int k = 0; k < 1000 && server.questions == asked; ++k) server.answer(), server.held();
  ASSERT_EQ(server.questions, asked + 1) << "once more, since all is silent";
  server.far_tick = 15;  // and nobody was sent it
  EXPECT_TRUE(server.comes_to_hold(15, true)) << "health tells of each level";
  server.tick = 14;
  ASSERT_EQ(crumple_follow(server.viewer.get(), "a", 0), CRUMPLE_OK);
  ASSERT_TRUE(server.comes_to_hold(14, false));
  EXPECT_EQ(server.quantum(), 0.0005f);
}

TEST(Client, WhoGoesFarDoesNotTakeTheAnswerToWhatItAskedNear) {
  OwnServer server;
  ASSERT_NO_FATAL_FAILURE(server.start());
  CrumpleStatistics statistics{};
  for (int k = 0; k < 1000 && statistics.asked == 0; ++k) {
    server.held();
    crumple_statistics(server.viewer.get(), &statistics);
  }
  ASSERT_EQ(statistics.asked, 1u);
  ASSERT_EQ(crumple_follow(server.viewer.get(), "a", 1), CRUMPLE_OK);
  for (int k = 0; k < 1000 && server.held() == 0; ++k) server.answer();
  EXPECT_EQ(server.held(), 3u);
  EXPECT_EQ(server.quantum(), 0.004f);
}

TEST(Client, GetsNothingTwiceWhoFollowsAllCarsFarAndOneOfThemNear) {
  const char *near_delta = "crumple/1/main/car/a/delta/0", *far_delta = "crumple/1/main/car/a/delta/1";
  OwnServer server;
  ASSERT_NO_FATAL_FAILURE(server.start());
  const auto follow = [&](const char* car, int level) {
    ASSERT_EQ(crumple_follow(server.viewer.get(), car, level), CRUMPLE_OK);
  };
  ASSERT_TRUE(server.comes_to_hold(5, false)) << "the first keyframe";
  follow(nullptr, 1);
  ASSERT_TRUE(server.comes_to_hold(3, false));
  follow("a", 0);
  ASSERT_TRUE(server.comes_to_hold(5, false));
  ASSERT_TRUE(server.heard(far_delta, true));
  uint64_t before = server.surfaces();
  server.put(far_delta, delta(7, server.quanta, 3, server.quanta).front());
  server.put(near_delta, delta(8, server.quanta, 5, server.quanta).front());
  ASSERT_TRUE(server.comes_to_hold(8, false));
  EXPECT_EQ(server.surfaces(), before + 1) << "of the far level nothing is taken in";
  follow("a", 1);
  ASSERT_TRUE(server.comes_to_hold(3, false));
  ASSERT_TRUE(server.heard(near_delta, false));
  before = server.surfaces();
  server.put(far_delta, delta(9, server.quanta, 3, server.quanta).front());
  server.put(far_delta, delta(10, server.quanta, 3, server.quanta).front());
  ASSERT_TRUE(server.comes_to_hold(10, false));
  EXPECT_EQ(server.surfaces(), before + 2);
}

TEST(Client, ShowsNothingOldAsCurrentAfterAPause) {
  OwnServer server;
  ASSERT_NO_FATAL_FAILURE(server.start());
  ASSERT_TRUE(server.comes_to_hold(5, false)) << "the first keyframe";
  // The car crashes while the viewer sleeps. When it wakes up it first gets the oldest message; its query for the newest has no
  // answer yet.
  server.tick = 6;
  server.put("crumple/1/main/car/a/key/0", keyframe(6, server.quanta).front());
  std::this_thread::sleep_for(std::chrono::milliseconds(700));
  server.tick = 60;
  for (int k = 0; k < 20; ++k) ASSERT_EQ(server.held(), 0u);
  EXPECT_TRUE(server.comes_to_hold(60, false));
}

// A session without a network that follows a box car. Its surface comes from crumple_feed.
struct Fed {
  std::vector<std::byte> bytes = box_car_bytes({6, 3, 2});
  std::shared_ptr<const Car> car = read_car(bytes, "box");
  std::unique_ptr<Crumple, decltype(&crumple_close)> session{nullptr, crumple_close};
  CrumpleMesh mesh{};
  uint64_t tick = 0;

  void start() {
    const CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 0, nullptr, "main", "game", nullptr};
    Crumple* handle = nullptr;
    ASSERT_EQ(crumple_open(&options, &handle), CRUMPLE_OK) << crumple_error();
    session.reset(handle);
    ASSERT_EQ(crumple_follow(handle, nullptr, 0), CRUMPLE_OK) << crumple_error();
    char hash[17];
    ASSERT_EQ(crumple_add_asset(handle, bytes.data(), bytes.size(), hash), CRUMPLE_OK) << crumple_error();
    ASSERT_EQ(hash, car->hash);
    ASSERT_EQ(crumple_mesh(handle, hash, &mesh), CRUMPLE_OK) << crumple_error();
  }
  int feed(const Bytes& message, const char* key = "crumple/1/main/car/a/key/0") {
    return crumple_feed(session.get(), key, message.data(), message.size());
  }
  int feed(const Quanta& quanta, float quantum = 0.0005f) {
    return feed(encode_keyframe({++tick, car->hash, quantum}, quanta).front());
  }
  // moved(rest position): in quanta.
  template <class Moved>
  Quanta quanta_of(Moved moved) const {
    Quanta quanta;
    for (const uint32_t node : car->skin_node)
      for (const int q : moved(car->model.node[node])) quanta.push_back(static_cast<int16_t>(q));
    return quanta;
  }
  struct Copied {
    std::vector<float> position, displacement, normal;
    uint32_t first = 0, count = 0;
  };
  Copied copy(double time = 0) {
    const size_t size = 3 * size_t{mesh.vertex_count};
    Copied out{std::vector<float>(size), std::vector<float>(size), std::vector<float>(size)};
    CrumpleVertices to{
        out.position.data(), out.displacement.data(), out.normal.data(), 12, mesh.vertex_count, time, 7, 7, 0, nullptr};
    EXPECT_EQ(crumple_copy(session.get(), "a", &to), CRUMPLE_OK) << crumple_error();
    out.first = to.first, out.count = to.count;
    return out;
  }
};

TEST(Client, WithoutANetworkHoldsWhatItIsFed) {
  Fed fed;
  ASSERT_NO_FATAL_FAILURE(fed.start());
  Crumple* session = fed.session.get();
  std::mt19937 random(11);
  const size_t count = fed.car->skin_node.size();
  const Quanta key = random_quanta(random, count), now = random_quanta(random, count);
  CrumpleSurface surface{};
  EXPECT_EQ(crumple_surface(session, "a", &surface), CRUMPLE_UNKNOWN);
  EXPECT_EQ(fed.feed(key), CRUMPLE_OK);
  const auto delta_bytes = encode_delta({2, fed.car->hash, 0.0005f}, now, 1, key).front();
  const char* delta_key = "crumple/1/main/car/a/delta/0";
  const Bytes cut(delta_bytes.begin(), delta_bytes.begin() + 9);
  EXPECT_EQ(fed.feed(cut, delta_key), CRUMPLE_BAD_ARGUMENT);
  EXPECT_NE(std::strstr(crumple_error(), "well-formed"), nullptr) << crumple_error();
  ASSERT_EQ(crumple_surface(session, "a", &surface), CRUMPLE_OK);
  EXPECT_EQ(surface.hash, surface_hash(key));
  EXPECT_EQ(fed.feed(delta_bytes, "crumple/1/main/car/a/delta/1"), CRUMPLE_OK);  // of a level that it does not follow
  EXPECT_EQ(fed.feed(delta_bytes, "crumple/1/other/car/a/delta/0"), CRUMPLE_OK);
  ASSERT_EQ(crumple_surface(session, "a", &surface), CRUMPLE_OK);
  EXPECT_EQ(surface.tick, 1u);
  EXPECT_EQ(fed.feed(delta_bytes, delta_key), CRUMPLE_OK);
  ASSERT_EQ(crumple_surface(session, "a", &surface), CRUMPLE_OK);
  EXPECT_EQ(surface.hash, surface_hash(now));
  EXPECT_TRUE(surface.alive);

  CarReaction reaction;
  reaction.car = "a";
  EXPECT_EQ(fed.feed(encode_reactions(4, 0.1, {reaction}), "crumple/1/main/host/h/reactions"), CRUMPLE_OK);
  CrumpleReaction taken{};
  ASSERT_EQ(crumple_take_reactions(session, &taken, 1), 1u);
  EXPECT_EQ(taken.tick, 4u);
  EXPECT_EQ(taken.partner_count, 0u);

  reaction.partners = {{"b", "i", {1, 2, 3}, 4}, {"c", "h", {-1, 0, 0}, 0}};
  const std::string reactions_key = "crumple/1/main/host/h/reactions";
  EXPECT_EQ(fed.feed(encode_reactions(5, 0.1, {reaction, reaction}), reactions_key.c_str()), CRUMPLE_OK);
  CrumpleReaction both[2] = {};
  ASSERT_EQ(crumple_take_reactions(session, both, 2), 2u);
  for (const CrumpleReaction& each : both) {
    ASSERT_EQ(each.partner_count, 2u);
    EXPECT_STREQ(each.partners[0].car, "b");
    EXPECT_STREQ(each.partners[0].host, "i");
    EXPECT_EQ(each.partners[0].impulse[2], 3);
    EXPECT_EQ(each.partners[0].contacts, 4u);
    EXPECT_STREQ(each.partners[1].car, "c");
  }
  reaction.partners[1].host = "no/id";
  EXPECT_EQ(fed.feed(encode_reactions(6, 0.1, {reaction}), reactions_key.c_str()), CRUMPLE_BAD_ARGUMENT);
  reaction.partners.assign(1000, {"b", "i", {1, 2, 3}, 4});
  EXPECT_EQ(fed.feed(encode_reactions(7, 0.1, {reaction}), reactions_key.c_str()), CRUMPLE_BAD_ARGUMENT);
  EXPECT_EQ(crumple_take_reactions(session, both, 2), 0u);

  // Functions that need a network return an error.
  uint64_t ticket = 0;
  EXPECT_EQ(crumple_poll(session, 0), CRUMPLE_CLOSED);
  EXPECT_EQ(crumple_despawn(session, "a", &ticket), CRUMPLE_CLOSED);
  EXPECT_EQ(crumple_publish_poses(session, 0, nullptr, 0), CRUMPLE_CLOSED);
  EXPECT_NE(std::strstr(crumple_error(), "options.connect"), nullptr) << crumple_error();
  CrumpleMesh mesh{};
  EXPECT_EQ(crumple_mesh(session, "0123456789abcdef", &mesh), CRUMPLE_UNKNOWN);
  char name[17];
  EXPECT_EQ(crumple_add_asset(session, fed.bytes.data(), 100, name), CRUMPLE_BAD_ARGUMENT);
  OwnServer server;
  ASSERT_NO_FATAL_FAILURE(server.start());
  EXPECT_EQ(crumple_feed(server.viewer.get(), delta_key, delta_bytes.data(), delta_bytes.size()), CRUMPLE_BAD_ARGUMENT);
}

TEST(Client, CopiesPositionsAndTheNormalsOfTheDentedSurface) {
  Fed fed;
  ASSERT_NO_FATAL_FAILURE(fed.start());
  // Sheared by 1 m forward for each m above the ground, so that a normal that pointed forward points forward and down.
  ASSERT_EQ(fed.feed(fed.quanta_of([](const Vec3& rest) {
    return std::array{int(std::lround(2000 * rest.z())), 0, 0};
  })),
            CRUMPLE_OK);
  const auto copied = fed.copy();
  std::vector<Eigen::Vector3d> twin(fed.mesh.vertex_count, Eigen::Vector3d::Zero());
  const auto position = [&](uint32_t vertex) -> Eigen::Vector3d {
    const float* at = &copied.position[size_t{3} * vertex];
    return {at[0], at[1], at[2]};
  };
  for (uint32_t t = 0; t < fed.mesh.triangle_count; ++t) {
    const uint32_t* corner = fed.mesh.triangle + 3 * t;
    const Eigen::Vector3d a = position(corner[0]), area = (position(corner[1]) - a).cross(position(corner[2]) - a);
    for (int k = 0; k < 3; ++k) twin[corner[k]] += area;
  }
  size_t forward = 0;
  for (uint32_t v = 0; v < fed.mesh.vertex_count; ++v) {
    const Eigen::Vector3f rest(fed.mesh.vertex + 3 * v), normal(&copied.normal[size_t{3} * v]);
    EXPECT_NEAR(copied.displacement[3 * v], rest.z(), 0.0003f);
    EXPECT_NEAR(copied.position[3 * v], rest.x() + rest.z(), 0.0003f);
    EXPECT_EQ(copied.position[3 * v + 1], rest.y());
    EXPECT_LT((normal.cast<double>() - twin[v].normalized()).norm(), 1e-5) << "vertex " << v;
    if (rest.x() < 2.24f || std::abs(rest.y()) > 0.89f || rest.z() < 0.01f || rest.z() > 1.49f) continue;
    ++forward;
    EXPECT_LT((normal - Eigen::Vector3f(1, 0, -1).normalized()).norm(), 1e-3f);
  }
  EXPECT_GT(forward, 0u) << "inside of the front";

  // Some members of a vertex of 8 floats.
  std::vector<float> strided(8 * size_t{fed.mesh.vertex_count}, -7.0f);
  CrumpleVertices some{strided.data(), nullptr, strided.data() + 3, 32, 5, 0, 0, 0, 0, nullptr};
  ASSERT_EQ(crumple_copy(fed.session.get(), "a", &some), CRUMPLE_OK);
  EXPECT_TRUE(std::equal(&strided[8 * 4], &strided[8 * 4 + 3], &copied.position[3 * 4]));
  EXPECT_TRUE(std::equal(&strided[8 * 4 + 3], &strided[8 * 4 + 6], &copied.normal[3 * 4]));
  EXPECT_EQ(strided[6], -7) << "what lies between is the caller's";
  EXPECT_EQ(strided[8 * 5], -7) << "beyond capacity";
  some.stride = 10;
  EXPECT_EQ(crumple_copy(fed.session.get(), "a", &some), CRUMPLE_BAD_ARGUMENT);
}

// A mesh as an engine has it: centimetres, left-handed, each triangle with vertices of its own, in an order of its own.
struct EngineMesh {
  struct Vertex {
    float position[3], normal[3], tangent[3], uv[2];
  };
  static constexpr double to_car[12] = {0, 0.01, 0, 0.5, 0.01, 0, 0, 0.25, 0, 0, 0.01, -1};
  std::vector<Vertex> vertex;
  std::vector<uint32_t> baked;  // the vertex of the baked car in the same place

  using Matrix = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;
  static Eigen::Vector3d from_car(const Eigen::Vector3d& p) {
    const Eigen::Map<const Matrix> m(to_car);
    return m.leftCols<3>().inverse() * (p - m.col(3));
  }
  static Eigen::Vector3d turned(const Eigen::Vector3d& normal) {
    return (Eigen::Map<const Matrix>(to_car).leftCols<3>().transpose() * normal).normalized();
  }
  static Eigen::Vector3d of(const float* p) { return {p[0], p[1], p[2]}; }

  explicit EngineMesh(const CrumpleMesh& mesh) {
    for (uint32_t t = 0; t < mesh.triangle_count; ++t) {
      const uint32_t* corner = mesh.triangle + 3 * ((t * 7919) % mesh.triangle_count);
      const Eigen::Vector3d a = of(mesh.vertex + 3 * corner[0]), b = of(mesh.vertex + 3 * corner[1]),
                            c = of(mesh.vertex + 3 * corner[2]);
      for (int k = 0; k < 3; ++k) {
        Vertex& out = vertex.emplace_back();
        baked.push_back(corner[k]);
        Eigen::Map<Eigen::Vector3f>(out.position) = from_car(of(mesh.vertex + 3 * corner[k])).cast<float>();
        Eigen::Map<Eigen::Vector3f>(out.normal) = turned((b - a).cross(c - a)).cast<float>();
        Eigen::Map<Eigen::Vector3f>(out.tangent) = (from_car(b) - from_car(a)).normalized().cast<float>();
        out.uv[0] = out.uv[1] = 7;
      }
    }
  }
  CrumpleOwnMesh own() const {
    return {vertex[0].position, vertex[0].normal, vertex[0].tangent, sizeof(Vertex), vertex.size(), to_car, 0, 0};
  }
  CrumpleVertices into(uint32_t mapping) {
    return {vertex[0].position, nullptr, vertex[0].normal, sizeof(Vertex), vertex.size(), 0, 7, 7, mapping, vertex[0].tangent};
  }
};

TEST(Client, MovesTheVerticesOfAGamesOwnMesh) {
  Fed fed;
  ASSERT_NO_FATAL_FAILURE(fed.start());
  Crumple* session = fed.session.get();
  EngineMesh engine(fed.mesh);
  const std::vector<EngineMesh::Vertex> rest = engine.vertex;
  CrumpleOwnMesh own = engine.own();
  uint32_t mapping = 0;
  ASSERT_EQ(crumple_map(session, fed.car->hash.c_str(), &own, &mapping), CRUMPLE_OK) << crumple_error();
  EXPECT_EQ(own.on_vertices, engine.vertex.size());
  EXPECT_LT(own.farthest, 1e-5f);

  // At rest the mesh keeps its numbers.
  ASSERT_EQ(fed.feed(fed.quanta_of([](const Vec3&) { return std::array{0, 0, 0}; })), CRUMPLE_OK);
  CrumpleVertices into = engine.into(mapping);
  ASSERT_EQ(crumple_copy(session, "a", &into), CRUMPLE_OK) << crumple_error();
  EXPECT_EQ(into.count, engine.vertex.size());
  for (size_t i = 0; i < rest.size(); ++i) {
    EXPECT_TRUE(std::equal(rest[i].position, rest[i].position + 3, engine.vertex[i].position));
    EXPECT_LT((EngineMesh::of(rest[i].normal) - EngineMesh::of(engine.vertex[i].normal)).norm(), 1e-6);
    EXPECT_LT((EngineMesh::of(rest[i].tangent) - EngineMesh::of(engine.vertex[i].tangent)).norm(), 1e-6);
  }

  // Sheared: each vertex is where the baked vertex is, and each normal is that of its flat triangle.
  ASSERT_EQ(fed.feed(fed.quanta_of([](const Vec3& at) {
    return std::array{int(std::lround(600 * at.z())), 0, 0};
  })),
            CRUMPLE_OK);
  const auto copied = fed.copy();
  into = engine.into(mapping);
  ASSERT_EQ(crumple_copy(session, "a", &into), CRUMPLE_OK) << crumple_error();
  for (size_t i = 0; i < rest.size(); i += 3) {
    Eigen::Vector3d corner[3];
    for (size_t k = 0; k < 3; ++k) {
      corner[k] = EngineMesh::of(&copied.position[size_t{3} * engine.baked[i + k]]);
      EXPECT_LT((EngineMesh::of(engine.vertex[i + k].position) - EngineMesh::from_car(corner[k])).norm(), 1e-3) << "cm";
      EXPECT_EQ(engine.vertex[i + k].uv[0], 7) << "what lies between is the caller's";
    }
    const Eigen::Vector3d normal = EngineMesh::turned((corner[1] - corner[0]).cross(corner[2] - corner[0]));
    for (size_t k = 0; k < 3; ++k) {
      const Eigen::Vector3d now = EngineMesh::of(engine.vertex[i + k].normal);
      EXPECT_LT((now - normal).norm(), 2e-3) << "vertex " << i + k;
      EXPECT_NEAR(EngineMesh::of(engine.vertex[i + k].tangent).norm(), 1, 1e-5);
      EXPECT_NEAR(EngineMesh::of(engine.vertex[i + k].tangent).dot(now), 0, 1e-4) << "they turn together";
    }
  }

  // Two meshes of one car: each copy says what changed since the last copy of that mesh.
  into = engine.into(mapping);
  ASSERT_EQ(crumple_copy(session, "a", &into), CRUMPLE_OK);
  EXPECT_EQ(into.count, 0u);
  uint32_t other = 0;
  ASSERT_EQ(crumple_map(session, fed.car->hash.c_str(), &own, &other), CRUMPLE_OK);
  into = engine.into(other);
  ASSERT_EQ(crumple_copy(session, "a", &into), CRUMPLE_OK);
  EXPECT_EQ(into.count, engine.vertex.size());
}

// A car with wheels.
Fed with_wheels() {
  Fed fed;
  fed.car = wheeled_box_car({6, 3, 2}).car;
  fed.bytes.assign(fed.car->bytes.begin(), fed.car->bytes.end());
  return fed;
}

TEST(Client, SaysWhatPartsACarHasAndWhereTheyAre) {
  Fed fed = with_wheels();
  ASSERT_NO_FATAL_FAILURE(fed.start());
  Crumple* session = fed.session.get();
  CrumpleParts parts{};
  ASSERT_EQ(crumple_parts(session, fed.car->hash.c_str(), &parts), CRUMPLE_OK) << crumple_error();
  ASSERT_EQ(parts.count, 7u);
  EXPECT_STREQ(parts.part[0].name, "body");
  EXPECT_EQ(parts.part[1].kind, CRUMPLE_GLASS);
  EXPECT_EQ(parts.part[2].kind, CRUMPLE_WHEEL);
  EXPECT_EQ(parts.part[2].radius, wheel_radius);
  EXPECT_EQ(parts.part[6].kind, CRUMPLE_POINT);
  EXPECT_EQ(std::count(parts.vertex_part, parts.vertex_part + fed.mesh.vertex_count, 2), 50);
  CrumplePose pose{};
  EXPECT_EQ(crumple_part_pose(session, "a", 2, 0, &pose), CRUMPLE_UNKNOWN);
  ASSERT_EQ(fed.feed(fed.quanta_of([](const Vec3&) { return std::array{0, 0, 0}; })), CRUMPLE_OK);
  for (uint32_t k = 0; k < parts.count; ++k) {
    ASSERT_EQ(crumple_part_pose(session, "a", k, 0, &pose), CRUMPLE_OK) << crumple_error();
    for (int axis = 0; axis < 3; ++axis) EXPECT_EQ(pose.position[axis], double(parts.part[k].position[axis]));
    EXPECT_EQ(pose.orientation[3], 1);
  }
  EXPECT_EQ(crumple_part_pose(session, "a", 7, 0, &pose), CRUMPLE_BAD_ARGUMENT);
  EXPECT_NE(std::strstr(crumple_error(), "7 parts"), nullptr) << crumple_error();

  // The whole turns by 0.1 about z, within quanta of 0.5 mm.
  ASSERT_EQ(fed.feed(fed.quanta_of([](const Vec3& at) {
    const float c = std::cos(0.1f) - 1, s = std::sin(0.1f);
    return std::array{int(std::lround(2000 * (c * at.x() - s * at.y()))), int(std::lround(2000 * (s * at.x() + c * at.y()))),
                      40};
  })),
            CRUMPLE_OK);
  for (uint32_t k = 0; k < parts.count; ++k) {
    ASSERT_EQ(crumple_part_pose(session, "a", k, 0, &pose), CRUMPLE_OK) << crumple_error();
    const float* at = parts.part[k].position;
    EXPECT_NEAR(pose.position[0], std::cos(0.1) * double(at[0]) - std::sin(0.1) * double(at[1]), 0.001);
    EXPECT_NEAR(pose.position[1], std::sin(0.1) * double(at[0]) + std::cos(0.1) * double(at[1]), 0.001);
    EXPECT_NEAR(pose.position[2], double(at[2]) + 0.02, 0.001);
    EXPECT_NEAR(pose.orientation[2], std::sin(0.05f), 0.001f);
  }
  Fed plain;
  ASSERT_NO_FATAL_FAILURE(plain.start());
  ASSERT_EQ(crumple_parts(plain.session.get(), plain.car->hash.c_str(), &parts), CRUMPLE_OK);
  EXPECT_EQ(parts.count, 0u);
  EXPECT_EQ(parts.vertex_part, nullptr);
}

TEST(Client, AWheelStaysADiscInItsOwnMeshAndInTheGames) {
  Fed fed = with_wheels();
  ASSERT_NO_FATAL_FAILURE(fed.start());
  Crumple* session = fed.session.get();
  CrumpleParts parts{};
  ASSERT_EQ(crumple_parts(session, fed.car->hash.c_str(), &parts), CRUMPLE_OK) << crumple_error();
  EngineMesh engine(fed.mesh);
  CrumpleOwnMesh own = engine.own();
  uint32_t mapping = 0;
  ASSERT_EQ(crumple_map(session, fed.car->hash.c_str(), &own, &mapping), CRUMPLE_OK) << crumple_error();
  CrumpleVertices into = engine.into(mapping);
  ASSERT_EQ(fed.feed(fed.quanta_of([](const Vec3&) { return std::array{0, 0, 0}; })), CRUMPLE_OK);
  ASSERT_EQ(crumple_copy(session, "a", &into), CRUMPLE_OK) << crumple_error();
  const std::vector<EngineMesh::Vertex> rest = engine.vertex;
  fed.copy();

  std::mt19937 random(31);
  std::uniform_int_distribution<int> by(-300, 300);  // quanta of 0.5 mm
  ASSERT_EQ(fed.feed(fed.quanta_of([&](const Vec3& at) {
    return std::array{int(std::lround(-400 * std::max(0.0f, at.x()))) + by(random), by(random), by(random)};
  })),
            CRUMPLE_OK);
  const auto copied = fed.copy();
  EXPECT_GT(copied.count, 0u);
  const auto is_wheel = [&](uint32_t v) { return parts.part[parts.vertex_part[v]].kind == CRUMPLE_WHEEL; };
  const auto now = [&](uint32_t v) { return EngineMesh::of(&copied.position[size_t{3} * v]); };
  size_t pairs = 0;
  for (uint32_t t = 0; t < fed.mesh.triangle_count; ++t) {
    const uint32_t *corner = fed.mesh.triangle + 3 * t, a = corner[0], b = corner[1];
    if (!is_wheel(a)) continue;
    ++pairs;
    const double before = (EngineMesh::of(fed.mesh.vertex + 3 * a) - EngineMesh::of(fed.mesh.vertex + 3 * b)).norm();
    EXPECT_NEAR((now(a) - now(b)).norm(), before, 1e-5);
  }
  EXPECT_EQ(pairs, 4 * 96u);
  for (uint32_t v = 0; v < fed.mesh.vertex_count; ++v) {
    if (!is_wheel(v)) continue;
    CrumplePose pose{};
    ASSERT_EQ(crumple_part_pose(session, "a", parts.vertex_part[v], 0, &pose), CRUMPLE_OK);
    const Eigen::Quaterniond turn(Eigen::Map<const Eigen::Vector4f>(pose.orientation).cast<double>());
    const Eigen::Vector3d hub = EngineMesh::of(parts.part[parts.vertex_part[v]].position);
    const Eigen::Vector3d wanted =
        turn * (EngineMesh::of(fed.mesh.vertex + 3 * v) - hub) + Eigen::Map<const Eigen::Vector3d>(pose.position);
    EXPECT_LT((now(v) - wanted).norm(), 1e-5);
  }

  ASSERT_EQ(crumple_copy(session, "a", &into), CRUMPLE_OK) << crumple_error();
  for (size_t i = 0; i < rest.size(); ++i) {
    if (!is_wheel(engine.baked[i])) continue;
    const auto& vertex = engine.vertex[i];
    EXPECT_LT((EngineMesh::of(vertex.position) - EngineMesh::from_car(now(engine.baked[i]))).norm(), 2e-3) << "cm";
    // Normal and tangent turn as the wheel does.
    CrumplePose pose{};
    ASSERT_EQ(crumple_part_pose(session, "a", parts.vertex_part[engine.baked[i]], 0, &pose), CRUMPLE_OK);
    const Eigen::Quaterniond turn(Eigen::Map<const Eigen::Vector4f>(pose.orientation).cast<double>());
    const Eigen::Map<const EngineMesh::Matrix> m(EngineMesh::to_car);
    const Eigen::Vector3d before = (m.leftCols<3>() * EngineMesh::of(rest[i].tangent)).normalized(),
                          after = (m.leftCols<3>() * EngineMesh::of(vertex.tangent)).normalized();
    EXPECT_LT((turn * before - after).norm(), 1e-4);
  }
}

TEST(Client, RefusesACarWhosePartsAreWrong) {
  Fed fed = with_wheels();
  ASSERT_NO_FATAL_FAILURE(fed.start());
  const auto refused = [&](auto change, const char* fact) {
    schema::CarT car;
    schema::GetCar(fed.bytes.data())->UnPackTo(&car);
    change(car);
    flatbuffers::FlatBufferBuilder builder;
    schema::FinishCarBuffer(builder, schema::Car::Pack(builder, &car));
    char hash[17];
    EXPECT_EQ(crumple_add_asset(fed.session.get(), builder.GetBufferPointer(), builder.GetSize(), hash), CRUMPLE_BAD_ARGUMENT)
        << fact;
    EXPECT_NE(std::strstr(crumple_error(), fact), nullptr) << crumple_error();
    const auto bytes = std::as_bytes(std::span(builder.GetBufferPointer(), builder.GetSize()));
    EXPECT_NE(refusal([&] { (void)read_car(bytes, "wrong.car"); }).find(fact), std::string::npos) << fact;
  };
  constexpr float nan = std::numeric_limits<float>::quiet_NaN();
  refused([](auto& car) { car.vertex_part.pop_back(); }, "matching lengths");
  refused([](auto& car) { car.part.clear(); }, "matching lengths");
  refused([](auto& car) { car.vertex_part[0] = 7; }, "has no vertices");
  refused([](auto& car) { car.vertex_part[0] = 6; }, "has no vertices");  // a point
  refused([](auto& car) { car.vertex_part[0] = car.vertex_part[0] == 5 ? 4 : 5; }, "two parts");
  refused([](auto& car) { car.part[0]->kind = schema::PartKind::glass; }, "not the body");
  refused([](auto& car) { car.part[1]->kind = static_cast<schema::PartKind>(9); }, "no kind");
  refused([](auto& car) { car.part[1]->name = "body"; }, "one name");
  refused([](auto& car) { car.part[1]->name = ""; }, "printable");
  refused([](auto& car) { car.part[1]->name = std::string(65, 'a'); }, "printable");
  refused([](auto& car) { car.part[1]->name = "a\nb"; }, "printable");
  refused([&](auto& car) { *car.part[1]->position = {nan, 0, 0}; }, "50 m");
  refused([&](auto& car) { *car.part[1]->orientation = {nan, 0, 0, 1}; }, "quaternion");
  refused([&](auto& car) { *car.part[1]->orientation = {0, 0, 0, 2}; }, "quaternion");
  refused([](auto& car) { car.part[1]->radius = 1; }, "no wheel");
  refused([](auto& car) { car.part[2]->radius = 0; }, "no wheel");
  refused([&](auto& car) { car.part[2]->width = nan; }, "no wheel");
  refused(
      [](auto& car) {
        while (car.part.size() < 256) {
          car.part.push_back(std::make_unique<schema::PartT>(*car.part[1]));
          car.part.back()->name = std::to_string(car.part.size());
        }
      },
      "255");
}

TEST(Client, RefusesMeshesThatItCannotMap) {
  Fed fed;
  ASSERT_NO_FATAL_FAILURE(fed.start());
  Crumple* session = fed.session.get();
  EngineMesh engine(fed.mesh);
  uint32_t mapping = 7;
  const auto refused = [&](const CrumpleOwnMesh& given, const char* fact) {
    CrumpleOwnMesh own = given;
    EXPECT_EQ(crumple_map(session, fed.car->hash.c_str(), &own, &mapping), CRUMPLE_BAD_ARGUMENT) << fact;
    EXPECT_NE(std::strstr(crumple_error(), fact), nullptr) << crumple_error();
  };
  CrumpleOwnMesh own = engine.own();
  own.count = 0;
  refused(own, "count");
  own.count = SIZE_MAX;
  refused(own, "count");
  own = engine.own();
  own.stride = 10;
  refused(own, "stride");
  own = engine.own();
  own.position = nullptr;
  refused(own, "position");
  own = engine.own();
  own.to_car = nullptr;
  refused(own, "to_car");  // this car was not baked from a file
  const double flat[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0};
  own.to_car = flat;
  refused(own, "inverse");
  engine.vertex[3].normal[0] = engine.vertex[3].normal[1] = engine.vertex[3].normal[2] = 0;
  refused(engine.own(), "normal of vertex 3");
  engine.vertex[2].position[1] = std::numeric_limits<float>::quiet_NaN();
  refused(engine.own(), "vertex 2");
  EXPECT_EQ(mapping, 7u);
  EXPECT_EQ(crumple_map(session, "0123456789abcdef", &own, &mapping), CRUMPLE_UNKNOWN);
  ASSERT_EQ(fed.feed(fed.quanta_of([](const Vec3&) { return std::array{0, 0, 0}; })), CRUMPLE_OK);
  CrumpleVertices into = engine.into(1);
  EXPECT_EQ(crumple_copy(session, "a", &into), CRUMPLE_BAD_ARGUMENT);
  EXPECT_NE(std::strstr(crumple_error(), "mapping"), nullptr) << crumple_error();
}

TEST(Client, OutsideOfWhatCopyNamesNothingHasChanged) {
  Fed fed;
  ASSERT_NO_FATAL_FAILURE(fed.start());
  Quanta quanta = fed.quanta_of([](const Vec3&) { return std::array{1, 2, 3}; });
  ASSERT_EQ(fed.feed(quanta), CRUMPLE_OK);
  auto before = fed.copy();
  EXPECT_EQ(before.first, 0u);
  EXPECT_EQ(before.count, fed.mesh.vertex_count) << "the first copy is all new";
  const auto same = fed.copy();
  EXPECT_EQ(same.count, 0u);
  std::mt19937 random(12);
  for (int round = 0; round < 20; ++round) {
    quanta[random() % quanta.size()] += 40;
    ASSERT_EQ(fed.feed(quanta), CRUMPLE_OK);
    const auto now = fed.copy();
    const auto differs = [&](uint32_t v) {
      return !std::equal(&now.position[3 * v], &now.position[3 * v] + 3, &before.position[3 * v]) ||
             !std::equal(&now.normal[3 * v], &now.normal[3 * v] + 3, &before.normal[3 * v]);
    };
    ASSERT_GT(now.count, 0u);
    for (uint32_t v = 0; v < fed.mesh.vertex_count; ++v) {
      const bool named = v >= now.first && v < now.first + now.count;
      EXPECT_TRUE(named || !differs(v)) << "vertex " << v;
    }
    EXPECT_LT(now.count, fed.mesh.vertex_count) << "one vertex has not so many neighbours";
    before = now;
  }
  ASSERT_EQ(fed.feed(quanta, 0.004f), CRUMPLE_OK);
  EXPECT_EQ(fed.copy().count, fed.mesh.vertex_count) << "the same quanta of another length";
}

TEST(Client, ShowsWhatWasAtATimeAndTheWayBetweenTwoTicks) {
  Fed fed;
  ASSERT_NO_FATAL_FAILURE(fed.start());
  Crumple* session = fed.session.get();
  const auto told = [&](uint64_t tick, int x) {
    fed.tick = tick - 1;
    ASSERT_EQ(fed.feed(fed.quanta_of([x](const Vec3&) { return std::array{x, 0, 0}; })), CRUMPLE_OK);
  };
  const auto shown = [&](double tick) { return fed.copy(tick / 60).displacement[0] / 0.0005f; };  // in quanta
  EXPECT_EQ(crumple_time(session), 0);
  told(100, 10);
  EXPECT_NEAR(crumple_time(session), 100 / 60.0, 1e-9);
  EXPECT_FLOAT_EQ(shown(-6), 10) << "from now on it is remembered, though the time is not known yet";
  told(101, 20);
  told(120, 40);  // the car was at rest until then
  told(121, 80);
  EXPECT_FLOAT_EQ(fed.copy().displacement[0], 0.0005f * 80) << "the newest";
  EXPECT_FLOAT_EQ(shown(99), 10);
  EXPECT_FLOAT_EQ(shown(100), 10);
  EXPECT_NEAR(shown(100.25), 12.5f, 1e-3f);
  EXPECT_NEAR(shown(101), 20, 1e-3f);
  EXPECT_NEAR(shown(119), 20, 1e-3f) << "nothing was told of that time";
  EXPECT_NEAR(shown(119.5), 30, 1e-3f);
  const auto half = fed.copy(120.5 / 60);
  EXPECT_NEAR(half.displacement[0] / 0.0005f, 60, 1e-3f);
  EXPECT_EQ(half.count, fed.mesh.vertex_count);
  EXPECT_EQ(fed.copy(120.5 / 60).count, 0u);
  CrumpleSurface surface{};
  ASSERT_EQ(crumple_surface(session, "a", &surface), CRUMPLE_OK);
  EXPECT_FALSE(surface.dirty) << "the newest was shown";
  told(122, 90);
  EXPECT_NEAR(shown(121), 80, 1e-3f);
  ASSERT_EQ(crumple_surface(session, "a", &surface), CRUMPLE_OK);
  EXPECT_TRUE(surface.dirty) << "what was shown is older";
  EXPECT_NEAR(shown(1000), 90, 1e-3f);
  ASSERT_EQ(crumple_surface(session, "a", &surface), CRUMPLE_OK);
  EXPECT_FALSE(surface.dirty);

  // The session keeps half a second, and the last surface before it.
  for (uint64_t tick = 123; tick < 200; ++tick) told(tick, static_cast<int>(tick));
  EXPECT_NEAR(shown(125), 168, 1e-3f);
  EXPECT_NEAR(shown(170.5), 170.5f, 1e-3f);
  EXPECT_NEAR(shown(-6), 199, 1e-3f) << "the server's time is not known any more";
  CrumpleVertices never{};
  never.stride = 12;
  never.time = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(crumple_copy(session, "a", &never), CRUMPLE_BAD_ARGUMENT);
}

TEST(Client, KnowsTheTimeOfTheServerWithinTheWayOfAMessage) {
  OwnServer server;
  ASSERT_NO_FATAL_FAILURE(server.start());
  ASSERT_TRUE(server.comes_to_hold(5, false));
  EXPECT_EQ(crumple_time(server.viewer.get()), 0) << "an answer may be of any age";
  server.tick = 6000;
  const auto sent = std::chrono::steady_clock::now();
  HealthReport report;
  report.rate = 50;
  report.tick = 6000;
  server.put("crumple/1/main/health", encode_health(report));
  for (int k = 0; k < 1000 && crumple_time(server.viewer.get()) == 0; ++k) server.held();
  const double time = crumple_time(server.viewer.get());
  const double passed = std::chrono::duration<double>(std::chrono::steady_clock::now() - sent).count();
  EXPECT_GE(time, 120);
  EXPECT_LE(time, 120 + passed);
  // A late message does not set the clock back.
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  const uint64_t before = server.surfaces();
  server.put("crumple/1/main/car/a/delta/0", delta(6001, server.quanta, 5, server.quanta).front());
  for (int k = 0; k < 1000 && server.surfaces() == before; ++k) server.held();
  EXPECT_GE(crumple_time(server.viewer.get()), time + 0.05);
}

std::string scene_trouble(const std::string& text) {
  const auto path = std::filesystem::temp_directory_path() / "crumple_scene_test.json";
  std::ofstream(path) << text;
  try {
    static_cast<void>(client::read_scene(path.string()));
  } catch (const std::runtime_error& error) {
    return error.what();
  }
  return "";
}

TEST(Scene, EverySceneOfTheRepositoryIsRead) {
  size_t count = 0;
  for (const auto& file : std::filesystem::directory_iterator(in_repository("clients/scenes"))) {
    const schema::SceneT scene = client::read_scene(file.path().string());
    EXPECT_FALSE(scene.about.empty());
    EXPECT_TRUE(!scene.obstacles.empty() || scene.cars.size() > 1) << file.path() << ": there is nothing to hit";
    ++count;
  }
  EXPECT_GE(count, 16u);
}

Obstacle obstacle_of(const schema::ObstacleT& from) {
  Obstacle out;
  const schema::Vec3 size = from.size ? *from.size : schema::Vec3();
  if (from.shape == schema::Shape::box)
    make_box({size.x(), size.y(), size.z()}, out);
  else if (from.shape == schema::Shape::capsule)
    make_capsule(size.x(), size.y(), out);
  else
    make_half_space(out);
  const auto& p = from.pose->position();
  out.pose.position = {p.x(), p.y(), p.z()};
  out.friction = from.friction;
  return out;
}

// Plays a scene of several cars as one island, without hosts, until `seconds` after its start.
PileUp play(const schema::SceneT& scene, double seconds) {
  constexpr double degree = 3.14159265358979 / 180;
  PileUp out;
  for (const auto& obstacle : scene.obstacles) out.obstacles.push_back(obstacle_of(*obstacle));
  for (const auto& car : scene.cars) {
    const schema::HitT& hit = *car->hits.front();
    CrashCar& one = out.add(box_car(), 0, 0, 0, 0);
    one.motion.pose.position = {hit.position->x(), hit.position->y(), hit.position->z()};
    one.motion.pose.orientation = Eigen::AngleAxisd(hit.yaw_deg * degree, Eigen::Vector3d::UnitZ()) *
                                  Eigen::AngleAxisd(hit.pitch_deg * degree, Eigen::Vector3d::UnitY()) *
                                  Eigen::AngleAxisd(hit.roll_deg * degree, Eigen::Vector3d::UnitX());
    one.motion.velocity = hit.speed_kmh / 3.6 * Eigen::Vector3d(hit.direction->x(), hit.direction->y(), hit.direction->z());
    one.mass.planar = car->planar.value_or(scene.planar);
  }
  out.run(seconds);
  return out;
}

// Box cars are as long and as wide as the cars for which the scenes are made, with sharper corners.
TEST(Scene, TheCarsOfASceneOfSeveralStartApartAndMeet) {
  const double seconds = sanitized ? 0.9 : 1.6;
  size_t scenes = 0;
  for (const auto& file : std::filesystem::directory_iterator(in_repository("clients/scenes"))) {
    const schema::SceneT scene = client::read_scene(file.path().string());
    if (scene.cars.size() < 2) continue;
    SCOPED_TRACE(file.path());
    ++scenes;
    const PileUp start = play(scene, 0), end = play(scene, seconds);
    size_t met = 0;
    for (size_t k = 0; k < end.cars.size(); ++k) {
      met += end.cars[k].impulse.norm() > 0.02 * end.cars[k].mass.mass;
      for (size_t other = 0; other < end.cars.size(); ++other) {
        if (k == other) continue;
        EXPECT_EQ(measure_overlap(start.cars[k], start.cars[other]).any, 0) << "they start inside each other";
        EXPECT_LT(measure_overlap(end.cars[k], end.cars[other]).node, 0.01) << "m";
      }
    }
    EXPECT_EQ(met, end.cars.size()) << "of all cars each is hit";
  }
  EXPECT_EQ(scenes, 10u);
}

TEST(Scene, EveryPresetOfTheRepositoryIsRead) {
  std::set<std::string> abouts;
  for (const auto& file : std::filesystem::directory_iterator(in_repository("clients/presets"))) {
    if (file.path().extension() != ".json") continue;
    const schema::PresetT preset = client::read_preset(file.path().string());
    EXPECT_FALSE(preset.parameters.empty()) << file.path();
    abouts.insert(preset.about);
    EXPECT_THROW(static_cast<void>(client::read_scene(file.path().string())), std::runtime_error);
  }
  EXPECT_GE(abouts.size(), 4u);
}

TEST(Scene, AMistakeIsToldWithFileAndLine) {
  const std::string trouble = scene_trouble("{\n  \"about\": \"x\",\n  \"speeed\": 3\n}\n");
  EXPECT_NE(trouble.find("crumple_scene_test.json:3"), std::string::npos) << trouble;
  EXPECT_NE(trouble.find("speeed"), std::string::npos) << trouble;
}

TEST(Scene, ValuesOutOfRangeAreToldByName) {
  const auto with = [](const std::string& hit) {
    return R"({"about": "x", "obstacles": [], "hits": [{"position": {"x": 0, "y": 0, "z": 0}, )" + hit + "}]}";
  };
  const std::string forward = R"("direction": {"x": 1, "y": 0, "z": 0})";
  EXPECT_EQ(scene_trouble(with(forward)), "");
  EXPECT_NE(scene_trouble(with(R"("direction": {"x": 0, "y": 0, "z": 0})")).find("direction"), std::string::npos);
  EXPECT_NE(scene_trouble(with(forward + R"(, "repair": 2)")).find("repair"), std::string::npos);
  EXPECT_NE(scene_trouble(with(forward + R"(, "seconds": -1)")).find("seconds"), std::string::npos);
  EXPECT_NE(scene_trouble(R"({"about": "x", "obstacles": [], "hits": []})").find("hits"), std::string::npos);
  EXPECT_NE(scene_trouble("").find("crumple_scene_test.json"), std::string::npos);
}

TEST(Scene, CarsThatCannotBeDrivenTogetherAreToldByName) {
  const std::string hit = R"({"position": {"x": 0, "y": 0, "z": 0}, "direction": {"x": 1, "y": 0, "z": 0}})";
  const auto car = [&](const std::string& id, const std::string& more = "", const std::string& hits = "1") {
    return R"({"id": ")" + id + "\"" + more + R"(, "hits": [)" +
           (hits == "0"   ? ""
            : hits == "1" ? hit
                          : hit + ", " + hit) +
           "]}";
  };
  const auto trouble = [](const std::string& cars, const std::string& more = "") {
    return scene_trouble(R"({"about": "x", "obstacles": [], "cars": [)" + cars + "]" + more + "}");
  };
  const auto names = [](const std::string& sentence, const char* what) { return sentence.find(what) != std::string::npos; };
  EXPECT_EQ(trouble(car("a") + ", " + car("b", R"(, "host": "h", "mass": 900, "planar": false)")), "");
  EXPECT_TRUE(names(trouble(car("a") + ", " + car("a")), "car a: another car has the same id"));
  EXPECT_TRUE(names(trouble(car("A car")), "\"A car\" is not an id of a car"));
  EXPECT_TRUE(names(trouble(car("a", R"(, "host": "/")")), "car a: \"/\" is not an id of a host"));
  EXPECT_TRUE(names(trouble(car("a", R"(, "mass": -1)")), "car a: mass is negative"));
  EXPECT_TRUE(names(trouble(car("a", "", "0")), "car a: hits is empty"));
  EXPECT_TRUE(names(trouble(car("a") + ", " + car("b", "", "2")), "car b: it has another number of hits than car a"));
  EXPECT_TRUE(names(trouble(car("a"), R"(, "hits": [)" + hit + "]"), "it has hits and cars"));
  std::string many = car("c0");
  for (int k = 1; k < 65; ++k) many += ", " + car("c" + std::to_string(k));
  EXPECT_TRUE(names(trouble(many), "over 64 cars"));
}

}  // namespace
}  // namespace crumple

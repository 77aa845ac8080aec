// Tests the queries of a viewer and their times: the state machine that the client library and the gateway share. The test
// answers the queries and sets the time.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cstring>
#include <set>
#include <string>
#include <vector>

#include "protocol/asset.h"
#include "protocol/surface_codec.h"
#include "schema/message_generated.h"
#include "viewer/fetch.h"
#include "viewer/follow.h"
#include "wire/encode.h"

namespace crumple {
namespace {

using viewer::Applied;
using viewer::FollowedCar;
using viewer::Following;
using namespace std::chrono_literals;

constexpr size_t nodes = 4;

std::span<const uint8_t> raw(const Bytes& bytes) { return {reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}; }

viewer::Quanta filled(int16_t value) { return viewer::Quanta(3 * nodes, value); }

Bytes keyframe_of(uint64_t tick, int16_t value) {
  return encode_keyframe({tick, "0123456789abcdef", 0.0005f}, filled(value)).front();
}

Bytes delta_of(uint64_t tick, int16_t value, uint64_t key_tick, int16_t key_value) {
  return encode_delta({tick, "0123456789abcdef", 0.0005f}, filled(value), key_tick, filled(key_value)).front();
}

struct Question {
  uint64_t ticket;
  std::string key;
  std::vector<uint8_t> payload;
};

// A network that sends nothing but keeps the queries.
struct Asked {
  std::vector<Question> questions;
  viewer::Ask ask = [this](const std::string& key, std::span<const uint8_t> payload, std::chrono::milliseconds) {
    questions.push_back({questions.size() + 1, key, {payload.begin(), payload.end()}});
    return questions.size();
  };
  const Question& last() const { return questions.back(); }
};

struct Follower : Asked {
  viewer::Time now{1h};
  Following all{"crumple/1/main/", ask};

  explicit Follower(bool follows_all = true) {
    if (follows_all) all.follow_all(0, now);
  }
  const FollowedCar& car() { return all.cars.at("a"); }
  // The tick of the held surface; 0: none.
  uint64_t held() { return car().surface.quanta.empty() ? 0 : car().surface.tick; }
  void token(bool alive) { all.take_token(*parse_key("car/a"), alive, now); }
  Applied keyframe(uint64_t tick, int16_t value) {
    const Bytes bytes = keyframe_of(tick, value);
    return all.take_sample(*parse_key("car/a/key/0"), raw(bytes), now).outcome.applied;
  }
  Applied delta(uint64_t tick, int16_t value, uint64_t key_tick, int16_t key_value) {
    const Bytes bytes = delta_of(tick, value, key_tick, key_value);
    return all.take_sample(*parse_key("car/a/delta/0"), raw(bytes), now).outcome.applied;
  }
  // Answers the query with this ticket. value: of all numbers in the keyframe.
  void answer(uint64_t ticket, uint64_t tick, int16_t value, bool failed = false) {
    all.take_reply(ticket, raw(keyframe_of(tick, value)), failed, now);
    all.end(ticket);
  }
  void pass(std::chrono::milliseconds time) {
    now += time;
    all.ask_due(now);
  }
  void health(uint64_t told) {
    HealthReport report;
    report.told.push_back({"a", {told, told}});
    const Bytes bytes = encode_health(report);
    all.take_health(*verified<schema::Health>(bytes), now);
  }
  // A living car: the viewer holds tick 5 and has no open query.
  void settle() {
    token(true);
    answer(last().ticket, 5, 1);
    now += 1s;
  }
};

TEST(Viewer, AsksForAMissingKeyframeOnceAndAgainAfterThePause) {
  Follower one;
  one.settle();
  ASSERT_EQ(one.held(), 5u);
  const size_t before = one.questions.size();
  for (uint64_t tick = 20; tick < 25; ++tick) EXPECT_EQ(one.delta(tick, 2, 19, 1), Applied::missing_keyframe);
  ASSERT_EQ(one.questions.size(), before + 1) << "five deltas lack one keyframe";
  EXPECT_EQ(one.last().key, "crumple/1/main/car/a/key/0");
  one.answer(one.last().ticket, 0, 0, true);
  one.delta(25, 2, 19, 1);
  one.pass(viewer::ask_again / 2);
  one.delta(26, 2, 19, 1);
  EXPECT_EQ(one.questions.size(), before + 1) << "a server in trouble is left alone for a moment";
  one.pass(viewer::ask_again);
  ASSERT_EQ(one.questions.size(), before + 2) << "no message is needed for it";
  one.answer(one.last().ticket, 19, 1);
  EXPECT_EQ(one.delta(27, 2, 19, 1), Applied::whole);
  one.delta(41, 2, 40, 1);
  EXPECT_EQ(one.questions.size(), before + 3) << "after an answer that helped, at once";
}

TEST(Viewer, AsksNothingTwiceWhileTheAnswerMayStillCome) {
  Follower one;
  one.token(true);
  for (int k = 0; k < 4; ++k) one.pass(viewer::keyframe_patience / 4);
  EXPECT_EQ(one.questions.size(), 1u);
  one.all.end(one.last().ticket);
  one.pass(0ms);
  EXPECT_EQ(one.questions.size(), 2u);
}

TEST(Viewer, AsksLessAndLessOftenForAKeyframeThatDoesNotCome) {
  Follower one;
  one.token(true);
  std::vector<std::chrono::milliseconds> pauses;
  for (auto asked = one.now; one.now < viewer::Time{1h + 40s}; one.pass(10ms)) {
    if (one.questions.size() == pauses.size() + 1) {
      if (!pauses.empty()) pauses.back() = std::chrono::duration_cast<std::chrono::milliseconds>(one.now - asked);
      pauses.push_back({});
      asked = one.now;
    }
    one.answer(one.last().ticket, 0, 0, true);
  }
  ASSERT_GE(pauses.size(), 7u);
  for (size_t k = 0; k + 1 < pauses.size(); ++k)
    EXPECT_NEAR(double(pauses[k].count()), double(std::min(viewer::ask_again * (1 << k), viewer::longest_pause).count()), 20)
        << k;
  one.token(false);
  const size_t before = one.questions.size();
  one.token(true);
  EXPECT_EQ(one.questions.size(), before + 1) << "the next car of this id is asked for at once";
}

// Anyone who may publish can claim that cars exist. Without the limit each viewer asked for all of them twice a second.
struct Crowd : Follower {
  static constexpr size_t invented = 1000;
  std::set<std::string> asked;
  Crowd() {
    for (size_t k = 0; k < invented; ++k) all.take_token(*parse_key("car/0-" + std::to_string(k)), true, now);
  }
  // The server knows none of these cars. ends: false if somebody else never answers, so that the question stays open at the
  // asker.
  void refuse_all(bool ends) {
    const auto questions_now = all.questions;
    for (const auto& [ticket, question] : questions_now) {
      asked.insert(question.id);
      all.take_reply(ticket, {}, true, now);
      if (ends) all.end(ticket);
    }
  }
};

TEST(Viewer, InventedCarsMakeItAskForAFewAtATimeAndDoNotHideARealOne) {
  for (const bool ends : {true, false}) {
    Crowd one;
    EXPECT_EQ(one.questions.size(), viewer::questions_limit);
    one.token(true);
    EXPECT_EQ(one.all.open, viewer::questions_limit) << "a real one waits as well";
    for (size_t k = 0; k <= Crowd::invented / viewer::questions_limit && !one.car().asking; ++k) {
      EXPECT_LE(one.all.open, viewer::questions_limit);
      one.refuse_all(ends);
      one.pass(10ms);
    }
    ASSERT_TRUE(one.car().asking) << "as soon as each of them was refused once";
    one.answer(one.car().asking, 20, 2);
    EXPECT_EQ(one.held(), 20u);
    EXPECT_EQ(one.delta(30, 2, 29, 1), Applied::missing_keyframe);
    one.pass(10ms);
    EXPECT_TRUE(one.car().asking) << "later it comes before those that were refused";
  }
}

TEST(Viewer, AsksInventedCarsLessAndLessOften) {
  Crowd one;
  for (; one.now < viewer::Time{1h + 60s}; one.pass(50ms)) one.refuse_all(true);
  EXPECT_EQ(one.asked.size(), Crowd::invented) << "each is asked for";
  EXPECT_LT(one.questions.size(), 14 * Crowd::invented) << "in a minute";
}

TEST(Viewer, OwnersThatComeAndGoWithoutEndMakeItAskLessAndLessOften) {
  Crowd one;
  for (bool alive = true; one.now < viewer::Time{1h + 60s}; alive = !alive) {
    one.all.take_token(*parse_key("owner/0-x"), alive, one.now);
    EXPECT_LE(one.all.open, viewer::questions_limit);
    one.pass(30ms);
    one.refuse_all(true);
  }
  EXPECT_LT(one.questions.size(), 14 * Crowd::invented) << "in a minute";
}

TEST(Viewer, AQuestionThatWasForgottenKeepsItsSlotUntilItEnds) {
  Crowd one;
  for (size_t k = 0; k < Crowd::invented; ++k) one.all.forget("0-" + std::to_string(k));
  one.token(true);
  EXPECT_FALSE(one.car().asking);
  one.all.end(one.questions.front().ticket);
  one.pass(10ms);
  EXPECT_TRUE(one.car().asking);
}

TEST(Viewer, AsksOnceWhereACarFellSilentAfterAMessage) {
  Follower one;
  one.settle();
  const size_t before = one.questions.size();
  one.pass(10s);
  EXPECT_EQ(one.questions.size(), before) << "nothing has come that another could have followed";
  one.delta(6, 2, 5, 1);
  one.pass(viewer::silence);
  EXPECT_EQ(one.questions.size(), before);
  one.pass(1ms);
  ASSERT_EQ(one.questions.size(), before + 1);
  one.answer(one.last().ticket, 5, 1);
  one.pass(10s);
  EXPECT_EQ(one.questions.size(), before + 1);
}

TEST(Viewer, AsksForWhatHealthSaysWasTold) {
  Follower one;
  one.settle();
  const size_t before = one.questions.size();
  one.health(5);
  EXPECT_EQ(one.questions.size(), before) << "it holds that";
  one.delta(6, 2, 5, 1);
  one.health(7);
  EXPECT_EQ(one.questions.size(), before) << "that may be on its way";
  one.now += viewer::on_its_way + 1ms;
  one.health(6);
  EXPECT_EQ(one.questions.size(), before);
  one.health(7);
  EXPECT_EQ(one.questions.size(), before + 1);
}

TEST(Viewer, ACarsSecondLifeBeginsWithAnyTickAndAQuestionOfItsOwn) {
  Follower one;
  one.settle();
  one.delta(9, 2, 5, 1);
  one.delta(30, 2, 29, 1);
  const Question first = one.last();
  one.token(false);
  EXPECT_TRUE(one.car().gone);
  EXPECT_EQ(one.held(), 9u) << "what it looked like at its end";
  one.answer(first.ticket, 40, 7);
  EXPECT_EQ(one.held(), 9u) << "the answer is that of the earlier life";
  const size_t before = one.questions.size();
  one.token(true);
  ASSERT_EQ(one.questions.size(), before + 1);
  one.answer(one.last().ticket, 3, 4);
  EXPECT_EQ(one.held(), 3u) << "ticks of another life cannot be compared";
  EXPECT_EQ(one.car().surface.quanta, filled(4));
  EXPECT_FALSE(one.car().gone);
  EXPECT_EQ(one.keyframe(2, 5), Applied::old) << "now they can";
}

TEST(Viewer, AsksAnotherOwnerForEachCarThatLives) {
  Follower one;
  one.settle();
  one.delta(9, 2, 5, 1);
  one.delta(30, 2, 29, 1);
  const Question of_the_first = one.last();
  const size_t before = one.questions.size();
  one.all.take_token(*parse_key("owner/2-b"), true, one.now);
  ASSERT_EQ(one.questions.size(), before + 1) << "at once";
  one.answer(of_the_first.ticket, 29, 1);
  EXPECT_EQ(one.held(), 9u) << "what the first was asked says nothing of the second";
  one.answer(one.last().ticket, 3, 4);
  EXPECT_EQ(one.held(), 3u);
  EXPECT_EQ(one.delta(4, 5, 3, 4), Applied::whole);
  one.token(false);
  one.all.take_token(*parse_key("owner/3-c"), true, one.now);
  EXPECT_EQ(one.questions.size(), before + 1) << "the car is gone";
}

TEST(Viewer, AsksAnewAMomentAfterAnOwnerWentAndAtOnceWhenOneComes) {
  Follower one;
  one.settle();
  const size_t before = one.questions.size();
  one.all.take_token(*parse_key("owner/1-a"), false, one.now);
  EXPECT_EQ(one.questions.size(), before) << "nobody is there who could answer";
  one.pass(200ms);
  one.all.take_token(*parse_key("owner/2-b"), true, one.now);
  EXPECT_EQ(one.questions.size(), before + 1);
  one.answer(one.last().ticket, 3, 4);
  one.all.take_token(*parse_key("owner/1-a"), false, one.now);
  one.pass(viewer::ask_again);
  one.pass(viewer::ask_again);
  EXPECT_EQ(one.questions.size(), before + 2) << "the first may have answered meanwhile";
}

TEST(Viewer, FollowsNoMoreCarsThanItsLimit) {
  Follower one;
  for (size_t k = 0; k < viewer::cars_limit + 10; ++k)
    one.all.take_token(*parse_key("car/" + std::to_string(k)), true, one.now);
  EXPECT_EQ(one.all.cars.size(), viewer::cars_limit);
  EXPECT_EQ(one.questions.size(), viewer::questions_limit);
  Follower other(false);
  other.token(true);
  EXPECT_TRUE(other.all.cars.empty()) << "nobody follows it";
}

TEST(Viewer, HoldsNoMoreBytesOfSurfacesThanItsLimit) {
  Follower one;
  one.settle();
  const viewer::Quanta large(size_t{3} * surface_node_limit, 7);
  const std::vector<Bytes> parts = encode_keyframe({9, "0123456789abcdef", 0.0005f}, large);
  ASSERT_GT(parts.size(), 1u);
  // A small part after a large one gives no memory back.
  const Bytes small = encode_keyframe({10, "0123456789abcdef", 0.0005f}, filled(1)).front();
  const auto flood = [&] {
    size_t refused = 0;
    for (size_t k = 0; k < 1000; ++k) {
      const std::string name = "car/" + std::to_string(k) + "/key/0";
      const Key key = *parse_key(name);  // a view of it
      refused += one.all.take_sample(key, raw(parts.front()), one.now).outcome.applied == Applied::refused;
      if (k % 2) one.all.take_sample(key, raw(small), one.now);
      EXPECT_LE(one.all.held, viewer::surfaces_limit);
    }
    return refused;
  };
  EXPECT_EQ(flood(), 0u) << "cars without tokens give way";
  EXPECT_GT(one.all.held, viewer::surfaces_limit / 2);
  for (size_t k = 0; k < 1000; ++k) one.all.take_token(*parse_key("car/" + std::to_string(k)), true, one.now);
  EXPECT_GT(flood(), 0u);
  const size_t asked = one.questions.size();
  for (int tenth = 0; tenth < 100; ++tenth) {
    one.pass(100ms);
    one.answer(one.last().ticket, 11, 1, true);
  }
  EXPECT_LT(one.questions.size(), asked + 300) << "it asks less and less often for what it cannot hold";
  EXPECT_EQ(one.held(), 5u) << "the others keep theirs";
  for (size_t k = 0; k < 1000; ++k) one.all.forget(std::to_string(k));
  one.all.forget("a");
  EXPECT_EQ(one.all.held, 0u);
}

TEST(Viewer, FollowsNewCarsForEverAndForgetsThoseThatAreGone) {
  Follower one;
  one.all.follow("named", 0, one.now);
  one.all.take_token(*parse_key("car/named"), true, one.now);
  one.all.take_token(*parse_key("car/named"), false, one.now);
  for (size_t k = 0; k < 3 * viewer::cars_limit; ++k) {
    const std::string id = std::to_string(k), key = "car/" + id;
    one.all.take_token(*parse_key(key), true, one.now);
    ASSERT_TRUE(one.all.cars.contains(id)) << id;
    one.all.take_token(*parse_key(key), false, one.now);
  }
  EXPECT_EQ(one.all.cars.size(), viewer::cars_limit);
  EXPECT_TRUE(one.all.cars.contains("named"));
}

TEST(Viewer, SaysWhichMessagesOthersNeed) {
  Follower one;
  one.settle();
  const auto counts = [&](const char* key, const Bytes& bytes) {
    return one.all.take_sample(*parse_key(key), raw(bytes), one.now).counts;
  };
  EXPECT_TRUE(counts("car/a/delta/0", delta_of(8, 2, 5, 1)));
  EXPECT_FALSE(counts("car/a/delta/0", delta_of(7, 3, 5, 1))) << "older";
  EXPECT_FALSE(counts("car/a/delta/0", delta_of(9, 3, 6, 1))) << "nobody can use it";
  EXPECT_TRUE(counts("car/a/key/0", keyframe_of(8, 2))) << "the surface of the last delta, but the base of the next ones";
  EXPECT_FALSE(counts("car/a/key/0", keyframe_of(8, 2)));
  EXPECT_FALSE(counts("car/a/key/1", keyframe_of(9, 2))) << "of another level";
}

struct Fetcher : Asked {
  viewer::Time now{1h};
  viewer::Fetching all{ask};
  std::vector<uint8_t> car;  // three pieces, the last one short
  std::string hash;

  Fetcher() : car(2 * asset_piece + 1000) {
    for (size_t i = 0; i < car.size(); ++i) car[i] = uint8_t(i % 251);
    hash = hash_of(car.data(), car.size());
  }
  uint64_t offset() const {
    uint64_t at = UINT64_MAX;
    if (last().payload.size() == sizeof at) std::memcpy(&at, last().payload.data(), sizeof at);
    return at;
  }
  std::optional<viewer::AssetNews> answer(std::vector<uint8_t> bytes, bool failed = false) {
    return all.take_reply(last().ticket, bytes, failed, now);
  }
  // Answers the last query with its piece. If `turned` is not 0, a bit of the piece is flipped.
  std::optional<viewer::AssetNews> answer(uint8_t turned = 0) {
    const size_t begin = offset(), end = std::min(car.size(), begin + asset_piece);
    std::vector<uint8_t> piece(car.begin() + ptrdiff_t(begin), car.begin() + ptrdiff_t(end));
    piece.front() ^= turned;
    return answer(std::move(piece));
  }
};

TEST(Viewer, FetchesABakedCarInPieces) {
  Fetcher one;
  for (size_t piece = 0; piece < 3; ++piece) {
    EXPECT_TRUE(one.all.want(one.hash, one.now)) << "as often as one likes";
    ASSERT_EQ(one.questions.size(), piece + 1);
    EXPECT_EQ(one.last().key, "crumple/1/asset/" + one.hash);
    EXPECT_EQ(one.offset(), piece * asset_piece);
    const auto news = one.answer();
    ASSERT_TRUE(news && news->trouble.empty());
    ASSERT_EQ(news->whole.has_value(), piece == 2);
    if (!news->whole) continue;
    EXPECT_TRUE(std::ranges::equal(news->whole->bytes(), one.car));
  }
  EXPECT_TRUE(one.all.assets.empty() && one.all.tickets.empty()) << "nothing is kept of it";
}

TEST(Viewer, ABakedCarWithAnotherHashIsThrownAwayAndAskedForAgain) {
  Fetcher one;
  one.all.want(one.hash, one.now);
  one.answer();
  one.answer(1);
  const auto news = one.answer();
  ASSERT_TRUE(news && !news->whole);
  EXPECT_NE(news->trouble.find("have the hash"), std::string::npos) << news->trouble;
  EXPECT_EQ(one.all.size(), 0u);
  one.all.want(one.hash, one.now + viewer::ask_again / 2);
  EXPECT_EQ(one.questions.size(), 3u) << "not at once";
  one.now += viewer::ask_again;
  one.all.want(one.hash, one.now);
  ASSERT_EQ(one.questions.size(), 4u);
  EXPECT_EQ(one.offset(), 0u) << "from its beginning";
  one.answer();
  one.answer();
  EXPECT_TRUE(one.answer()->whole);
}

TEST(Viewer, ABakedCarThatDoesNotComeIsTroubleAndAskedForAgain) {
  Fetcher one;
  one.all.want(one.hash, one.now);
  one.answer();
  EXPECT_EQ(one.answer({'n', 'o'}, true)->trouble, "no");
  one.now += viewer::ask_again;
  one.all.want(one.hash, one.now);
  ASSERT_EQ(one.offset(), 0u);
  EXPECT_NE(one.all.end(one.last().ticket)->trouble.find("did not answer"), std::string::npos);
  EXPECT_FALSE(one.all.end(one.last().ticket)) << "it has ended";
  one.now += viewer::ask_again;
  one.all.want(one.hash, one.now);
  const uint64_t ticket = one.last().ticket;
  one.all.forget(one.hash);
  EXPECT_FALSE(one.all.take_reply(ticket, one.car, false, one.now)) << "nobody wants it any more";
}

}  // namespace
}  // namespace crumple

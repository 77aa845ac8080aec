// Tests the tick from outside, with bytes in and bytes out: what hosts may do and may not do, which surfaces viewers hold, and
// that the same messages give the same world on any number of threads.
#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <limits>
#include <random>

#include "box_car.h"
#include "host.h"
#include "refusal.h"
#include "tick/budget.h"
#include "tick/hash.h"
#include "tick/health.h"
#include "tick/inputs.h"
#include "tick/levels.h"
#include "tick/snapshot.h"
#include "tick/state.h"
#include "tick/uploads.h"

namespace crumple {
namespace {

using host::CarPose;
using host::pose_at;
using host::Thing;

const std::shared_ptr<const Car>& box() {
  static const auto car = box_car({4, 2, 2});
  return car;
}
// A car of one cell with six tets, for tests that need thousands of worlds.
const std::shared_ptr<const Car>& cell() {
  static const auto car = box_car({1, 1, 1});
  return car;
}

// A world, and messages to it.
struct Scene {
  WorldHandle world;
  Outbox outbox;
  uint64_t ticket = 0;
  int threads = 1;

  explicit Scene(const std::shared_ptr<const Car>& car = box(), const Limits& limits = {}, double rate = 60)
      : world(make_world(rate, 0.0005f, limits)) {
    add_asset(*world, car);
  }
  const Outbox& step(const Inbox& inbox = {}) {
    tick(*world, inbox, outbox, threads);
    return outbox;
  }
  // Returns the answer to a command: "" if the world did it, else the sentence.
  std::string ask(const std::string& car, const Bytes& bytes, Bytes* state = nullptr) {
    step({{"car/" + car, bytes, ++ticket}});
    for (const Message& message : outbox) {
      if (message.ticket != ticket) continue;
      const auto* answer = host::read_as<schema::Answer>(message.bytes);
      EXPECT_EQ(answer->tick(), tick_count(*world));
      if (state && answer->state()) {
        const auto* data = reinterpret_cast<const std::byte*>(answer->state()->data());
        state->assign(data, data + answer->state()->size());
      }
      return answer->ok() ? "" : answer->sentence()->str();
    }
    return "no answer";
  }
  void spawn(const std::string& car, const std::string& host = "game", const schema::Pose& pose = pose_at(0)) {
    EXPECT_EQ(ask(car, host::spawn(world->assets.begin()->first, host, pose)), "");
  }
  Instance& car(const std::string& id) { return world->cars.at(id); }
  uint64_t refused(Reason reason) const { return world->tally.refusals[size_t(reason)]; }
  std::vector<const Message*> sent(const std::string& key) const {
    std::vector<const Message*> out;
    for (const Message& message : outbox) {
      if (message.key == key && message.ticket == 0) out.push_back(&message);
    }
    return out;
  }
};

// Two sweeps in a sub-step, for tests that need many ticks and no accuracy.
Bytes quick() {
  return host::parameters([](auto& p) { p.add_iterations(2); });
}

bool finite(const World& world) {
  for (const auto& [id, car] : world.cars) {
    if (!car.motion.pose.position.allFinite() || !car.motion.velocity.allFinite() || !car.motion.angular_velocity.allFinite()) {
      return false;
    }
    if (!std::all_of(car.body.node.begin(), car.body.node.end(), [](const Vec3& node) { return node.allFinite(); }))
      return false;
  }
  return true;
}

// A wall whose face is at x.
Thing wall(float x, uint32_t id = 1) { return {id, schema::Shape::box, {0.5f, 5, 5}, pose_at(double(x) + 0.5, 0, 1)}; }

// One car drives at 14 m/s into a wall 0.1 m before its nose. The host applies each reaction one tick late.
void crash(
    Scene& scene, int ticks, const std::function<void(const Outbox&)>& see = [](const Outbox&) {}) {
  scene.spawn("a");
  see(scene.outbox);
  scene.step({{"host/game/obstacles", host::obstacles(1, {wall(2.35f)})}});
  see(scene.outbox);
  CarPose car{"a", pose_at(0), {14, 0, 0}};
  car.seen = tick_count(*scene.world);
  for (int k = 0; k < ticks; ++k) {
    scene.step({{"host/game/poses", host::poses(uint64_t(k + 1), {car})}});
    see(scene.outbox);
    car.pose = pose_at(car.pose.position().x() + double(car.velocity.x()) / 60);
    for (const Message* message : scene.sent("host/game/reactions")) {
      const auto* reactions = host::read_as<schema::Reactions>(message->bytes);
      const auto* reaction = reactions->cars()->Get(0);
      car = {"a", *reaction->pose(), *reaction->velocity(), *reaction->angular_velocity(), reactions->tick()};
    }
  }
}

// ---- hosts and commands -----------------------------------------------------------------------------------------------------

TEST(World, ACarFollowsItsHostAndThenItsOwnVelocity) {
  Scene scene;
  scene.spawn("a");
  scene.step({{"host/game/poses", host::poses(1, {{"a", pose_at(10), {6, 0, 0}}})}});
  EXPECT_NEAR(scene.car("a").motion.pose.position.x(), 10.1, 1e-9);
  scene.step();
  EXPECT_NEAR(scene.car("a").motion.pose.position.x(), 10.2, 1e-9);
  EXPECT_TRUE(scene.outbox.empty()) << "a car that nothing touches tells nobody anything";
}

TEST(World, TheLatestPoseOfAnInboxCounts) {
  Scene scene;
  scene.spawn("a");
  scene.step(
      {{"host/game/poses", host::poses(1, {{"a", pose_at(1)}})}, {"host/game/poses", host::poses(2, {{"a", pose_at(2)}})}});
  EXPECT_EQ(scene.car("a").motion.pose.position.x(), 2);
}

TEST(World, APoseOfAnUnknownCarOrOfAnotherHostsCarIsCountedAndSkipped) {
  Scene scene;
  scene.spawn("a", "game");
  scene.spawn("b", "other");
  scene.step({{"host/game/poses", host::poses(1, {{"x"}, {"b", pose_at(5)}, {"a", pose_at(5)}})}});
  EXPECT_EQ(scene.refused(Reason::unknown_car), 1u);
  EXPECT_EQ(scene.refused(Reason::not_owner), 1u);
  EXPECT_NE(last_refusal(*scene.world).find("car b belongs to host other, not to host game"), std::string::npos);
  EXPECT_EQ(scene.car("a").motion.pose.position.x(), 5);
  EXPECT_EQ(scene.car("b").motion.pose.position.x(), 0);
  scene.step({{"host/stranger/poses", host::poses(1, {{"a", pose_at(7)}})}});
  EXPECT_EQ(scene.refused(Reason::unknown_host), 1u);
  EXPECT_EQ(scene.car("a").motion.pose.position.x(), 5);
}

TEST(World, WhoMayNotSpeakIsRefusedBeforeAnythingIsRead) {
  Limits limits;
  limits.hosts = 1;
  Scene scene(box(), limits);
  scene.spawn("a");
  const Bytes nonsense(7);
  scene.step({{"host/stranger/poses", nonsense}, {"host/stranger/obstacles", nonsense}});
  EXPECT_EQ(scene.refused(Reason::unknown_host), 1u);
  EXPECT_EQ(scene.refused(Reason::too_many_hosts), 1u);
  EXPECT_EQ(scene.refused(Reason::malformed), 0u);
  scene.step({{"host/game/poses", nonsense}, {"host/game/obstacles", nonsense}});
  EXPECT_EQ(scene.refused(Reason::malformed), 2u);
}

TEST(World, ASequenceThatIsNotAboveTheLastIsDropped) {
  Scene scene;
  scene.spawn("a");
  for (uint64_t sequence : {5u, 5u, 4u})
    scene.step({{"host/game/poses", host::poses(sequence, {{"a", pose_at(double(sequence))}})}});
  EXPECT_EQ(scene.car("a").motion.pose.position.x(), 5);
  EXPECT_EQ(scene.refused(Reason::stale_sequence), 2u);
  EXPECT_NE(last_refusal(*scene.world).find("poses: sequence is 4; above 5"), std::string::npos);
  scene.step({{"host/game/obstacles", host::obstacles(1, {wall(50)})}, {"host/game/obstacles", host::obstacles(1, {})}});
  EXPECT_EQ(scene.refused(Reason::stale_sequence), 3u);
  EXPECT_EQ(scene.world->obstacles.size(), 1u);
}

TEST(World, ABadEntryRefusesTheWholeMessage) {
  Scene scene;
  scene.spawn("a");
  scene.spawn("b");
  scene.step({{"host/game/poses", host::poses(1, {{"a", pose_at(5)}, {"b", pose_at(5), {501, 0, 0}}})}});
  EXPECT_EQ(scene.car("a").motion.pose.position.x(), 0);
  EXPECT_EQ(scene.refused(Reason::out_of_range), 1u);
  scene.step({{"host/game/obstacles", host::obstacles(1, {wall(50, 1), wall(60, 2)})}});
  scene.step({{"host/game/obstacles", host::obstacles(2, {wall(70, 1), {2, schema::Shape::sphere, {-1, 0, 0}}})}});
  EXPECT_EQ(scene.refused(Reason::out_of_range), 2u);
  ASSERT_EQ(scene.world->obstacles.size(), 2u);
  EXPECT_EQ(scene.world->obstacles[0].pose.position.x(), 50.5);
}

TEST(World, ObstaclesStandInTheOrderOfHostsAndIdsAndAListReplacesItsHosts) {
  Scene scene;
  const auto at = [](uint32_t id, double x) { return Thing{id, schema::Shape::sphere, {1, 0, 0}, pose_at(x)}; };
  const auto order = [&] {
    std::string text;
    for (const Obstacle& obstacle : scene.world->obstacles) text += std::to_string(int(obstacle.pose.position.x())) + ' ';
    return text;
  };
  scene.step({{"host/m/obstacles", host::obstacles(1, {at(2, 102), at(1, 101)})},
              {"host/z/obstacles", host::obstacles(1, {at(1, 201)})},
              {"host/b/obstacles", host::obstacles(1, {at(9, 9), at(3, 3), at(7, 7)})}});
  EXPECT_EQ(order(), "3 7 9 101 102 201 ");
  scene.step({{"host/m/obstacles", host::obstacles(2, {at(4, 104)})}});
  EXPECT_EQ(order(), "3 7 9 104 201 ");
  scene.step({{"host/b/obstacles", host::obstacles(2, {})}});
  EXPECT_EQ(order(), "104 201 ");
  EXPECT_FALSE(scene.world->hosts.contains("b")) << "a host with neither cars nor obstacles is gone";
}

TEST(World, AnObstacleMovesOnUntilTheNextMessage) {
  Scene scene;
  Thing ball{1, schema::Shape::sphere, {1, 0, 0}, pose_at(100)};
  ball.velocity = {-6, 0, 0};
  scene.step({{"host/game/obstacles", host::obstacles(1, {ball})}});
  scene.step();
  EXPECT_NEAR(scene.world->obstacles[0].pose.position.x(), 99.8, 1e-9);
}

TEST(World, AMovingObstacleDentsACarThatStands) {
  Scene scene;
  scene.spawn("a");
  Thing ball{1, schema::Shape::sphere, {0.5f, 0, 0}, pose_at(3, 0, 0.75)};
  ball.velocity = {-12, 0, 0};
  scene.step({{"host/other/obstacles", host::obstacles(1, {ball})}});
  for (int k = 0; k < 10; ++k) scene.step();
  EXPECT_GT(scene.car("a").body.absorbed, 0);
  EXPECT_LT(scene.car("a").motion.velocity.x(), 0) << "all hosts' obstacles act on all cars";
}

TEST(World, CommandsAreRefusedWithSentencesThatNameTheRemedy) {
  Limits limits;
  limits.cars = 2;
  limits.hosts = 1;
  Scene scene(box(), limits);
  const auto says = [](const std::string& sentence, const char* words) {
    EXPECT_NE(sentence.find(words), std::string::npos) << sentence;
  };
  says(scene.ask("a", host::repair(1)), "car a does not live here; spawn it first");
  says(scene.ask("a", host::spawn("ffffffffffffffff", "game")), "asset ffffffffffffffff is not one of this server's");
  scene.spawn("a");
  says(scene.ask("a", host::spawn(box()->hash, "game")), "car a lives already; despawn it first");
  says(scene.ask("b", host::spawn(box()->hash, "other")), "host other would be one more than the 1 hosts");
  scene.spawn("b");
  says(scene.ask("c", host::spawn(box()->hash, "game")), "car c would be one more than the 2 cars");
  says(scene.ask("a", host::parameters([](auto& p) { p.add_yield_strain(2); })),
       "parameters.yield_strain of region 0 is 2; allowed are 0 to 1");
  says(scene.ask("a", host::parameters([](auto& p) { p.add_iterations(0); })), "iterations is 0");
  says(scene.ask("a", host::parameters([](auto& p) { p.add_region(1); })), "this car's regions are 0 to 0");
  EXPECT_EQ(scene.car("a").parameters, Parameters{});
  EXPECT_EQ(scene.ask("a", host::parameters([](auto& p) { p.add_yield_strain(0.5f); })), "");
  EXPECT_EQ(scene.car("a").parameters.region[0].yield_strain, 0.5f);
  EXPECT_EQ(scene.ask("a", host::despawn()), "");
  says(scene.ask("a", host::despawn()), "car a does not live here");
  says(scene.ask("a/b/c", host::despawn()), "key \"car/a/b/c\" is none of");
}

TEST(World, ATickSaysWhichCarsCameWentAndWereReplaced) {
  Scene scene;
  const std::string asset = scene.world->assets.begin()->first;
  const Bytes spawn = host::spawn(asset, "game", pose_at(0)), despawn = host::despawn(), replace = host::replace(asset);
  const auto make = [&](std::initializer_list<std::pair<const char*, Bytes>> commands) {
    Inbox inbox;
    for (const auto& [car, bytes] : commands) inbox.push_back({std::string("car/") + car, bytes});
    return tick(*scene.world, inbox, scene.outbox, 1);
  };
  using Ids = std::vector<std::string>;
  TickResult result = make({{"b", spawn}, {"a", spawn}, {"brief", spawn}, {"brief", despawn}, {"none", despawn}});
  EXPECT_EQ(result.spawned, (Ids{"b", "a"}));
  EXPECT_EQ(result.despawned, Ids{});
  result = make({{"a", despawn}, {"a", spawn}, {"b", replace}, {"b", replace}, {"b", spawn}});
  EXPECT_EQ(result.spawned, Ids{"a"});
  EXPECT_EQ(result.despawned, Ids{"a"});
  EXPECT_EQ(result.replaced, Ids{"b"});
  result = make({{"a", replace}, {"a", despawn}, {"a", spawn}, {"a", despawn}});
  EXPECT_EQ(result.spawned, Ids{});
  EXPECT_EQ(result.despawned, Ids{"a"});
  EXPECT_EQ(result.replaced, Ids{});
  result = make({});
  EXPECT_TRUE(result.spawned.empty() && result.despawned.empty() && result.replaced.empty());
}

TEST(World, SpawnTakesTheBakedMassOrScalesTheBakedInertia) {
  Scene scene;
  scene.spawn("a");
  EXPECT_EQ(scene.car("a").mass.mass, 1200);
  EXPECT_EQ(scene.ask("b", host::spawn(box()->hash, "game", pose_at(0), 2400)), "");
  EXPECT_EQ(scene.car("b").mass.mass, 2400);
  EXPECT_DOUBLE_EQ(scene.car("b").mass.inertia.z(), 2 * scene.car("a").mass.inertia.z());
}

// ---- a crash ----------------------------------------------------------------------------------------------------------------

TEST(World, ACrashDentsTheCarStopsItAndTellsTheHost) {
  Scene scene;
  double impulse = 0;
  uint64_t told = 0;
  crash(scene, 60, [&](const Outbox&) {
    for (const Message* message : scene.sent("host/game/reactions")) {
      const auto* reaction = host::read_as<schema::Reactions>(message->bytes)->cars()->Get(0);
      impulse += double(reaction->impulse()->x());
      ++told;
    }
  });
  const Instance& car = scene.car("a");
  EXPECT_GT(told, 30u) << "a host is told until 30 ticks after the last touch";
  EXPECT_LT(car.motion.velocity.x(), 1) << "a host that follows the reactions is stopped";
  EXPECT_NEAR(impulse, 1200 * (car.motion.velocity.x() - 14), 1200 * 0.01) << "no impulse lost or counted twice";
  EXPECT_LT(car.motion.pose.position.x(), 1.5);
  EXPECT_GT(car.body.absorbed, 0.5 * 0.5 * 1200 * 14 * 14) << "most of the energy stays in the dent";
  EXPECT_TRUE(finite(*scene.world));
}

TEST(World, AHostThatIsStillForAMomentIsToldWhatItMissed) {
  Scene scene;
  crash(scene, 12);
  const auto* reactions = host::read_as<schema::Reactions>(scene.sent("host/game/reactions").at(0)->bytes);
  EXPECT_EQ(reactions->tick(), tick_count(*scene.world));
  EXPECT_EQ(reactions->cars()->Get(0)->car()->str(), "a");
  EXPECT_NEAR(double(reactions->cars()->Get(0)->velocity()->x()), scene.car("a").motion.velocity.x(), 1e-5);
}

constexpr int pile = 40;  // more than a worker takes at once

std::vector<uint64_t> hashes_of_a_pile_up(int threads) {
  Scene scene;
  scene.threads = threads;
  std::vector<uint64_t> hashes;
  Inbox inbox = {
      {"host/game/obstacles", host::obstacles(1, {wall(2.3f), {2, schema::Shape::capsule, {0.2f, 2, 0}, pose_at(2.4, 0.5)}})}};
  for (int k = 0; k < pile; ++k) {
    inbox.push_back({"car/" + std::to_string(k), host::spawn(box()->hash, "game", pose_at(0, 0.06 * k)), uint64_t(k + 1)});
    inbox.push_back({"car/" + std::to_string(k), quick()});
  }
  std::vector<CarPose> cars;
  for (int k = 0; k < pile; ++k) cars.push_back({std::to_string(k), pose_at(0, 0.06 * k), {float(6 + 2 * (k % 6)), 0, 0}});
  inbox.push_back({"host/game/poses", host::poses(1, cars)});
  for (int k = 0; k < 8; ++k) {
    scene.step(k == 0 ? inbox : Inbox{});
    hashes.push_back(hash(*scene.world));
  }
  return hashes;
}

TEST(World, IsTheSameWhetherItWasWarmedUpOrNot) {
  Scene cold, warm;
  warm_up(*warm.world, 2);
  EXPECT_GE(warm.world->workers.size(), 1u);
  crash(cold, 20);
  crash(warm, 20);
  EXPECT_EQ(hash(*warm.world), hash(*cold.world));
}

TEST(World, IsTheSameBitForBitWithOneTwoAndFourThreads) {
  const tbb::global_control four(tbb::global_control::max_allowed_parallelism, 4);
  const auto one = hashes_of_a_pile_up(1);
  EXPECT_EQ(std::adjacent_find(one.begin(), one.end()), one.end()) << "every tick changes the hash";
  EXPECT_EQ(hashes_of_a_pile_up(2), one);
  EXPECT_EQ(hashes_of_a_pile_up(4), one);
}

// ---- what viewers hold ------------------------------------------------------------------------------------------------------

struct Frame {
  uint64_t tick;
  std::vector<Message> messages;
  Message health;
  std::vector<int16_t> surface;  // the server's
};

constexpr size_t levels = surface_levels.size();

// A slow wall presses a heavy car and then goes away. Viewers on each surface level follow it, long enough for keyframes in
// between.
const std::vector<Frame>& film(size_t level) {
  static const auto films = [] {
    Scene scene;
    std::array<std::vector<Frame>, levels> out;
    Thing press = wall(2.25f);
    press.velocity = {-0.4f, 0, 0};
    for (uint64_t k = 0; k < 90; ++k) {
      Inbox inbox;
      if (k == 0) inbox = {{"car/a", host::spawn(box()->hash, "game", pose_at(0), 1e6f)}, {"car/a", quick()}};
      if (k == 2) inbox = {{"host/game/obstacles", host::obstacles(1, {press})}};
      if (k == 80) inbox = {{"host/game/obstacles", host::obstacles(2, {})}};
      inbox.push_back({"host/game/poses", host::poses(k + 1, {{"a"}})});  // scripted, so the car stands
      scene.step(inbox);
      const Message report = health(*scene.world, 0, {});
      for (size_t each = 0; each < levels; ++each) {
        Frame frame{tick_count(*scene.world), {}, report, scene.car("a").told[each].latest};
        for (const Message& message : scene.outbox) {
          if (message.key.starts_with("car/a/") && message.key.ends_with("/" + std::to_string(each)))
            frame.messages.push_back(message);
        }
        out[each].push_back(frame);
      }
    }
    return out;
  }();
  return films[level];
}

bool is_key(const Message& message) { return message.key.starts_with("car/a/key/"); }

host::Viewer viewer_of(size_t level) { return {{}, std::to_string(level)}; }

TEST(Viewers, AnIdleCarSendsItsKeyframeAndThenNothing) {
  Scene scene;
  scene.spawn("a");
  for (const char* level : {"0", "1"}) EXPECT_EQ(scene.sent(std::string("car/a/key/") + level).size(), 1u);
  for (int k = 0; k < 100; ++k) EXPECT_TRUE(scene.step().empty());
}

TEST(Viewers, ALateJoinerHoldsTheSurfaceAfterTheKeyframeAndAnyLaterDelta) {
  for (size_t level = 0; level < levels; ++level) {
    size_t joined = 0, keyframes = 0;
    Message keyframe;
    for (const Frame& frame : film(level)) {
      for (const Message& message : frame.messages) {
        if (is_key(message)) {
          keyframe = message;
          ++keyframes;
          continue;
        }
        host::Viewer joiner = viewer_of(level);
        joiner.take(keyframe);
        joiner.take(message);
        ASSERT_EQ(joiner.held(), frame.surface) << "tick " << frame.tick;
        ASSERT_EQ(joiner.surface.tick, frame.tick);
        ASSERT_EQ(joiner.surface.hash, surface_hash(std::span<const int16_t>(frame.surface)));
        ++joined;
      }
    }
    EXPECT_GT(joined, 60 / surface_levels[level].ticks);
    EXPECT_EQ(keyframes, 3u) << "at spawn, after 60 ticks of deltas, and when the car has come to rest";
    const std::vector<int16_t>& dent = film(level).back().surface;
    EXPECT_LT(*std::min_element(dent.begin(), dent.end()), -800 / surface_levels[level].quanta)
        << "0.4 m in quanta of 0.5 mm, or in as many more of the level's";
  }
}

TEST(Viewers, LostAndRepeatedDeltasDoNotMatter) {
  for (size_t level = 0; level < levels; ++level) {
    host::Viewer all = viewer_of(level), some = all;
    int count = 0;
    for (const Frame& frame : film(level)) {
      for (const Message& message : frame.messages) {
        all.take(message);
        if (!is_key(message) && ++count % 3 == 0) continue;  // lost
        some.take(message);
        some.take(message);
        ASSERT_EQ(some.held(), all.held()) << "tick " << frame.tick;
      }
      ASSERT_EQ(all.held(), frame.surface) << "tick " << frame.tick;
    }
  }
}

// The distance of a viewer's surface from the body, m: on one axis of one node of the skin.
float farthest_off(const Instance& car, const viewer::Surface& held) {
  float most = 0;
  for (size_t i = 0; i < car.car->skin_node.size(); ++i) {
    const uint32_t node = car.car->skin_node[i];
    const Vec3 moved = car.body.node[node] - car.car->model.node[node];
    for (int axis = 0; axis < 3; ++axis)
      most = std::max(most, std::fabs(held.quantum * float(held.quanta[3 * i + size_t(axis)]) - moved[axis]));
  }
  return most;
}

TEST(Viewers, FarAreToldTenTimesASecondInFewerBits) {
  std::array<size_t, levels> bytes{};
  std::vector<uint64_t> ticks;
  for (size_t level = 0; level < levels; ++level) {
    for (const Frame& frame : film(level)) {
      for (const Message& message : frame.messages) {
        if (is_key(message)) continue;
        bytes[level] += message.bytes.size();
        if (level == 1) ticks.push_back(frame.tick);
      }
    }
  }
  ASSERT_GT(ticks.size(), 10u);
  for (size_t i = 1; i < ticks.size(); ++i) EXPECT_EQ(ticks[i] % 6, ticks[0] % 6);
  EXPECT_LT(8 * bytes[1], bytes[0]);
}

TEST(Viewers, OnAnyLevelHoldTheSurfaceWithinHalfAQuantumInTheTickInWhichItComesToRest) {
  for (uint64_t turn = 0; turn < surface_levels[1].ticks; ++turn) {
    Scene scene;
    for (uint64_t k = 0; k < turn; ++k) scene.step();
    std::array<host::Viewer, levels> viewers{viewer_of(0), viewer_of(1)};
    size_t at_rest = 0;
    crash(scene, 60, [&](const Outbox& outbox) {
      for (host::Viewer& viewer : viewers)
        for (const Message& message : outbox) viewer.take(message);
      if (!scene.car("a").body.settled) return;
      ++at_rest;
      for (size_t level = 0; level < levels; ++level)
        ASSERT_LE(farthest_off(scene.car("a"), viewers[level].surface), 0.501f * 0.0005f * float(surface_levels[level].quanta))
            << "tick " << tick_count(*scene.world) << ", level " << level;
    });
    EXPECT_GT(at_rest, 10u);
    EXPECT_LT(at_rest, 60u);
    EXPECT_FLOAT_EQ(viewers[1].surface.quantum, 8 * viewers[0].surface.quantum);
    for (const host::Viewer& viewer : viewers) EXPECT_EQ(viewer.key(), viewer.held()) << "the last message is a keyframe";
  }
}

TEST(Viewers, OnAnyLevelAreToldAtOnceOfACarThatIsSpawnedIntoAWall) {
  for (uint64_t turn = 0; turn < surface_levels[1].ticks; ++turn) {
    Scene scene;
    for (uint64_t k = 0; k < turn; ++k) scene.step();
    scene.step({{"host/game/obstacles", host::obstacles(1, {wall(2)})}});
    scene.step({{"car/a", host::spawn(box()->hash, "game")}, {"car/a/key/0", {}, 77}, {"car/a/key/1", {}, 78}});
    ASSERT_FALSE(scene.car("a").body.settled);
    for (const char* level : {"0", "1"}) EXPECT_EQ(scene.sent(std::string("car/a/key/") + level).size(), 1u);
    EXPECT_EQ(std::count_if(scene.outbox.begin(), scene.outbox.end(), [](const Message& m) { return m.ticket != 0; }), 2);
  }
}

TEST(Viewers, CarsThatCrashAtOnceTellTheFarOnesInTurns) {
  Scene scene;
  constexpr int many = 30;
  std::vector<CarPose> cars;
  for (int k = 0; k < many; ++k) {
    const std::string id = "c" + std::to_string(k);
    scene.spawn(id);
    scene.step({{"car/" + id, quick()}});
    cars.push_back({id, pose_at(0), {14, 0, 0}});
  }
  scene.step({{"host/game/obstacles", host::obstacles(1, {wall(2.35f)})}});
  size_t told = 0, most = 0;
  for (uint64_t k = 0; k < 12; ++k) {
    scene.step({{"host/game/poses", host::poses(k + 1, cars)}});
    size_t now = 0;
    for (const Message& message : scene.outbox) now += message.key.ends_with("/delta/1");
    told += now;
    most = std::max(most, now);
  }
  EXPECT_GE(told, size_t(many)) << "each of them";
  EXPECT_LE(most, size_t(many) / 6);
}

// A viewer behind a bad link: messages are lost, repeated, and late by up to two seconds, so that they overtake each other; so
// are queries and answers. The viewer asks when it lacks a keyframe, and when it has heard nothing for half a second, like the
// client library.
struct Weather {
  std::mt19937 random;
  size_t level;
  double loss;
  uint64_t latest;  // ticks
  std::multimap<uint64_t, const Message*> flying;
  std::multimap<uint64_t, bool> questions;
  host::Viewer viewer;
  uint64_t heard = 0, asked = 0;
  bool unsure = true;

  Weather(unsigned seed, size_t level_) : random(seed), level(level_), loss(0.009 * double(seed % 100)), latest(seed % 120) {}
  bool lucky() { return std::uniform_real_distribution<double>()(random) >= loss; }
  uint64_t delay() { return random() % 4 == 0 ? random() % (latest + 1) : random() % 3; }
  void send(uint64_t now, const Message& message) {
    for (int copies = random() % 8 == 0 ? 2 : 1; copies > 0; --copies) {
      if (lucky()) flying.emplace(now + delay(), &message);
    }
  }
  void ask(uint64_t now) {
    if (asked > 0 && now < asked + 60) return;  // an answer may still come
    asked = now;
    unsure = false;
    if (lucky()) questions.emplace(now + delay(), true);
  }
  void take_health(uint64_t now, const Message& message) {
    for (const auto* told : *host::read_as<schema::Health>(message.bytes)->told()) {
      const bool older = viewer.held().empty() || viewer.surface.tick < told->ticks()->Get(uint32_t(level));
      if (told->car()->str() == "a" && older && now > heard + 6) ask(now);
    }
  }
  void take(uint64_t now, const Message& message) {
    if (message.key == "health") return take_health(now, message);
    const std::span bytes(reinterpret_cast<const uint8_t*>(message.bytes.data()), message.bytes.size());
    const viewer::Outcome outcome =
        is_key(message) ? viewer::apply_keyframe(bytes, viewer.surface) : viewer::apply_delta(bytes, viewer.surface);
    ASSERT_NE(outcome.applied, viewer::Applied::refused) << outcome.why;
    heard = now;
    unsure = true;
    if (outcome.applied == viewer::Applied::missing_keyframe) ask(now);
  }
};

void weather_on(size_t level) {
  std::map<uint64_t, const Frame*> frames;
  for (const Frame& frame : film(level)) frames[frame.tick] = &frame;
  const uint64_t last = film(level).back().tick;
  size_t seen = 0;
  for (unsigned seed = 0; seed < 1000; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Weather weather(seed, level);
    const Message* keyframe = nullptr;
    uint64_t held = 0;
    const uint64_t joined = seed % 7 == 0 ? weather.random() % last : 0;
    for (uint64_t now = 1; now < last + 600; ++now) {
      if (now == last + 300) weather.loss = 0;  // calm
      if (now % 60 == 0) weather.send(now, frames.at(std::min(now, last))->health);
      if (const auto frame = frames.find(now); frame != frames.end()) {
        for (const Message& message : frame->second->messages) {
          if (is_key(message)) keyframe = &message;
          if (now >= joined) weather.send(now, message);
        }
      }
      if (now == joined || (weather.unsure && now > weather.heard + 30)) weather.ask(now);
      for (auto one = weather.questions.begin(); one != weather.questions.end() && one->first <= now;) {
        if (keyframe && weather.lucky()) weather.flying.emplace(now + weather.delay(), keyframe);
        one = weather.questions.erase(one);
      }
      while (!weather.flying.empty() && weather.flying.begin()->first <= now) {
        weather.take(now, *weather.flying.begin()->second);
        weather.flying.erase(weather.flying.begin());
      }
      if (weather.viewer.held().empty()) continue;
      const uint64_t tick = weather.viewer.surface.tick;
      ASSERT_GE(tick, held);
      ASSERT_EQ(weather.viewer.held(), frames.at(tick)->surface);
      seen += tick > held;
      held = tick;
    }
    ASSERT_EQ(weather.viewer.held(), film(level).back().surface) << "held " << held << " of " << last;
  }
  EXPECT_GT(seen, 10'000 / surface_levels[level].ticks);
}

TEST(Viewers, InAnyWeatherHoldNothingThatTheServerNeverHadAndAreEqualAfterwards) {
  for (size_t level = 0; level < levels; ++level) {
    SCOPED_TRACE("level " + std::to_string(level));
    weather_on(level);
  }
}

TEST(Viewers, AKeyframeIsAnsweredWholeAndFitsTheDeltasThatFollow) {
  Scene scene;
  crash(scene, 1);
  for (size_t level = 0; level < levels; ++level) {
    const std::string is = std::to_string(level);
    scene.step({{"car/a/key/" + is, {}, 77 + level}});
    host::Viewer viewer = viewer_of(level);
    for (const Message& message : scene.outbox) {
      if (message.ticket != 77 + level) continue;
      EXPECT_FALSE(message.failed);
      viewer.take_keyframe(message.bytes);
    }
    ASSERT_EQ(viewer.key().size(), 3 * box()->skin_node.size());
    for (uint64_t k = 1; k < surface_levels[level].ticks && scene.sent("car/a/delta/" + is).empty(); ++k) scene.step();
    ASSERT_EQ(scene.sent("car/a/delta/" + is).size(), 1u);
    viewer.take(*scene.sent("car/a/delta/" + is)[0]);
    EXPECT_EQ(viewer.held(), scene.car("a").told[level].latest);
  }
  for (int k = 0; k < 600 && !scene.car("a").body.settled; ++k) scene.step();
  for (size_t level = 0; level < levels; ++level) {
    scene.step({{"car/a/key/" + std::to_string(level), {}, 66}});
    host::Viewer viewer = viewer_of(level);
    for (const Message& message : scene.outbox)
      if (message.ticket == 66) viewer.take_keyframe(message.bytes);
    EXPECT_EQ(viewer.held(), scene.car("a").told[level].latest);
  }
  scene.step({{"car/b/key/0", {}, 99}});
  const auto answer = std::find_if(scene.outbox.begin(), scene.outbox.end(), [](const Message& m) { return m.ticket == 99; });
  ASSERT_NE(answer, scene.outbox.end());
  EXPECT_TRUE(answer->failed);
  EXPECT_EQ(host::read_as<schema::Answer>(answer->bytes)->sentence()->str(), "car b does not live here; it has no keyframe");
}

// ---- save, load, repair
// -------------------------------------------------------------------------------------------------------

TEST(State, SavedAtRestAndLoadedItIsTheSameBodyBitForBit) {
  Scene scene;
  crash(scene, 40);
  ASSERT_TRUE(scene.car("a").body.settled);
  Bytes saved, again;
  ASSERT_EQ(scene.ask("a", host::save(), &saved), "");
  Scene other;
  other.spawn("b");
  ASSERT_EQ(other.ask("b", host::load(saved)), "");
  EXPECT_EQ(other.sent("car/b/key/0").size(), 1u) << "viewers are told at once";
  EXPECT_EQ(other.car("b").told[0].latest, scene.car("a").told[0].latest);
  const DeformableState& crashed = scene.car("a").body;
  DeformableState body = make_body(box()->model);  // everything except the memory of the last sub-step, which Save leaves out
  body.node = crashed.node;
  body.gradients = crashed.gradients;
  body.hardening = crashed.hardening;
  body.edge_rest = crashed.edge_rest;
  body.tet_rest = crashed.tet_rest;
  body.absorbed = crashed.absorbed;
  body.stored = crashed.stored;
  measure_reach(box()->model, body);
  EXPECT_EQ(hash(other.car("b").body), hash(body));
  ASSERT_EQ(other.ask("b", host::save(), &again), "");
  EXPECT_EQ(saved, again);
}

TEST(State, AWorldSavedInMidCrashGoesOnBitForBit) {
  Scene scene;
  scene.spawn("idle", "other", pose_at(0, 20));
  crash(scene, 3);
  ASSERT_FALSE(scene.car("a").body.settled);
  const Bytes bytes = save_world(*scene.world);
  EXPECT_LT(bytes.size(), 100'000u) << "the car that nothing touched took room for its body";
  Scene copy;
  copy.spawn("old");  // is despawned
  load_world(bytes, *copy.world);
  EXPECT_EQ(cars(*copy.world), cars(*scene.world));
  for (uint64_t k = 0; k < 90; ++k) {
    Inbox inbox;
    if (k <= 30) inbox = {{"host/game/poses", host::poses(1'000 + k, {{"a", pose_at(-10), {k < 30 ? 0.0f : 14.0f, 0, 0}}})}};
    const Outbox told = scene.step(inbox), told_by_copy = copy.step(inbox);
    ASSERT_EQ(hash(*copy.world), hash(*scene.world)) << "tick " << k;
    ASSERT_EQ(told.size(), told_by_copy.size());
    for (size_t m = 0; m < told.size(); ++m) ASSERT_EQ(told[m].bytes, told_by_copy[m].bytes) << told[m].key;
  }
  EXPECT_GT(scene.car("a").touched_tick, 40u) << "it crashed once more";
}

TEST(Uploaded, ACarThatCameByAMessageIsSpawnedAndEveryReplicaHasIt) {
  const auto painted = box_car({2, 2, 2});
  Scene scene, replica;
  const Inbox inboxes[] = {
      {{"car/a", host::spawn(painted->hash, "game"), 1}},  // not uploaded yet
      {{"asset", host::asset(*painted), 2}, {"car/a", host::spawn(painted->hash, "game"), 3}},
      {},
  };
  for (const Inbox& inbox : inboxes) {
    scene.step(inbox);
    replica.step(inbox);
    EXPECT_EQ(hash(*scene.world), hash(*replica.world));
  }
  EXPECT_EQ(cars(*scene.world), std::vector<std::string>{"a"});
  EXPECT_EQ(uploaded_cars(*scene.world).size(), 1u);
  Scene late;
  load_world(save_world(*scene.world), *late.world);
  EXPECT_EQ(hash(*late.world), hash(*scene.world));
  EXPECT_EQ(late.ask("b", host::spawn(painted->hash, "game")), "");
}

TEST(State, AReplacedCarIsUndamagedAndKeepsTheRest) {
  const auto painted = box_car({2, 2, 2});
  Scene scene;
  ASSERT_EQ(scene.ask("a", host::spawn(box()->hash, "game", pose_at(0), 900)), "");
  ASSERT_EQ(scene.ask("a", host::parameters([](auto& p) { p.add_yield_strain(0.02f); })), "");
  scene.step({{"host/game/obstacles", host::obstacles(1, {wall(2.35f)})},
              {"host/game/poses", host::poses(1, {{"a", pose_at(0), {14, 0, 0}, {0, 0, 0}, 0, 0.5f}})}});
  for (int k = 0; k < 10; ++k) scene.step();
  scene.step({{"host/game/obstacles", host::obstacles(2, {})},
              {"host/game/poses", host::poses(2, {{"a", pose_at(-9, 1), {0, 6, 0}, {0, 0, 1}, 0, 0.5f}})},
              {"asset", host::asset(*painted), 1}});
  Instance before = scene.car("a");
  ASSERT_NE(before.told[0].latest, std::vector<int16_t>(before.told[0].latest.size()));
  EXPECT_TRUE(contains(scene.ask("a", host::replace(cell()->hash)), "replace: asset " + cell()->hash + " is not one of"));
  before.motion = scene.car("a").motion;
  ASSERT_EQ(scene.ask("a", host::replace(painted->hash)), "");

  const Instance& now = scene.car("a");
  EXPECT_EQ(now.car->hash, painted->hash);
  EXPECT_EQ(hash(now.body), hash(make_body(painted->model)));
  EXPECT_EQ(now.host, "game");
  EXPECT_EQ(now.parameters, before.parameters);
  EXPECT_EQ(now.importance, 0.5f);
  EXPECT_EQ(now.mass.mass, 900);
  EXPECT_EQ(now.mass.inertia, before.mass.inertia);
  EXPECT_EQ(now.mass.center, before.mass.center);
  EXPECT_EQ(now.motion.velocity, before.motion.velocity);
  EXPECT_NEAR(now.motion.pose.position.y(), before.motion.pose.position.y() + 0.1, 1e-9);
  for (const char* level : {"0", "1"}) {
    host::Viewer viewer{{}, level};
    for (const Message& message : scene.outbox) viewer.take(message);
    EXPECT_EQ(viewer.surface.asset, painted->hash);
    EXPECT_EQ(viewer.held(), std::vector<int16_t>(3 * painted->skin_node.size()));
  }
  Scene late;
  load_world(save_world(*scene.world), *late.world);
  late.step();
  scene.step();
  EXPECT_EQ(hash(*late.world), hash(*scene.world));
}

TEST(Uploaded, WhatIsNoCarIsRefusedAndChangesNothing) {
  Scene scene, calm;
  Bytes damaged = host::asset(*box());
  damaged.resize(damaged.size() / 2);
  const auto sentence = [&](const Bytes& bytes) {
    scene.step({{"asset", bytes, 1}});
    calm.step();
    EXPECT_EQ(hash(*scene.world), hash(*calm.world));
    const auto* answer = host::read_as<schema::Answer>(scene.outbox.front().bytes);
    return answer->ok() ? std::string() : answer->sentence()->str();
  };
  EXPECT_TRUE(contains(sentence(damaged), "asset"));
  host::Builder builder;
  const std::vector<uint8_t> noise(100, 7);
  EXPECT_TRUE(contains(sentence(host::done(builder, schema::CreateAssetDirect(builder, &noise))), "asset"));
}

TEST(Uploaded, TheOldestThatNobodyDrivesGoesForANewOne) {
  Scene scene;
  std::vector<std::shared_ptr<const Car>> given;
  for (int cells = 1; cells <= 18; ++cells) {
    given.push_back(box_car({cells, 1, 3}));
    scene.step({{"asset", host::asset(*given.back()), 1}});
    if (cells == 1) {
      EXPECT_EQ(scene.ask("driven", host::spawn(given.front()->hash, "game")), "");
    }
  }
  EXPECT_EQ(uploaded_cars(*scene.world).size(), 16u);
  EXPECT_EQ(scene.ask("again", host::spawn(given[0]->hash, "game")), "");
  EXPECT_TRUE(contains(scene.ask("gone", host::spawn(given[1]->hash, "game")), "not one of this server's"));
  EXPECT_EQ(scene.ask("newest", host::spawn(given.back()->hash, "game")), "");
}

TEST(State, TheSumOfACarThatRestsAgainstAWallIsItsBodysWhateverTheWallDoes) {
  Scene scene;
  scene.spawn("a");
  Thing wall{1, schema::Shape::box, {0.5f, 5, 5}, pose_at(2.8, 0, 1)};
  scene.step({{"host/game/obstacles", host::obstacles(1, {wall})},
              {"host/game/poses", host::poses(1, {{"a", pose_at(0), {12, 0, 0}}})}});
  const auto rests = [&] { return scene.car("a").body.settled && scene.car("a").body.touching; };
  // Scripted, because otherwise it would spring back from the wall.
  for (int k = 0; k < 200 && !rests(); ++k)
    scene.step({{"host/game/poses", host::poses(2 + k, {{"a", pose_at(0.3), {0, 0, 0}}})}});
  ASSERT_TRUE(rests());
  int unsolved = 0;
  for (int k = 0; k < 60; ++k) {
    wall.velocity = {k < 30 ? -0.003f : k < 40 ? 0.0f : 0.5f, 0, 0};
    wall.pose = schema::Pose({float(scene.world->obstacles[0].pose.position.x()), 0, 1}, wall.pose.orientation());
    const DeformableState before = scene.car("a").body;
    scene.step({{"host/game/obstacles", host::obstacles(2 + k, {wall})}});
    unsolved += scene.car("a").result.substeps == 0 && hash(scene.car("a").body) != hash(before);
    ASSERT_EQ(scene.car("a").hashes.body, hash(scene.car("a").body)) << k;
  }
  EXPECT_GT(unsolved, 0) << "the wall went along a body that slept";
}

TEST(State, ADamagedWorldIsRefusedAndLeavesNothing) {
  Scene scene;
  crash(scene, 6);
  const Bytes bytes = save_world(*scene.world);
  Scene copy;
  for (size_t size = 0; size < bytes.size(); size += 1 + bytes.size() / 500) {
    EXPECT_THROW(load_world(std::span(bytes).first(size), *copy.world), std::runtime_error) << size << " bytes";
    EXPECT_TRUE(cars(*copy.world).empty());
  }
  std::mt19937 random(1);
  for (int k = 0; k < 500; ++k) {
    Bytes damaged = bytes;
    damaged[random() % damaged.size()] ^= std::byte(1 << random() % 8);
    EXPECT_THROW(load_world(damaged, *copy.world), std::runtime_error);
    EXPECT_TRUE(cars(*copy.world).empty());
  }
  Scene without(cell());
  EXPECT_THROW(load_world(bytes, *without.world), std::runtime_error) << "an asset that is not there";
}

// An attacker can also forge the checksum. A foreign recording must not end the program that replays it.
TEST(State, AWorldThatNoTickCanBeMadeOfIsRefused) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  using Change = std::function<void(World&, Instance&)>;
  const std::pair<const char*, Change> changes[] = {
      {"more obstacles than there are", [](World& w, Instance&) { w.hosts.at("game").obstacles = 9; }},
      {"fewer cars than there are", [](World& w, Instance&) { w.hosts.at("game").cars = 0; }},
      {"a host that is not there", [](World&, Instance& c) { c.host = "nobody"; }},
      {"the id of a car", [](World& w, Instance& c) { w.cars["a/b"] = c, ++w.hosts.at("game").cars; }},
      {"no sub-steps", [](World&, Instance& c) { c.parameters.substeps = 0; }},
      {"a solver", [](World&, Instance& c) { c.parameters.solver = Solver(7); }},
      {"sweeps of no sub-step", [](World&, Instance& c) { c.result.substeps = 0; }},
      {"more sweeps than there can be", [](World&, Instance& c) { c.result.sweeps = UINT32_MAX; }},
      {"a velocity", [&](World&, Instance& c) { c.motion.velocity.x() = nan; }},
      {"an orientation", [](World&, Instance& c) { c.motion.pose.orientation.w() = 9; }},
      {"a mass", [](World&, Instance& c) { c.mass.mass = 0; }},
      {"no keyframe", [](World&, Instance& c) { c.told[1].keyframe.clear(); }},
      {"a keyframe of the future", [](World&, Instance& c) { c.told[1].keyframe_tick = 99; }},
      {"a body without steps", [](World&, Instance& c) { c.body.step.clear(); }},
      {"a node", [&](World&, Instance& c) { c.body.node[1].x() = float(nan); }},
      {"the solver's steps: too short", [](World&, Instance& c) { c.body.history.residual[0].pop_back(); }},
      {"the solver's steps: none before the next",
       [](World&, Instance& c) { c.body.history.count = 0, c.body.history.next = 3; }},
      {"an obstacle", [&](World& w, Instance&) { w.obstacles.at(0).pose.position.x() = nan; }},
      {"the end of time", [](World& w, Instance&) { w.tick = UINT64_MAX; }},
  };
  Scene scene;
  crash(scene, 3);
  const Bytes good = save_world(*scene.world);
  for (const auto& [what, change] : changes) {
    Scene changed, copy;
    load_world(good, *changed.world);
    ASSERT_GT(changed.car("a").body.history.count, 0);
    change(*changed.world, changed.car("a"));
    const std::string why = refusal([&] { load_world(save_world(*changed.world), *copy.world); });
    EXPECT_NE(why.find("damaged: "), std::string::npos) << what;
    EXPECT_EQ(why.find("sum"), std::string::npos) << what;
    EXPECT_TRUE(cars(*copy.world).empty());
  }
}

TEST(State, SavedInMidCrashAndLoadedInTwoWorldsTheyStayTheSame) {
  Scene crashed;
  crash(crashed, 1);
  ASSERT_FALSE(crashed.car("a").body.settled);
  Bytes saved;
  ASSERT_EQ(crashed.ask("a", host::save(), &saved), "");
  uint64_t hashes[2];
  for (uint64_t& sum : hashes) {
    Scene scene;
    scene.spawn("a");
    ASSERT_EQ(scene.ask("a", host::load(saved)), "");
    for (int k = 0; k < 5; ++k) scene.step();
    sum = hash(*scene.world);
  }
  EXPECT_EQ(hashes[0], hashes[1]);
}

TEST(State, AnUndamagedCarIsTheSameAfterSaveLoadAndRepair) {
  Scene scene, plain;
  scene.spawn("a");
  plain.spawn("a");
  Bytes saved;
  ASSERT_EQ(scene.ask("a", host::save(), &saved), "");
  ASSERT_EQ(scene.ask("a", host::load(saved)), "");
  ASSERT_EQ(scene.ask("a", host::repair(1)), "");
  for (int k = 0; k < 3; ++k) plain.step();
  EXPECT_EQ(hash(scene.car("a").body), hash(plain.car("a").body));
}

TEST(State, RepairGivesBackTheUndamagedSurface) {
  Scene scene;
  crash(scene, 60);
  scene.step({{"host/game/obstacles", host::obstacles(2, {})}});
  ASSERT_EQ(scene.ask("a", host::repair(1)), "");
  const auto& surface = scene.car("a").told[0].latest;
  EXPECT_EQ(std::count(surface.begin(), surface.end(), 0), ptrdiff_t(surface.size()));
  EXPECT_EQ(scene.car("a").body.node, make_body(box()->model).node);
  for (const char* level : {"0", "1"}) EXPECT_EQ(scene.sent(std::string("car/a/key/") + level).size(), 1u);
}

TEST(State, OfAnotherCarIsRefusedAndLeavesTheCarAsItWas) {
  Scene scene, other(cell());
  scene.spawn("a");
  other.spawn("a");
  Bytes saved;
  ASSERT_EQ(other.ask("a", host::save(), &saved), "");
  const uint64_t before = hash(scene.car("a").body);
  EXPECT_NE(scene.ask("a", host::load(saved)).find("load.state.asset is " + cell()->hash), std::string::npos);
  EXPECT_EQ(scene.refused(Reason::bad_state), 1u);
  EXPECT_EQ(hash(scene.car("a").body), before);
}

// ---- health -----------------------------------------------------------------------------------------------------------------

TEST(Health, ShowsRefusalsByReasonCountsAgainstLimitsAndTimesByRoom) {
  Scene scene;
  std::atomic<int> now = 0;
  set_clock(*scene.world, [&] { return 0.001 * now++; });
  crash(scene, 10);
  scene.step({{"host/game/poses", Bytes(7)}, {"nonsense", {}}});
  const Message message = health(*scene.world, 3, {{"dropped", 4}});
  EXPECT_EQ(message.key, "health");
  const auto* health = host::read_as<schema::Health>(message.bytes);
  std::map<std::string, uint64_t> counts, refusals;
  std::map<std::string, float> rooms;
  for (const auto* count : *health->counts()) counts[count->name()->str()] = count->value();
  for (const auto* count : *health->refusals()) refusals[count->name()->str()] = count->value();
  for (const auto* room : *health->rooms()) rooms[room->name()->str()] = room->milliseconds();
  EXPECT_EQ(health->tick(), tick_count(*scene.world));
  EXPECT_EQ(health->late(), 3u);
  EXPECT_EQ(counts["cars"], 1u);
  EXPECT_EQ(counts["obstacles"], 1u);
  EXPECT_EQ(counts["dropped"], 4u);
  EXPECT_EQ(refusals["malformed"], 1u);
  EXPECT_EQ(refusals["bad_key"], 1u);
  EXPECT_EQ(refusals["out_of_range"], 0u);
  for (const char* room : {"decode", "contacts", "solve", "flow", "surface", "tick"}) EXPECT_GT(rooms[room], 0) << room;
  EXPECT_EQ(refusal_count(*scene.world), 2u);
}

TEST(Health, NamesTheCarsThatViewersWereToldOfForTenSeconds) {
  Scene scene;
  crash(scene, 1);
  const auto told = [&] {
    std::map<std::string, std::vector<uint64_t>> out;
    const Message message = health(*scene.world, 0, {});
    for (const auto* car : *host::read_as<schema::Health>(message.bytes)->told())
      out[car->car()->str()].assign(car->ticks()->begin(), car->ticks()->end());
    return out;
  };
  std::vector<uint64_t> last = told()["a"];
  ASSERT_EQ(last.size(), levels);
  EXPECT_EQ(last[0], tick_count(*scene.world));
  EXPECT_LT(last[1], last[0]) << "not its turn";
  while (tick_count(*scene.world) < std::max(last[0], last[1]) + 600) {
    scene.step();
    for (size_t level = 0; level < levels; ++level)
      for (const char* kind : {"car/a/key/", "car/a/delta/"})
        if (!scene.sent(kind + std::to_string(level)).empty()) last[level] = tick_count(*scene.world);
    ASSERT_EQ(told()["a"], last);
  }
  EXPECT_EQ(told().size(), 1u);
  scene.step();
  EXPECT_TRUE(told().empty());
}

TEST(Health, TheClockHasNoInfluenceOnTheWorld) {
  Scene timed, plain;
  set_clock(*timed.world, [] { return 1.0; });
  crash(timed, 10);
  crash(plain, 10);
  EXPECT_EQ(hash(*timed.world), hash(*plain.world));
}

// ---- hostile ----------------------------------------------------------------------------------------------------------------

struct Sample {
  const char* name;
  std::string key;
  Bytes bytes;
};

// One message of each kind, as small as it can be without losing a field.
std::vector<Sample> samples() {
  Scene scene(cell());
  scene.spawn("a");
  Bytes state;
  scene.ask("a", host::save(), &state);
  Thing hull{4, schema::Shape::hull};
  hull.points = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  return {
      {"poses", "host/game/poses", host::poses(9, {{"a", pose_at(0.1), {1, 2, 3}, {0, 0, 1}, 1}, {"b"}}, 2)},
      {"obstacles", "host/game/obstacles", host::obstacles(9, {wall(2.0f), hull})},
      {"spawn", "car/c", host::spawn(cell()->hash, "game", pose_at(1), 900)},
      {"despawn", "car/a", host::despawn()},
      {"repair", "car/a", host::repair(0.5f)},
      {"parameters", "car/a", host::parameters([](auto& p) {
         p.add_solver(schema::Solver::nodal);
         p.add_iterations(4);
         p.add_region(0);
         p.add_young_modulus(1e6f);
         p.add_yield_strain(0.1f);
       })},
      {"budget", "budget", budget_message(1).bytes},
      {"save", "car/a", host::save()},
      {"load", "car/a", host::load(state)},
  };
}

// A car in a crash, so that accepted messages reach all stages; with one sub-step in a tick, because there are thousands of
// ticks.
Scene hit_scene() {
  Scene scene(cell(), {}, 960);
  scene.step({{"car/a", host::spawn(cell()->hash, "game")},
              {"car/a", host::parameters([](auto& p) { p.add_iterations(1); })},
              {"host/game/obstacles", host::obstacles(1, {wall(2.255f)})},
              {"host/game/poses", host::poses(1, {{"a", pose_at(0), {9, 0, 0}}})}});
  return scene;
}

void expect_survives(const Sample& sample, const Bytes& bytes, uint64_t spared) {
  Scene scene = hit_scene();
  scene.step({{sample.key, bytes, 5}});
  ASSERT_EQ(std::count_if(scene.outbox.begin(), scene.outbox.end(), [](const Message& message) { return message.ticket == 5; }),
            1);
  const bool some_taken =
      scene.refused(Reason::unknown_car) + scene.refused(Reason::not_owner) > 0;  // because of some cars of the Poses
  if (refusal_count(*scene.world) > 0 && !some_taken) {
    ASSERT_EQ(hash(*scene.world), spared) << last_refusal(*scene.world);
  }
  scene.step();
  ASSERT_EQ(tick_count(*scene.world), 3u);
  ASSERT_TRUE(finite(*scene.world));
}

// The hash of the world without the message.
uint64_t spared_hash() {
  Scene scene = hit_scene();
  scene.step();
  EXPECT_TRUE(scene.car("a").body.touching);
  return hash(*scene.world);
}

TEST(Hostile, EveryPrefixOfEveryMessageIsRefusedOrTakenWhole) {
  const uint64_t spared = spared_hash();
  for (const Sample& sample : samples()) {
    for (size_t size = 0; size < sample.bytes.size(); ++size) {
      expect_survives(sample, Bytes(sample.bytes.begin(), sample.bytes.begin() + ptrdiff_t(size)), spared);
      if (HasFatalFailure()) FAIL() << sample.name << " cut to " << size << " bytes";
    }
  }
}

TEST(Hostile, EverySingleBitFlipOfEveryMessageIsRefusedOrTakenWhole) {
  const uint64_t spared = spared_hash();
  for (const Sample& sample : samples()) {
    for (size_t bit = 0; bit < 8 * sample.bytes.size(); ++bit) {
      Bytes bytes = sample.bytes;
      bytes[bit / 8] ^= std::byte(1u << (bit % 8));
      expect_survives(sample, bytes, spared);
      if (HasFatalFailure()) FAIL() << sample.name << " with bit " << bit << " flipped";
    }
  }
}

// 64 MB of inputs could name one payload a million times, and a standby would copy each.
TEST(Hostile, InputsThatShareOnePayloadAreRefused) {
  flatbuffers::FlatBufferBuilder builder;
  const auto payload = builder.CreateVector(std::vector<uint8_t>(1 << 20));
  const auto key = builder.CreateString("host/h/poses");
  const std::vector<flatbuffers::Offset<schema::Input>> once = {schema::CreateInput(builder, key, payload)};
  const Bytes one = finish(builder, schema::CreateInputsDirect(builder, 7, &once));
  EXPECT_TRUE(read_inputs(one));
  builder.Clear();
  const auto again = builder.CreateVector(std::vector<uint8_t>(1 << 20));
  const auto name = builder.CreateString("host/h/poses");
  const std::vector<flatbuffers::Offset<schema::Input>> shared(100, schema::CreateInput(builder, name, again));
  EXPECT_FALSE(read_inputs(finish(builder, schema::CreateInputsDirect(builder, 7, &shared))));
}

TEST(Hostile, ARefusedMessageLeavesTheWorldAsItWas) {
  Scene hit, spared;
  for (Scene* scene : {&hit, &spared}) crash(*scene, 10);
  for (const Sample& sample : samples()) hit.step({{sample.key, Bytes(sample.bytes.begin(), sample.bytes.begin() + 9)}});
  for (size_t k = 0; k < samples().size(); ++k) spared.step();
  EXPECT_EQ(refusal_count(*hit.world), samples().size());
  EXPECT_EQ(hash(*hit.world), hash(*spared.world));
}

}  // namespace
}  // namespace crumple

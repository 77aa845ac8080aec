// Tests cars of one world that meet: two hosts in one crash, parked cars, and cars that were spawned inside each other.
#include "tick/islands.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <deque>
#include <map>

#include "box_car.h"
#include "host.h"
#include "tick/budget.h"
#include "tick/hash.h"
#include "tick/health.h"
#include "tick/inputs.h"
#include "tick/levels.h"
#include "tick/snapshot.h"
#include "tick/state.h"

namespace crumple {
namespace {

using host::CarPose;
using host::pose_at;

const std::shared_ptr<const Car>& box() {
  static const auto car = box_car({4, 2, 2});
  return car;
}

// A host of one car that drives with a steady velocity, and applies each reaction `late` ticks after it was sent.
struct Driver {
  std::string car, host;
  CarPose pose;
  size_t late = 1;
  Eigen::Vector3d impulse = Eigen::Vector3d::Zero();  // of all reactions
  uint64_t sequence = 0;
  std::deque<std::vector<Bytes>> on_the_way = {};

  double pull = 0;  // m/s^2, along x: its own forces

  Message speak() {
    const schema::Vec3& v = pose.velocity;
    pose.velocity = {float(double(v.x()) + pull / 60), v.y(), v.z()};
    return {"host/" + host + "/poses", host::poses(++sequence, {pose})};
  }
  void hear(const Outbox& outbox) {
    std::vector<Bytes>& now = on_the_way.emplace_back();
    for (const Message& message : outbox) {
      if (message.key == "host/" + host + "/reactions") now.push_back(message.bytes);
    }
    const schema::Vec3& v = pose.velocity;
    pose.pose = pose_at(pose.pose.position().x() + double(v.x()) / 60, pose.pose.position().y() + double(v.y()) / 60);
    if (on_the_way.size() < late) return;
    for (const Bytes& bytes : on_the_way.front()) {
      const auto* reactions = host::read_as<schema::Reactions>(bytes);
      const auto* reaction = reactions->cars()->Get(0);
      if (reactions->tick() <= pose.seen) continue;
      const auto* push = reaction->impulse();
      impulse += Eigen::Vector3d(double(push->x()), double(push->y()), double(push->z()));
      const double passed = double(late - 1) / 60;  // since then
      const auto& at = reaction->pose()->position();
      const auto& velocity = *reaction->velocity();
      pose = {car, *reaction->pose(), velocity, *reaction->angular_velocity(), reactions->tick()};
      pose.pose = {{at.x() + passed * double(velocity.x()), at.y() + passed * double(velocity.y()), at.z()},
                   reaction->pose()->orientation()};
    }
    on_the_way.pop_front();
  }
};

struct Meeting {
  WorldHandle world = make_world(60, 0.0005f);
  std::vector<Driver> drivers;
  Outbox outbox;
  Inbox said = {};  // of the last step
  int threads = 1;

  Meeting() { add_asset(*world, box()); }
  Instance& car(const std::string& id) { return world->cars.at(id); }
  void add(const std::string& id, const std::string& host, double x, float vx, double y = 0) {
    tick(*world, {{"car/" + id, host::spawn(box()->hash, host, pose_at(x, y))}}, outbox, threads);
    drivers.push_back({id, host, {id, pose_at(x, y), {vx, 0, 0}}});
    drivers.back().pose.seen = tick_count(*world);
  }
  // inbox: messages before those of the drivers.
  void step(Inbox inbox = {}) {
    for (Driver& driver : drivers) inbox.push_back(driver.speak());
    tick(*world, inbox, outbox, threads);
    said = std::move(inbox);
    for (Driver& driver : drivers) driver.hear(outbox);
  }
  void run(int ticks) {
    for (int k = 0; k < ticks; ++k) step();
  }
  Eigen::Vector3d momentum(const std::string& id) { return car(id).mass.mass * car(id).motion.velocity; }
};

// Noses 20 cm apart. From some 10 m/s on, corners of the two equal boxes slip past each other, and the cars may hook.
std::unique_ptr<Meeting> head_on(int threads = 1, float speed = 12) {
  auto meeting = std::make_unique<Meeting>();
  meeting->threads = threads;
  meeting->add("left", "one", -2.35, speed);
  meeting->add("right", "two", 2.35, -speed);
  return meeting;
}

float dent(const Instance& car) {
  float most = 0;
  for (size_t i = 0; i < car.body.node.size(); ++i) most = std::max(most, (car.body.node[i] - car.car->model.node[i]).norm());
  return most;
}

TEST(Islands, TheHostsOfTwoCarsThatMeetAreBothTold) {
  const auto meeting = head_on(1, 7);
  meeting->run(60);
  const Eigen::Vector3d &left = meeting->drivers[0].impulse, &right = meeting->drivers[1].impulse;
  EXPECT_LT(left.x(), -7 * 1200);
  EXPECT_LT((left + right).norm(), 1e-9 * left.norm());
  for (const char* id : {"left", "right"}) EXPECT_GT(dent(meeting->car(id)), 0.04f);
  EXPECT_LT(meeting->car("left").motion.velocity.x(), 0);
  EXPECT_GT(meeting->car("right").motion.velocity.x(), 0);
}

// What can be pushed is a car: a bin of 60 kg, a hundred times as stiff as a car's body. Its own host is told how it is pushed.
TEST(Islands, ABinIsACarAndItsHostIsTold) {
  const auto bin = box_car({3, 2, 2}, 60, 1.2f);
  Meeting meeting;
  add_asset(*meeting.world, bin);
  tick(*meeting.world,
       {{"car/bin", host::spawn(bin->hash, "street", pose_at(3.2, 0.2))},
        {"car/bin", host::parameters([](auto& p) { p.add_young_modulus(100 * Material{}.young_modulus); })}},
       meeting.outbox, 1);
  meeting.drivers.push_back({"bin", "street", {"bin", pose_at(3.2, 0.2)}});
  meeting.drivers.back().pose.seen = tick_count(*meeting.world);
  meeting.add("car", "one", 0, 8);
  for (int k = 0; k < 60; ++k) {
    meeting.step();
    ASSERT_FALSE(meeting.car("bin").result.recovered);
  }
  const Eigen::Vector3d &of_car = meeting.drivers[1].impulse, &of_bin = meeting.drivers[0].impulse;
  EXPECT_LT((of_car + of_bin).norm(), 1e-9 * of_bin.norm());
  EXPECT_GT(of_bin.x(), 60 * 7.0) << "it flies off at no less than the car's speed";
  EXPECT_GE(meeting.car("bin").motion.velocity.x(), meeting.car("car").motion.velocity.x());
  EXPECT_NEAR(meeting.car("car").motion.velocity.x(), 8 - of_bin.x() / 1200, 1e-6);
  EXPECT_LT(dent(meeting.car("bin")), 0.01f) << "it is stiff";
  EXPECT_GT(dent(meeting.car("car")), dent(meeting.car("bin")));
}

// The partners of a car in the last tick, as its host was told.
std::vector<const schema::Partner*> partners_told(const Meeting& meeting, const std::string& id, const std::string& host) {
  std::vector<const schema::Partner*> out;
  for (const Message& message : meeting.outbox) {
    if (message.key != "host/" + host + "/reactions") continue;
    for (const auto* car : *host::read_as<schema::Reactions>(message.bytes)->cars()) {
      if (car->car()->string_view() != id || !car->partners()) continue;
      out.insert(out.end(), car->partners()->begin(), car->partners()->end());
    }
  }
  return out;
}

TEST(Islands, EachReactionNamesTheOtherCarItsHostAndWhatItGave) {
  const auto meeting = head_on();
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  int touching = 0;
  for (int k = 0; k < 60; ++k) {
    meeting->step();
    const StepResult &left = meeting->car("left").result, &right = meeting->car("right").result;
    ASSERT_EQ(left.partners.size(), right.partners.size());
    const auto told = partners_told(*meeting, "left", "one"), other = partners_told(*meeting, "right", "two");
    ASSERT_EQ(told.size(), left.partners.size());
    if (left.partners.empty()) {
      EXPECT_TRUE(left.impulse.isZero(0));
      continue;
    }
    ASSERT_EQ(left.partners.size(), 1u);
    const PartnerResult &of_left = left.partners.front(), &of_right = right.partners.front();
    EXPECT_EQ(of_left.key, key_of("right"));
    EXPECT_EQ(of_right.key, key_of("left"));
    EXPECT_LE((of_left.impulse + of_right.impulse).norm(), 1e-12 * of_left.impulse.norm());
    EXPECT_LE((of_left.impulse - left.impulse).norm(), 1e-12 * left.impulse.norm());
    EXPECT_EQ(of_left.contacts, left.contacts);
    touching += of_left.contacts > 0;
    sum += of_left.impulse;
    EXPECT_EQ(told.front()->car()->str() + " of " + told.front()->host()->str(), "right of two");
    EXPECT_EQ(other.front()->car()->str() + " of " + other.front()->host()->str(), "left of one");
    EXPECT_EQ(told.front()->impulse()->x(), float(of_left.impulse.x()));
    EXPECT_EQ(other.front()->impulse()->x(), -told.front()->impulse()->x());
    EXPECT_EQ(told.front()->contacts(), of_left.contacts);
  }
  EXPECT_GT(touching, 3);
  EXPECT_NEAR(sum.x(), meeting->momentum("left").x() - 12 * 1200, 1e-6 * sum.norm());
}

// The one in the middle of a queue at a wall is touched on both sides; the first one also by the wall.
TEST(Islands, OfSeveralPartnersEachIsNamedWithItsPart) {
  Meeting meeting;
  meeting.add("a", "one", 0, 0);
  meeting.add("b", "two", -4.55, 0);
  meeting.add("c", "one", -9.1, 0);
  for (Driver& driver : meeting.drivers) driver.pose.velocity = {12, 0, 0};
  meeting.step({{"host/wall/obstacles", host::obstacles(1, {{.pose = pose_at(2.75)}})}});
  bool both = false;
  for (int k = 0; k < 60; ++k) {
    const auto told = partners_told(meeting, "b", "two");
    if (told.size() == 2) {
      both = true;
      EXPECT_EQ(told[0]->car()->str(), "a");
      EXPECT_EQ(told[1]->car()->str(), "c");
      EXPECT_EQ(told[1]->host()->str(), "one");
    }
    std::map<std::pair<uint64_t, uint64_t>, Eigen::Vector3d> given;
    for (const auto& [id, car] : meeting.world->cars) {
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (const PartnerResult& each : car.result.partners) {
        given[{car.key, each.key}] = each.impulse;
        sum += each.impulse;
      }
      if (id == "a") continue;  // the wall pushes it too
      EXPECT_LE((sum - car.result.impulse).norm(), 1e-12 * car.result.impulse.norm()) << id << " in tick " << k;
    }
    for (const auto& [cars, impulse] : given) {
      ASSERT_TRUE(given.contains({cars.second, cars.first}));
      EXPECT_LE((impulse + given[{cars.second, cars.first}]).norm(), 1e-12 * impulse.norm());
    }
    meeting.step();
  }
  EXPECT_TRUE(both);
}

TEST(Islands, AreTheSameBitForBitOnAnyNumberOfThreads) {
  const tbb::global_control four(tbb::global_control::max_allowed_parallelism, 4);
  const auto hashes = [](int threads) {
    const auto meeting = head_on(threads);
    meeting->add("third", "one", -8, 20);
    meeting->add("aside", "two", 0, 5, 10);
    std::vector<uint64_t> out;
    for (int k = 0; k < 40; ++k) {
      meeting->step();
      out.push_back(hash(*meeting->world));
    }
    return out;
  };
  const auto one = hashes(1);
  EXPECT_EQ(hashes(2), one);
  EXPECT_EQ(hashes(4), one);
}

// The host of one car hears, and so speaks, 100 ms late. The cars meet elsewhere, and crush each other as much.
TEST(Islands, AHostThatIsLateChangesThePlaceOfACrashButNotTheCrash) {
  const auto punctual = head_on(1, 7), late = head_on(1, 7);
  late->drivers[1].late = 6;
  punctual->run(60);
  late->run(60);
  const double impulse = punctual->momentum("left").x() - 7 * 1200;
  EXPECT_LT(impulse, -7 * 1200);
  EXPECT_NEAR(late->momentum("left").x() - 7 * 1200, impulse, 0.02 * std::fabs(impulse));
  for (const char* id : {"left", "right"}) {
    EXPECT_NEAR(dent(late->car(id)), dent(punctual->car(id)), 0.02f * dent(punctual->car(id)));
  }
}

// A host's own force acts during the whole tick, not at its start: else the car would hop from the other one in each tick.
TEST(Islands, ACarThatItsHostPressesOnAnotherPushesItSteadily) {
  const auto meeting = std::make_unique<Meeting>();
  meeting->add("left", "one", -2.251, 0);
  meeting->add("right", "two", 2.251, 0);
  meeting->drivers[0].pull = 3;
  meeting->run(30);
  for (int k = 0; k < 60; ++k) {
    meeting->step();
    EXPECT_GT(meeting->car("right").result.impulse.x(), 0) << k;
  }
  for (const char* id : {"left", "right"}) {
    EXPECT_NEAR(meeting->car(id).motion.velocity.x(), 0.5 * 3 * 1.5, 0.1) << id;
    EXPECT_LT(dent(meeting->car(id)), 0.005f);
  }
}

TEST(Islands, AParkedCarSleepsUntilAnotherComes) {
  Meeting meeting;
  meeting.add("parked", "city", 0, 0);
  meeting.drivers.clear();  // its host says nothing more
  meeting.run(10);
  EXPECT_TRUE(meeting.car("parked").idle);
  meeting.add("coming", "game", -40, 20);
  meeting.run(50);
  EXPECT_TRUE(meeting.car("parked").idle) << "nothing is near yet";
  const uint64_t before = meeting.car("parked").hashes.body;
  meeting.run(90);
  EXPECT_NE(meeting.car("parked").hashes.body, before);
  EXPECT_GT(dent(meeting.car("parked")), 0.05f);
  EXPECT_GT(meeting.car("parked").motion.velocity.x(), 5);
}

TEST(Islands, ACarThatIsPassedStaysAsItIs) {
  Meeting meeting;
  meeting.add("parked", "city", 0, 0);
  meeting.drivers.clear();
  meeting.run(10);
  const uint64_t before = meeting.car("parked").hashes.body;
  meeting.add("passing", "game", -20, 20, 2.0);  // 20 cm beside it
  for (int k = 0; k < 120; ++k) {
    meeting.step();
    EXPECT_EQ(meeting.car("parked").result.substeps, 0u);
  }
  EXPECT_EQ(meeting.car("parked").touched_tick, 0u);
  EXPECT_TRUE(meeting.car("parked").idle);
  EXPECT_EQ(meeting.car("parked").hashes.body, before) << "it has forgotten who was near";
}

TEST(Islands, CarsSpawnedAtOnePoseCanPart) {
  Meeting meeting;
  meeting.add("a", "one", 0, 0);
  meeting.add("b", "two", 0, 3);
  meeting.run(120);
  EXPECT_GT(meeting.car("b").motion.pose.position.x(), 5);
  EXPECT_EQ(meeting.car("a").touched_tick, 0u);
  EXPECT_EQ(dent(meeting.car("a")), 0);
}

TEST(Islands, CarsSpawnedInsideEachOtherPassThroughUntilTheyHaveParted) {
  Meeting meeting;
  meeting.add("a", "one", 0, 0);
  meeting.add("b", "two", 1, 3);  // half inside, and drives out
  meeting.run(30);
  EXPECT_FALSE(meeting.car("b").body.pairs.passing.empty());
  meeting.run(90);
  EXPECT_GT(meeting.car("b").motion.pose.position.x(), 5);
  EXPECT_EQ(meeting.car("a").touched_tick, 0u);
  EXPECT_EQ(dent(meeting.car("a")), 0);
  EXPECT_TRUE(meeting.car("b").body.pairs.passing.empty());
  meeting.drivers[1].pose.velocity = {-10, 0, 0};  // and comes back
  meeting.run(90);
  EXPECT_GT(meeting.car("a").touched_tick, 0u);
  EXPECT_GT(dent(meeting.car("a")), 0.02f);
}

TEST(Islands, AWorldSavedWhileTwoCarsTouchGoesOnBitForBit) {
  const auto meeting = head_on();
  meeting->run(4);
  ASSERT_FALSE(meeting->car("left").body.pairs.touch.empty());
  Meeting copy;
  load_world(save_world(*meeting->world), *copy.world);
  for (int k = 0; k < 30; ++k) {
    tick(*meeting->world, {}, meeting->outbox, 1);
    tick(*copy.world, {}, copy.outbox, 1);
    ASSERT_EQ(hash(*copy.world), hash(*meeting->world)) << "tick " << k;
  }
}

// Many cars in one place must not make a tick long: each notices at most `neighbour_limit` others, and is tested against these
// alone; and an island has at most `island_limit` cars.
TEST(Islands, ManyCarsInOnePlaceNoticeFew) {
  Meeting meeting;
  Inbox inbox;
  std::vector<CarPose> poses;
  for (int k = 0; k < 300; ++k) {
    poses.push_back({"car" + std::to_string(k), pose_at(0.01 * k), {1, 0, 0}});
    inbox.push_back({"car/" + poses.back().car, host::spawn(box()->hash, "game", poses.back().pose)});
  }
  inbox.push_back({"host/game/poses", host::poses(1, poses)});
  meeting.step(inbox);
  for (int k = 0; k < 3; ++k) {
    size_t most = 0, kept = 0;
    for (const auto& [id, car] : meeting.world->cars) {
      most = std::max(most, car.near.size());
      kept = std::max(kept, car.body.pairs.near.size());
      EXPECT_EQ(car.body.pairs.passing, car.body.pairs.near);
    }
    EXPECT_EQ(most, neighbour_limit);
    EXPECT_LE(kept, neighbour_limit);
    EXPECT_GT(kept, 0u);
    meeting.step();
  }
  const uint64_t largest = meeting.world->tally.largest_island;
  EXPECT_LE(largest, island_limit);
  EXPECT_GT(largest, island_limit / 2);
}

// A crash in a crowd that is larger than an island: the two cars that press against each other stay in one.
TEST(Islands, OfTooManyCarsThoseThatTouchStayTogether) {
  const auto meeting = head_on();
  meeting->run(3);
  ASSERT_EQ(meeting->car("left").result.partners.size(), 1u);
  Inbox inbox;
  std::vector<CarPose> poses;
  for (int k = 0; k < 200; ++k) {
    poses.push_back({"a" + std::to_string(k), pose_at(0.02 * k - 2, 0.01 * k), {1, 0, 0}});
    inbox.push_back({"car/" + poses.back().car, host::spawn(box()->hash, "crowd", poses.back().pose)});
  }
  inbox.push_back({"host/crowd/poses", host::poses(1, poses)});
  meeting->step(inbox);
  EXPECT_EQ(meeting->car("left").result.partners.size(), 1u);
  EXPECT_LE(meeting->world->tally.largest_island, island_limit);
}

// Its way of half a second leads past more cars than it can notice. It hits the one that is nearest.
TEST(Islands, ACarThatDrivesIntoACrowdMissesNoneInItsWay) {
  Meeting meeting;
  Inbox inbox;
  for (int row = 0; row < 20; ++row) {
    for (int lane = -1; lane <= 1; ++lane) {
      inbox.push_back(
          {"car/crowd" + std::to_string(3 * row + lane + 1), host::spawn(box()->hash, "city", pose_at(-5 * row, 2.1 * lane))});
    }
  }
  inbox.push_back({"car/fast", host::spawn(box()->hash, "game", pose_at(8))});
  inbox.push_back({"host/game/poses", host::poses(1, {{"fast", pose_at(8), {-200, 0, 0}}})});
  meeting.step(inbox);
  meeting.run(2);
  EXPECT_GT(meeting.car("crowd1").touched_tick, 0u);
  EXPECT_LT(meeting.car("crowd1").motion.velocity.x(), -10);
}

// What commands and hosts may do to a car in the middle of a crash. The crash goes on or ends, but nobody is thrown away.
TEST(Islands, ACommandToACarThatTouchesAnotherIsGentle) {
  const auto state_of = [](Meeting& meeting) {
    tick(*meeting.world, {{"car/right", host::save(), 7}}, meeting.outbox, 1);
    for (const Message& message : meeting.outbox) {
      if (message.ticket != 7) continue;
      const auto* state = host::read_as<schema::Answer>(message.bytes)->state();
      const auto* data = reinterpret_cast<const std::byte*>(state->data());
      return Bytes(data, data + state->size());
    }
    return Bytes();
  };
  const auto fine = box_car({6, 3, 2});
  using Orders = std::vector<Bytes>;
  const std::pair<const char*, std::function<Orders(Meeting&)>> orders[] = {
      {"despawn", [](Meeting&) { return Orders{host::despawn()}; }},
      {"respawn",
       [](Meeting&) {
         return Orders{host::despawn(), host::spawn(box()->hash, "two", pose_at(2.35))};
       }},
      {"repair", [](Meeting&) { return Orders{host::repair(1)}; }},
      {"repair a part", [](Meeting&) { return Orders{host::repair(0.5f)}; }},
      {"load", [&](Meeting& meeting) { return Orders{host::load(state_of(meeting))}; }},
      {"replace", [&](Meeting&) { return Orders{host::replace(fine->hash)}; }},
      {"classic", [](Meeting&) { return Orders{host::parameters([](auto& p) { p.add_solver(schema::Solver::classic); })}; }},
      {"stiff", [](Meeting&) { return Orders{host::parameters([](auto& p) { p.add_young_modulus(1e9f); })}; }},
      {"soft", [](Meeting&) { return Orders{host::parameters([](auto& p) { p.add_young_modulus(1e5f); })}; }},
      {"many sub-steps", [](Meeting&) { return Orders{host::parameters([](auto& p) { p.add_substeps(16); })}; }},
  };
  for (const auto& [name, order] : orders) {
    SCOPED_TRACE(name);
    const auto meeting = head_on();
    add_asset(*meeting->world, fine);
    meeting->run(4);
    ASSERT_FALSE(meeting->car("left").body.pairs.touch.empty());
    Inbox inbox;
    for (const Bytes& bytes : order(*meeting)) inbox.push_back({"car/right", bytes});
    meeting->step(inbox);
    if (meeting->world->cars.contains("right")) {
      EXPECT_EQ(refusal_count(*meeting->world), 0u) << last_refusal(*meeting->world);
    }
    for (int k = 0; k < 30; ++k) {
      for (const auto& [id, car] : meeting->world->cars) {
        ASSERT_EQ(car.hashes.body, hash(car.body)) << id;
        ASSERT_LT(car.motion.velocity.norm(), 13) << id;
      }
      meeting->step();
    }
    EXPECT_EQ(meeting->world->tally.recoveries, 0u);
  }
}

// A car that is spawned under the name of one that touched is not taken for that one.
TEST(Islands, ForgetsACarThatIsDespawnedEvenIfAnotherGetsItsName) {
  const auto crash = [](const std::string& name) {
    const auto meeting = head_on();
    meeting->run(4);
    const Instance& left = meeting->car("left");
    EXPECT_FALSE(left.body.pairs.touch.empty());
    const double nose = left.motion.pose.position.x() + double(left.body.high.x());
    tick(*meeting->world,
         {{"car/right", host::despawn()}, {"car/" + name, host::spawn(box()->hash, "two", pose_at(nose + 2.27))}},
         meeting->outbox, 1);
    const Instance& other = meeting->car(name);
    return std::tuple(left.body.node, left.motion.velocity, other.body.node, other.motion.velocity);
  };
  EXPECT_EQ(crash("right"), crash("sight"));
}

TEST(Islands, ACarThatItsHostPutsFromBesideAnotherIntoItPassesThroughIt) {
  Meeting meeting;
  meeting.add("a", "one", 0, 0);
  meeting.add("b", "two", 4.53, -0.1f);
  meeting.run(3);
  ASSERT_FALSE(meeting.car("a").body.pairs.near.empty());
  meeting.drivers[1].pose.pose = pose_at(-1);  // more than `teleport` away
  meeting.drivers[1].pose.velocity = {-3, 0, 0};
  meeting.run(10);
  EXPECT_FALSE(meeting.car("a").body.pairs.passing.empty());
  meeting.run(120);
  EXPECT_EQ(meeting.car("a").touched_tick, 0u);
  EXPECT_EQ(dent(meeting.car("a")), 0);
  EXPECT_LT(meeting.car("b").motion.pose.position.x(), -5);
}

// Ten cars in one crash, and ten crashes of two.
Inbox many_cars() {
  Inbox inbox;
  std::vector<CarPose> one, two;
  for (int k = 0; k < 30; ++k) {
    const std::string id = std::to_string(k);
    const bool row = k < 10, odd = k % 2;
    const double x = row ? 4.55 * k : (odd ? 2.3 : -2.3), y = row ? -20 : 4 * double(k / 2);
    inbox.push_back({"car/" + id, host::spawn(box()->hash, odd ? "two" : "one", pose_at(x, y))});
    (odd ? two : one).push_back({id, pose_at(x, y), {row ? 2.0f * float(9 - k) : (odd ? -9.0f : 9.0f), 0, 0}});
  }
  inbox.push_back({"host/one/poses", host::poses(1, one)});
  inbox.push_back({"host/two/poses", host::poses(1, two)});
  return inbox;
}

TEST(Islands, LargeAndManyGiveTheSameBitsOnAnyNumberOfThreadsAndInAnyOrderOfSpawns) {
  const tbb::global_control four(tbb::global_control::max_allowed_parallelism, 4);
  const auto hashes = [](int threads, bool reverse) {
    Meeting meeting;
    meeting.threads = threads;
    Inbox inbox = many_cars();
    if (reverse) std::reverse(inbox.begin(), inbox.end() - 2);
    std::vector<uint64_t> out;
    for (int k = 0; k < 8; ++k) {
      meeting.step(k == 0 ? inbox : Inbox());
      out.push_back(hash(*meeting.world));
    }
    EXPECT_GE(meeting.world->tally.largest_island, 8u);
    EXPECT_EQ(meeting.world->tally.most_islands, 11u);
    return out;
  };
  const auto one = hashes(1, false);
  EXPECT_EQ(hashes(2, false), one);
  EXPECT_EQ(hashes(4, true), one);
}

TEST(Islands, AStandbyThatIsFedTheInputsOfTwoHostsHoldsTheSameWorld) {
  const auto meeting = head_on();
  Meeting standby;
  load_world(save_world(*meeting->world), *standby.world);
  for (int k = 0; k < 30; ++k) {
    meeting->step();
    const Message message = inputs_message(tick_count(*meeting->world), meeting->said, hash(*meeting->world));
    const auto inputs = read_inputs(message.bytes);
    ASSERT_TRUE(inputs);
    tick(*standby.world, inputs->inbox, standby.outbox, 2);
    ASSERT_EQ(hash(*standby.world), inputs->hash) << "tick " << k;
  }
  EXPECT_GT(dent(standby.car("left")), 0.1f);
}

TEST(Islands, AStandbyThatTakesOverInACrashGoesOnAsTheOwnerWould) {
  const auto meeting = head_on();
  meeting->run(4);
  Meeting standby;
  load_world(save_world(*meeting->world), *standby.world);
  standby.drivers = meeting->drivers;
  renew(*standby.world);
  meeting->run(30);
  standby.run(30);
  for (const char* id : {"left", "right"}) {
    EXPECT_EQ(hash(standby.car(id).body), hash(meeting->car(id).body));
    EXPECT_EQ(standby.car(id).motion.velocity, meeting->car(id).motion.velocity);
  }
}

uint64_t count_of(World& world, const std::string& name) {
  const Message message = health(world, 0, {});
  for (const auto* count : *host::read_as<schema::Health>(message.bytes)->counts()) {
    if (count->name()->string_view() == name) return count->value();
  }
  ADD_FAILURE() << "health has no " << name;
  return 0;
}

TEST(Islands, HealthCountsThemAndTheCarsOfTheLargest) {
  Meeting meeting;
  meeting.step(many_cars());
  EXPECT_EQ(count_of(*meeting.world, "islands"), 11u);
  meeting.step();
  EXPECT_GE(count_of(*meeting.world, "largest_island"), 8u);
  EXPECT_EQ(count_of(*meeting.world, "largest_island"), 0u) << "since the last health";
}

// The cars are solved together, so a cut that one of them does not get would save nothing.
TEST(Islands, OfTenCarsKeepsTheBudgetByOnePlanForAll) {
  const auto run = [](uint64_t budget) {
    Meeting meeting;
    Inbox inbox = many_cars();
    for (int k = 0; k < 30; ++k) {  // else they stop long before the budget has anything to take
      inbox.push_back(
          {"car/" + std::to_string(k), host::parameters([](auto& p) { p.add_iterations(24), p.add_tolerance(0); })});
    }
    inbox.push_back(budget_message(budget));
    uint64_t most = 0, shed = 0;
    for (int k = 0; k < 10; ++k) {
      tick(*meeting.world, inbox, meeting.outbox, 1);
      inbox.clear();
      for (auto& [id, car] : meeting.world->cars) car.importance = car.host == "one" ? 1 : 0.1f;
      if (k < 3) continue;  // in the first ticks nothing is known of the crash
      most = std::max(most, meeting.world->tally.work);
      shed += meeting.world->tally.shed;
      EXPECT_EQ(meeting.car("0").sweeps, meeting.car("1").sweeps);
      EXPECT_EQ(meeting.car("1").sweeps, meeting.car("2").sweeps);
    }
    return std::pair(most, shed);
  };
  const uint64_t all = run(uint64_t{1} << 50).first;
  const auto [most, shed] = run(all / 2);
  EXPECT_LE(most, all * 3 / 4);  // the plan is made before the tick, and cars wake in it
  EXPECT_GT(shed, 0u);
}

// A crowd that presses would make a tick seconds long, so there the budget may take more than where few cars meet.
TEST(Islands, InACrowdTheBudgetLeavesFewerSweepsThanWhereFewCarsMeet) {
  const auto sweeps = [](int cars) {
    Meeting meeting;
    for (int k = 0; k < cars; ++k) meeting.add(std::to_string(k), "h" + std::to_string(k), 4.51 * k, float(0.5 * cars - k));
    meeting.step({budget_message(1)});
    std::map<uint32_t, int> count;  // cars by sweeps a sub-step
    for (int k = 0; k < 20; ++k) {
      meeting.step();
      if (k < 3) continue;
      for (const auto& [id, car] : meeting.world->cars) {
        if (car.result.substeps > 0 && !car.body.pairs.near.empty()) ++count[car.result.sweeps / car.result.substeps];
      }
    }
    const auto rarer = [](const auto& a, const auto& b) { return a.second < b.second; };
    return count.empty() ? 0 : std::max_element(count.begin(), count.end(), rarer)->first;
  };
  EXPECT_GE(sweeps(6), 6u);  // eight at most; some stop by themselves
  EXPECT_EQ(sweeps(24), 4u);
}

}  // namespace
}  // namespace crumple

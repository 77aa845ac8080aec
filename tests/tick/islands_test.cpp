// Tests cars of one world that meet: two hosts in one crash, parked cars, and cars that were spawned inside each other.
#include "tick/islands.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <deque>

#include "box_car.h"
#include "host.h"
#include "tick/hash.h"
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

  Message speak() { return {"host/" + host + "/poses", host::poses(++sequence, {pose})}; }
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
  int threads = 1;

  Meeting() { add_asset(*world, box()); }
  Instance& car(const std::string& id) { return world->cars.at(id); }
  void add(const std::string& id, const std::string& host, double x, float vx, double y = 0) {
    tick(*world, {{"car/" + id, host::spawn(box()->hash, host, pose_at(x, y))}}, outbox, threads);
    drivers.push_back({id, host, {id, pose_at(x, y), {vx, 0, 0}}});
    drivers.back().pose.seen = tick_count(*world);
  }
  void step() {
    Inbox inbox;
    for (Driver& driver : drivers) inbox.push_back(driver.speak());
    tick(*world, inbox, outbox, threads);
    for (Driver& driver : drivers) driver.hear(outbox);
  }
  void run(int ticks) {
    for (int k = 0; k < ticks; ++k) step();
  }
  Eigen::Vector3d momentum(const std::string& id) { return car(id).mass.mass * car(id).motion.velocity; }
};

// Noses 20 cm apart.
std::unique_ptr<Meeting> head_on(int threads = 1) {
  auto meeting = std::make_unique<Meeting>();
  meeting->threads = threads;
  meeting->add("left", "one", -2.35, 12);
  meeting->add("right", "two", 2.35, -12);
  return meeting;
}

float dent(const Instance& car) {
  float most = 0;
  for (size_t i = 0; i < car.body.node.size(); ++i) most = std::max(most, (car.body.node[i] - car.car->model.node[i]).norm());
  return most;
}

TEST(Islands, TheHostsOfTwoCarsThatMeetAreBothTold) {
  const auto meeting = head_on();
  meeting->run(60);
  const Eigen::Vector3d &left = meeting->drivers[0].impulse, &right = meeting->drivers[1].impulse;
  EXPECT_LT(left.x(), -12 * 1200);
  EXPECT_LT((left + right).norm(), 1e-9 * left.norm());
  for (const char* id : {"left", "right"}) EXPECT_GT(dent(meeting->car(id)), 0.1f);
  EXPECT_LT(meeting->car("left").motion.velocity.x(), 0);
  EXPECT_GT(meeting->car("right").motion.velocity.x(), 0);
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
  const auto punctual = head_on(), late = head_on();
  late->drivers[1].late = 6;
  punctual->run(60);
  late->run(60);
  const double impulse = punctual->momentum("left").x() - 12 * 1200;
  EXPECT_LT(impulse, -12 * 1200);
  EXPECT_NEAR(late->momentum("left").x() - 12 * 1200, impulse, 0.02 * std::fabs(impulse));
  for (const char* id : {"left", "right"}) {
    EXPECT_NEAR(dent(late->car(id)), dent(punctual->car(id)), 0.02f * dent(punctual->car(id)));
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

// A thousand cars in one place must not make a tick long: each notices at most `neighbour_limit` others.
TEST(Islands, ManyCarsInOnePlaceNoticeFew) {
  Meeting meeting;
  for (int k = 0; k < 100; ++k) meeting.add("car" + std::to_string(k), "game", 0.01 * k, 1);
  meeting.drivers.clear();
  meeting.step();
  for (const auto& [id, car] : meeting.world->cars) EXPECT_LE(car.near.size(), neighbour_limit);
}

}  // namespace
}  // namespace crumple

// Tests the budget: the most work in a tick, which cars get less, and that the budget is an input like any other.
#include "tick/budget.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>

#include "box_car.h"
#include "host.h"
#include "tick/hash.h"
#include "tick/health.h"
#include "tick/levels.h"
#include "tick/state.h"
#include "wire/encode.h"

namespace crumple {
namespace {

using host::CarPose;
using host::pose_at;

constexpr int cars = 6, sweeps = 12;

const std::shared_ptr<const Car>& box() {
  static const auto car = box_car({6, 3, 2}, 2000);  // so heavy that its sub-steps are not halved
  return car;
}

struct Result {
  std::vector<uint64_t> hashes;  // after each tick
  std::vector<Work> works;
  std::vector<std::vector<int>> sweeps;  // by tick and car, summed over sub-steps
  std::map<std::string, HealthReport::Count> counts;
};

// Six cars hit a wall. Cars with odd numbers have little importance. budget: by tick, from the first on; empty: no budget is
// sent.
Result pile_up(const std::function<std::optional<uint64_t>(int tick)>& budget, int threads = 1) {
  const WorldHandle world = make_world(60, 0.0005f);
  add_asset(*world, box());
  Inbox inbox = {
      {"host/game/obstacles", host::obstacles(1, {{1, schema::Shape::box, {0.5f, 50, 5}, pose_at(2.25 + 0.02 + 0.5, 0, 1)}})}};
  std::vector<CarPose> poses;
  for (int k = 0; k < cars; ++k) {
    const std::string id = std::to_string(k);
    inbox.push_back({"car/" + id, host::spawn(box()->hash, "game", pose_at(0, 4 * k))});
    inbox.push_back({"car/" + id, host::parameters([](auto& p) {
                       p.add_iterations(sweeps);
                       p.add_tolerance(0);
                     })});
    poses.push_back({id, pose_at(0, 4 * k), {12, 0, 0}});
    poses.back().importance = k % 2 ? 0.1f : 1.0f;
  }
  inbox.push_back({"host/game/poses", host::poses(1, poses)});
  Result result;
  Outbox outbox;
  for (int k = 0; k < 12; ++k) {
    if (const auto visits = budget(k)) inbox.push_back(budget_message(*visits));
    result.works.push_back(tick(*world, inbox, outbox, threads).work);
    inbox.clear();
    result.hashes.push_back(hash(*world));
    result.sweeps.emplace_back();
    for (const auto& [id, car] : world->cars) result.sweeps.back().push_back(int(car.result.sweeps));
  }
  const Message report = health(*world, 0, {});
  for (const auto* count : *host::read_as<schema::Health>(report.bytes)->counts()) {
    result.counts[count->name()->str()] = {count->name()->str(), count->value(), count->limit()};
  }
  return result;
}

Result unlimited() {
  return pile_up([](int) { return std::nullopt; });
}
Result limited(uint64_t visits, int threads = 1) {
  return pile_up([visits](int k) { return k == 0 ? std::optional(visits) : std::nullopt; }, threads);
}
uint64_t most(const Result& result) {
  uint64_t out = 0;
  for (const Work& work : result.works) out = std::max(out, work.done);
  return out;
}

TEST(Budget, ThatIsNotReachedChangesNoBitOfTheCars) {
  const Result free = unlimited();
  const uint64_t enough = 2 * cars * sweeps * 8 * 4 * box()->model.tet.size();  // also if sub-steps are halved
  const Result with = limited(enough);
  const Result again = pile_up([&](int k) {
    return k == 0 ? std::optional(enough) : k == 11 ? std::optional<uint64_t>(0) : std::nullopt;
  });
  EXPECT_EQ(with.works.back().shed, 0u);
  EXPECT_EQ(most(with), most(free));
  EXPECT_EQ(again.hashes.back(), free.hashes.back()) << "once the budget is taken back, the world is as if it had not been";
}

TEST(Budget, IsKeptAndSpentOnWhatMatters) {
  const Result free = unlimited();
  const uint64_t budget = most(free) / 2;
  Result result = limited(budget);
  uint64_t shed = 0;
  int important = 0, others = 0;
  for (size_t k = 0; k < result.works.size(); ++k) {
    EXPECT_LE(result.works[k].done, budget) << "tick " << k;
    shed += result.works[k].shed;
    for (int car = 0; car < cars; ++car) {
      EXPECT_NE(result.sweeps[k][car], 1);
      if (std::count(result.sweeps[k].begin(), result.sweeps[k].end(), 0) > 0) continue;  // not all cars are solved
      (car % 2 ? others : important) += result.sweeps[k][car];
    }
  }
  EXPECT_GT(shed, budget);
  EXPECT_GT(important, others + others / 2);
  EXPECT_EQ(result.counts["work_most"].limit, budget);
  EXPECT_EQ(result.counts["work_most"].value, most(result));
  EXPECT_EQ(result.counts["work_shed"].value, shed);
  EXPECT_GT(result.counts["residual_worst_nm"].value, result.counts["residual_mean_nm"].value);
  EXPECT_GT(result.counts["residual_mean_nm"].value, 0u);
}

// Box cars are so coarse that a sub-step may be as long as a tick.
TEST(Budget, TooSmallForAllLeavesEachASubstepOfFourSweeps) {
  const Result result = limited(1);
  for (const auto& of_tick : result.sweeps) {
    for (int one : of_tick) EXPECT_TRUE(one == 0 || one == 4) << one;
  }
}

const host::Thing front_wall{1, schema::Shape::box, {0.5f, 50, 5}, pose_at(2.25 + 0.02 + 0.5, 0, 1)};

// Cars that rest against the wall, or stand before it, with the velocity from the host; then an event wakes all of them.
void expect_woken_within_the_budget(float speed,
                                    const std::function<void(Inbox&, const std::function<Message(double x)>&)>& wake) {
  const WorldHandle world = make_world(60, 0.0005f);
  add_asset(*world, box());
  Outbox outbox;
  uint64_t sequence = 0;
  const std::function<Message(double)> all_at = [&](double x) -> Message {
    std::vector<CarPose> poses;
    for (int k = 0; k < cars; ++k) poses.push_back({std::to_string(k), pose_at(x, 4 * k), {speed, 0, 0}});
    return {"host/game/poses", host::poses(++sequence, poses)};
  };
  Inbox inbox = {{"host/game/obstacles", host::obstacles(1, {front_wall})}};
  for (int k = 0; k < cars; ++k)
    inbox.push_back({"car/" + std::to_string(k), host::spawn(box()->hash, "game", pose_at(0, 4 * k))});
  inbox.push_back(all_at(0));
  const bool rest = speed > 0;
  const auto at_rest = [&] {
    return std::all_of(world->cars.begin(), world->cars.end(),
                       [&](const auto& one) { return one.second.body.settled && one.second.body.touching == rest; });
  };
  for (int k = 0; k < 200 && !(k > 2 && at_rest()); ++k) {
    tick(*world, inbox, outbox, 1);
    speed = 0;
    inbox = {all_at(rest ? 0.3 : 0)};
  }
  ASSERT_TRUE(at_rest());
  inbox.clear();
  inbox.push_back(budget_message(1));
  wake(inbox, all_at);
  tick(*world, inbox, outbox, 1);
  for (const auto& [id, car] : world->cars) EXPECT_EQ(car.result.sweeps, 4u) << "as few as there may be";
}

TEST(Budget, CountsCarsThatRestAgainstAWallWhenTheirHostPutsThemElsewhere) {
  expect_woken_within_the_budget(12, [](Inbox& inbox, const auto& all_at) { inbox.push_back(all_at(-20)); });
}
TEST(Budget, CountsCarsThatRestAgainstAWallWhenItIsTakenAway) {
  expect_woken_within_the_budget(12, [](Inbox& inbox, const auto&) {
    inbox.push_back({"host/game/obstacles", host::obstacles(2, {})});
  });
}
TEST(Budget, CountsCarsThatStandWhenTheyArePutIntoAWall) {
  expect_woken_within_the_budget(0, [](Inbox& inbox, const auto& all_at) { inbox.push_back(all_at(0.2)); });
}
TEST(Budget, CountsCarsThatStandWhenAWallIsPutIntoThem) {
  expect_woken_within_the_budget(0, [](Inbox& inbox, const auto&) {
    host::Thing wall = front_wall;
    wall.pose = pose_at(2.25 + 0.3, 0, 1);
    inbox.push_back({"host/game/obstacles", host::obstacles(2, {wall})});
  });
}

// At 240 ticks a second a tick is as long as a sub-step, so there is nothing to halve.
TEST(Budget, TakesNoSubstepsAwayWhereATickIsOne) {
  const WorldHandle world = make_world(240, 0.0005f);
  add_asset(*world, box());
  Outbox outbox;
  tick(*world,
       {budget_message(1),
        {"car/a", host::spawn(box()->hash, "game", pose_at(0))},
        {"host/game/obstacles", host::obstacles(1, {front_wall})},
        {"host/game/poses", host::poses(1, {{"a", pose_at(0), {12, 0, 0}}})}},
       outbox, 1);
  EXPECT_EQ(world->cars.at("a").result.sweeps, 4u);
}

// Presses a car of this many cells against a wall for its first tick, with almost no budget.
StepResult pressed(const BoxCells& cells) {
  const auto fine = box_car(cells, 2000);
  const WorldHandle world = make_world(60, 0.0005f);
  add_asset(*world, fine);
  Outbox outbox;
  tick(*world,
       {budget_message(1),
        {"car/a", host::spawn(fine->hash, "game", pose_at(0))},
        {"host/game/obstacles", host::obstacles(1, {{1, schema::Shape::box, {0.5f, 50, 5}, pose_at(2.77, 0, 1)}})},
        {"host/game/poses", host::poses(1, {{"a", pose_at(0), {12, 0, 0}}})}},
       outbox, 1);
  return world->cars.at("a").result;
}

TEST(Budget, LeavesAFineMeshItsSubsteps) {
  const StepResult fine = pressed({30, 16, 8});
  EXPECT_EQ(fine.substeps, 4u);
  EXPECT_EQ(fine.sweeps, 4 * 4u);
}

TEST(Budget, LeavesLongerSubstepsMoreSweepsWhereTheMeshIsNotTooCoarse) {
  const StepResult middling = pressed({14, 8, 5});
  EXPECT_EQ(middling.substeps, 2u);
  EXPECT_EQ(middling.sweeps, 2 * 8u);
}

TEST(Budget, GivesTheSameBitsForAnyThreadCountAndWhenItIsFedAgain) {
  const tbb::global_control four(tbb::global_control::max_allowed_parallelism, 4);
  const auto changing = [](int threads) {
    return pile_up([](int k) { return k % 3 == 0 ? std::optional<uint64_t>(40'000 + 9'000 * k) : std::nullopt; }, threads)
        .hashes;
  };
  const auto one = changing(1);
  EXPECT_EQ(changing(1), one);
  EXPECT_EQ(changing(4), one);
  EXPECT_NE(one, unlimited().hashes);
}

}  // namespace
}  // namespace crumple

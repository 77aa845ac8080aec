// The active set against the full solve (`tolerance` 0), its slow twin, and what must wake the whole body.
#include <gtest/gtest.h>

#include "crash.h"
#include "sanitized.h"
#include "sim/flow.h"
#include "sim/scratch.h"
#include "sim/transfer.h"

namespace crumple {
namespace {

const std::shared_ptr<const Car>& fine_car() {
  static const auto car = box_car({18, 7, 6});
  return car;
}

// Root of the mean squared distance of the nodes, as a share of the largest displacement.
double difference(const Crash& one, const Crash& other) {
  double sum = 0, most = 0;
  for (size_t i = 0; i < one.body.node.size(); ++i) {
    sum += double((one.body.node[i] - other.body.node[i]).squaredNorm());
    most = std::max(most, double((other.body.node[i] - other.model.node[i]).norm()));
  }
  return std::sqrt(sum / double(one.body.node.size())) / most;
}

// A crash, and the same one solved in full.
struct Twins {
  Crash crash, full;
  uint64_t work = 0, full_work = 0;  // tets visited by one sweep of each sub-step

  explicit Twins(BoxCells cells = {18, 7, 6}) : crash(box_car(cells)), full(crash.car) { full.parameters.tolerance = 0; }
  template <class Visit>
  void both(const Visit& visit) {
    visit(crash);
    visit(full);
  }
  void tick() {
    const auto visits = [](const StepResult& result) {
      return result.sweeps > 0 ? result.substeps * result.work / result.sweeps : 0;
    };
    work += visits(crash.tick());
    full_work += visits(full.tick());
  }
};

// A threshold in metres would fail here: the slower the push, the more of it such a threshold hides. The slowest one is 2.5
// mm/s: at less than settle_speed an obstacle wakes no body that rests against it, in the full solve neither.
TEST(ActiveSet, APushEndsWithinOnePercentOfTheFullSolveHoweverSlowItIs) {
  for (const int ticks : {20, 120, 400, 2400}) {
    if (sanitized && ticks > 120) break;  // minutes
    Twins twins(ticks > 400 ? BoxCells{12, 5, 4} : BoxCells{18, 7, 6});
    twins.full.parameters.iterations = ticks > 400 ? 12 : 40;
    twins.both([&](Crash& crash) {
      crash.scripted();
      Obstacle post;
      make_box({0.5f, 0.2f, 5}, post);
      post.pose.position = {crash.front + 0.5, 0.5, 0};
      post.velocity = {-0.1 / (ticks * tick_seconds), 0, 0};
      crash.obstacles = {post};
    });
    for (int k = 0; k < ticks; ++k) twins.tick();
    EXPECT_GT(twins.full.crush(), 0.095);
    EXPECT_LT(difference(twins.crash, twins.full), 0.01) << ticks;
    EXPECT_LT(double(twins.work), 0.8 * double(twins.full_work)) << ticks;
  }
}

TEST(ActiveSet, TapsInTurnEndWhereTheFullSolveEnds) {
  Twins twins;
  for (int tap = 0; tap < (sanitized ? 3 : 12); ++tap) {
    twins.both([](Crash& crash) {
      crash.motion = {};
      crash.motion.velocity = {5 / 3.6, 0, 0};
      crash.obstacles.clear();
      crash.wall(0.01 - crash.front + double(crash.body.high.x()));
    });
    for (int k = 0; k < 24; ++k) twins.tick();
    EXPECT_LT(difference(twins.crash, twins.full), 0.01) << tap;
    EXPECT_NEAR(twins.crash.body.absorbed, twins.full.body.absorbed, 0.01 * twins.full.body.absorbed) << tap;
  }
  EXPECT_LT(double(twins.work), 0.8 * double(twins.full_work));
}

// A post presses the rear of a car and stands, another one runs into its front. The first one vanishes in one tick, while the
// front moves: the rear is not solved with it, but must have sprung back before the car rests.
TEST(ActiveSet, APlaceThatIsLetGoWhileTheRestMovesSpringsBack) {
  Twins twins;
  const auto post = [](double x, double speed) {
    Obstacle out;
    make_box({0.5f, 0.2f, 5}, out);
    out.pose.position = {x, 0.5, 0};
    out.velocity.x() = speed;
    return out;
  };
  const double length = 2 * twins.crash.front;
  twins.both([&](Crash& crash) {
    crash.scripted();
    crash.obstacles = {post(crash.front + 0.5, -6), post(crash.front - length - 0.5, 1)};
  });
  for (int k = 0; k < 3; ++k) twins.tick();
  twins.both([](Crash& crash) { crash.obstacles[1].velocity.setZero(); });
  for (int k = 0; k < 3; ++k) twins.tick();
  twins.both([](Crash& crash) { crash.obstacles.pop_back(); });
  twins.tick();
  twins.both([](Crash& crash) { crash.obstacles[0].velocity.x() = 6; });
  for (int k = 0; k < 60; ++k) twins.tick();
  EXPECT_TRUE(twins.crash.body.settled);
  EXPECT_TRUE(twins.full.body.settled);
  EXPECT_LT(difference(twins.crash, twins.full), 0.01);
  EXPECT_NEAR(twins.crash.body.stored, twins.full.body.stored, 0.05 * twins.full.body.stored);
}

// The solver adds up only what changes.
TEST(ActiveSet, TheStoredEnergyIsThatOfAllTets) {
  Crash crash(fine_car());
  crash.motion.velocity = {8, 0, 0};
  crash.wall();
  const Elastic e = elastic(crash.parameters.region[0]);
  for (int k = 0; k < 40; ++k) {
    crash.tick();
    double sum = crash.body.anchors, largest = 1;
    for (size_t t = 0; t < crash.model.tet.size(); ++t) {
      const auto& [a, b, c, d] = crash.model.tet[t].node;
      const auto& node = crash.body.node;
      const Mat3 f = deformation(node[a], node[b], node[c], node[d], crash.body.gradients[t]);
      sum += double(energy_density(e, f) * crash.model.tet_rest[t]);
    }
    largest = std::max(largest, sum);
    EXPECT_NEAR(crash.body.stored, sum, 1e-4 * largest) << k;
  }
  EXPECT_LT(crash.scratch->solver.active.node.size(), crash.model.node.size());
}

// A wall presses the car for some sub-steps, and then something happens to the car. Returns whether the sub-step after it
// solves the whole car.
template <class Happens>
bool wakes_all(const Happens& happens) {
  Crash crash(fine_car());
  crash.scripted();
  crash.wall(0).velocity = {-1, 0, 0};
  const double substep = tick_seconds / crash.parameters.substeps;
  for (int k = 0; k < 24; ++k) {
    crash.tick(substep);
    EXPECT_FALSE(crash.scratch->solver.active.whole) << k;
  }
  happens(crash);
  crash.tick(substep);
  return crash.scratch->solver.active.whole;
}

TEST(ActiveSet, WhatHappensToTheWholeBodyWakesItAll) {
  EXPECT_FALSE(wakes_all([](Crash&) {}));
  EXPECT_TRUE(wakes_all([](Crash& crash) { crash.body.lost = true; })) << "a lost shape";
  EXPECT_TRUE(wakes_all([](Crash& crash) { repair(crash.model, 0.5f, crash.body); })) << "half a repair";
  EXPECT_FALSE(wakes_all([](Crash& crash) { repair(crash.model, 1, crash.body); })) << "an undamaged car";
  EXPECT_TRUE(wakes_all([](Crash& crash) { crash.body.step_seconds = 0; })) << "new parameters";
  EXPECT_TRUE(wakes_all([](Crash& crash) { crash.parameters.tolerance = 0; })) << "the full solve";
  // What a State keeps.
  EXPECT_TRUE(wakes_all([](Crash& crash) {
    DeformableState loaded = make_body(crash.model);
    loaded.node = crash.body.node;
    loaded.gradients = crash.body.gradients;
    loaded.hardening = crash.body.hardening;
    loaded.stored = crash.body.stored;
    crash.body = loaded;
  })) << "a loaded state";
}

}  // namespace
}  // namespace crumple

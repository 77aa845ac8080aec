// Tests the levels of a car: what a body keeps when it changes its mesh, and when the world changes the mesh.
#include "tick/levels.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>

#include "box_car.h"
#include "car/map_level.h"
#include "host.h"
#include "sanitized.h"
#include "sim/flow.h"
#include "tick/budget.h"
#include "tick/hash.h"
#include "tick/snapshot.h"
#include "tick/state.h"

namespace crumple {
namespace {

using host::CarPose;
using host::pose_at;
using host::Thing;

constexpr BoxCells drawn = {12, 6, 4};

const std::shared_ptr<const Car>& level(int which) {
  static const std::shared_ptr<const Car> cars[] = {
      read_car(box_car_bytes({12, 6, 4}, 1200, 4.5f, drawn), "fine"),
      read_car(box_car_bytes({8, 4, 3}, 1200, 4.5f, drawn), "middle"),
      read_car(box_car_bytes({5, 2, 2}, 1200, 4.5f, drawn), "coarse"),
  };
  return cars[which];
}

// ---- transfer ---------------------------------------------------------------------------------------------------------------

// A body after a uniform deformation of the whole car, of which the share `plastic` is permanent.
DeformableState evenly(const Model& model, const Eigen::Matrix3f& whole, const Eigen::Matrix3f& plastic) {
  DeformableState body = make_body(model);
  for (Vec3& node : body.node) node = whole * node;
  const Eigen::Matrix3f back = plastic.inverse();
  for (Gradients& gradients : body.gradients) {
    for (Vec3& corner : gradients.corner) corner = back.transpose() * corner;
  }
  std::fill(body.hardening.begin(), body.hardening.end(), 0.25f);
  body.settled = false;
  return body;
}

TEST(Transfer, OfAnUndamagedCarGivesAnUndamagedCarBitForBit) {
  for (int to : {1, 2}) {
    const LevelMap map = map_level(level(0)->model, level(to)->model);
    EXPECT_EQ(hash(transfer(level(0)->model, level(to)->model, map, make_body(level(0)->model))),
              hash(make_body(level(to)->model)));
  }
}

TEST(Transfer, OfAnEvenDeformationIsExactInShapeStressAndHardening) {
  const Model &from = level(0)->model, &to = level(2)->model;
  Eigen::Matrix3f whole, plastic;
  whole << 0.8f, 0.1f, 0, 0, 1.05f, 0, 0, 0, 1;
  plastic << 0.82f, 0, 0, 0, 1, 0, 0, 0, 1;
  const DeformableState body = evenly(from, whole, plastic);
  const DeformableState out = transfer(from, to, map_level(from, to), body);
  const Eigen::Matrix3f elastic = whole * plastic.inverse();
  int free = 0;
  for (size_t i = 0; i < to.node.size(); ++i) {
    if (to.node_anchored[i]) {
      EXPECT_EQ(out.node[i], to.node[i]);
    } else {
      EXPECT_LT((out.node[i] - whole * to.node[i]).norm(), 1e-5f);
    }
  }
  for (size_t t = 0; t < to.tet.size(); ++t) {
    const uint32_t* n = to.tet[t].node;
    const Mat3 f = deformation(out.node[n[0]], out.node[n[1]], out.node[n[2]], out.node[n[3]], out.gradients[t]);
    EXPECT_LT((f - elastic).norm(), 1e-4f) << "also where anchored nodes were put back to rest";
    EXPECT_EQ(out.hardening[t], 0.25f);
    free += !to.node_anchored[n[0]];
  }
  EXPECT_GT(free, 20);
}

TEST(Transfer, OfATurnedInsideOutTetKeepsItsFlowAndStaysFinite) {
  const Model &from = level(0)->model, &to = level(1)->model;
  Eigen::Matrix3f mirror = Eigen::Matrix3f::Identity();
  mirror(0, 0) = -1;
  const DeformableState body = evenly(from, mirror, Eigen::Matrix3f::Identity());
  const DeformableState out = transfer(from, to, map_level(from, to), body);
  for (size_t t = 0; t < to.tet.size(); ++t) {
    for (int k = 0; k < 3; ++k) {
      EXPECT_LT((out.gradients[t].corner[k] - to.gradients[t].corner[k]).norm(), 1e-3f * to.gradients[t].corner[k].norm());
    }
  }
}

TEST(Levels, AreCarsOfTheSameSurfaceOnly) {
  EXPECT_TRUE(same_surface(*level(0), *level(2)));
  EXPECT_FALSE(same_surface(*level(0), *box_car({12, 6, 5})));
}

// One surface, baked twice with two masses: there is no map between levels of the same size.
TEST(Levels, AreOneOfEachSizeWhateverTheOrderInWhichTheyAreGiven) {
  const auto heavy = read_car(box_car_bytes({5, 2, 2}, 2000, 4.5f, drawn), "heavy");
  std::vector<std::shared_ptr<const Car>> all = {level(0), level(1), level(2), heavy};
  std::sort(all.begin(), all.end());
  const std::string& kept = std::min(level(2)->hash, heavy->hash);
  int orders = 0;
  do {
    const WorldHandle world = make_world(60, 0.0005f);
    for (const auto& car : all) add_asset(*world, car);
    const Levels& levels = world->assets.at(level(0)->hash);
    ASSERT_EQ(levels.size(), 3u);
    EXPECT_EQ(levels[0], level(0));
    EXPECT_EQ(levels[1], level(1));
    EXPECT_EQ(levels[2]->hash, kept);
    for (size_t i = 0; i < 3; ++i) {
      for (size_t k = 0; k < 3; ++k) EXPECT_EQ(i != k, world->level_maps.contains({levels[i]->hash, levels[k]->hash}));
    }
  } while (!(sanitized && ++orders == 6) &&  // all orders of the last three
           std::next_permutation(all.begin(), all.end()));
}

// ---- the world --------------------------------------------------------------------------------------------------------------

struct Scene {
  WorldHandle world = make_world(60, 0.0005f);
  Outbox outbox;
  uint64_t sequence = 0;
  int threads = 1;

  Scene() {
    for (int which : {1, 2, 0}) add_asset(*world, level(which));
  }
  Work step(Inbox inbox = {}) { return tick(*world, inbox, outbox, threads).work; }
  void spawn(int which = 0) {
    step({{"car/a", host::spawn(level(which)->hash, "game"), 1}});
    EXPECT_TRUE(host::read_as<schema::Answer>(outbox.at(0).bytes)->ok());
  }
  // A standing car, scripted so that it keeps its place.
  Message pose(float importance, float speed = 0, double x = 0) {
    CarPose car{"a", pose_at(x), {speed, 0, 0}};
    car.importance = importance;
    return {"host/game/poses", host::poses(++sequence, {car})};
  }
  // A wall with its face at this distance ahead of the car's nose, or behind the tail of a car that stands at 0.
  Message wall(double gap) { return wall_at(2.75 + gap); }
  Message wall_behind(double gap) { return wall_at(-2.75 - gap); }
  Message wall_at(double x) {
    return {"host/game/obstacles", host::obstacles(++sequence, {{1, schema::Shape::box, {0.5f, 5, 5}, pose_at(x, 0, 1)}})};
  }
  Instance& car() { return world->cars.at("a"); }
  size_t nodes() { return car().body.node.size(); }
};

size_t nodes(int which) { return level(which)->model.node.size(); }

// The car drives into a wall and comes to rest before it. importance: from the first pose on.
void crash(Scene& scene, float importance) {
  scene.step({scene.wall(0.3)});
  for (int k = 0; k < 6; ++k) scene.step({scene.pose(importance, 12, 0.2 * k)});
  scene.step({scene.pose(importance, 0, -2)});
  for (int k = 0; k < 70; ++k) scene.step();
  EXPECT_TRUE(scene.car().body.settled);
}

TEST(Levels, FollowTheImportanceWhenSomethingComesNearAndNotBefore) {
  Scene scene;
  scene.spawn();
  scene.step({scene.pose(0.1f)});
  EXPECT_EQ(scene.nodes(), nodes(0)) << "nothing is near";
  scene.step({scene.wall(0.02), scene.pose(0.1f)});
  EXPECT_EQ(scene.nodes(), nodes(2));
  EXPECT_EQ(scene.car().body.node.size(), scene.car().car->model.node.size());
}

TEST(Levels, ChooseTheFinestThatHasNoMoreThanTheShareOfNodes) {
  const float middle = float(nodes(1)) / float(nodes(0));
  for (const auto& [importance, which] : std::vector<std::pair<float, int>>{
           {1.0f, 0}, {0.99f, 0}, {0.7f, 1}, {middle + 0.01f, 1}, {middle - 0.01f, 2}, {0.0f, 2}}) {
    Scene scene;
    scene.spawn();
    scene.step({scene.wall(0.02), scene.pose(importance)});
    EXPECT_EQ(scene.nodes(), nodes(which)) << importance;
  }
  Scene scene;
  scene.spawn(1);
  scene.step({scene.wall(0.02), scene.pose(1)});
  EXPECT_EQ(scene.nodes(), nodes(1)) << "none is finer than the asset that was asked for";
}

// One pole is as wide as the middle level's edges are long, another narrower than all edges: neither importance nor a budget
// may choose a coarser level.
TEST(Levels, AreNoCoarserThanWhatIsNearIsWide) {
  ASSERT_LT(level(1)->mean_edge, level(2)->mean_edge);
  for (const auto& [width, which] : std::vector<std::pair<float, int>>{{level(1)->mean_edge, 1}, {0.05f, 0}, {2, 2}}) {
    Scene scene;
    scene.spawn();
    const Thing pole{1, schema::Shape::capsule, {0.5f * width, 2, 0}, pose_at(2.3 + 3, 0, 1)};
    scene.step({{"host/game/obstacles", host::obstacles(++scene.sequence, {pole})}, scene.pose(0.1f, 12), budget_message(1)});
    EXPECT_EQ(scene.nodes(), nodes(which)) << width << " m";
  }
}

TEST(Levels, ChangeAtMostOnceASecondAndDoNotFlapAboutAThreshold) {
  Scene scene;
  scene.spawn();
  scene.step({scene.wall(0.02)});
  std::vector<uint64_t> changes;
  size_t last = scene.nodes();
  for (int k = 0; k < 200; ++k) {
    scene.step({scene.pose(k % 2 ? 1.0f : 0.1f)});
    if (scene.nodes() != last) changes.push_back(tick_count(*scene.world));
    last = scene.nodes();
  }
  ASSERT_GE(changes.size(), 2u);
  for (size_t i = 1; i < changes.size(); ++i) EXPECT_GE(changes[i] - changes[i - 1], 60u);
  const float middle = float(nodes(1)) / float(nodes(0));
  for (int k = 0; k < 70; ++k) scene.step({scene.pose(0.7f)});
  ASSERT_EQ(scene.nodes(), nodes(1));
  for (int k = 0; k < 130; ++k) {
    scene.step({scene.pose(middle + (k % 2 ? 0.02f : -0.02f))});
    EXPECT_EQ(scene.nodes(), nodes(1));
  }
}

TEST(Levels, KeepTheDentAndViewersSeeNoJump) {
  Scene scene;
  scene.spawn();
  crash(scene, 1);
  ASSERT_EQ(scene.nodes(), nodes(0));
  const std::vector<int16_t> before = scene.car().told[0].latest;
  const double absorbed = scene.car().body.absorbed;
  host::Viewer viewer;
  viewer.surface.key = viewer.surface.quanta = scene.car().told[0].keyframe;
  viewer.surface.key_tick = viewer.surface.tick = scene.car().told[0].keyframe_tick;
  scene.step({scene.wall_behind(0.02), scene.pose(0.5f)});
  ASSERT_EQ(scene.nodes(), nodes(1));
  for (const Message& message : scene.outbox) viewer.take(message);
  const std::vector<int16_t>& after = scene.car().told[0].latest;
  EXPECT_EQ(viewer.held(), after) << "a change of level is told like any other";
  double change = 0, dent = 0;
  for (size_t i = 0; i < before.size(); ++i) {
    change += std::pow(double(after[i] - before[i]), 2);
    dent = std::max(dent, std::fabs(double(before[i])));
  }
  change = std::sqrt(change / double(before.size() / 3));
  EXPECT_GT(dent, 400) << "a dent of at least 0.2 m, in quanta";
  EXPECT_GT(change, 0);
  EXPECT_LT(change, 0.1 * dent);
  EXPECT_EQ(scene.car().body.absorbed, absorbed);
  scene.step({{"car/a/key/0", {}, 7}});
  for (const Message& message : scene.outbox) {
    if (message.ticket != 7) continue;
    EXPECT_EQ(host::read_as<schema::Keyframe>(message.bytes)->asset()->str(), level(0)->hash);
  }
}

TEST(Levels, WaitWhileAnObstacleTouches) {
  Scene scene;
  scene.spawn();
  scene.step({scene.wall(0.1), scene.pose(1, 12)});
  ASSERT_TRUE(scene.car().body.touching);
  scene.step({scene.pose(0.1f, 12, 0.2)});
  ASSERT_TRUE(scene.car().body.touching);
  EXPECT_EQ(scene.nodes(), nodes(0));
}

// Three cars will hit a wall within half a second; the second car has the highest importance. changed: the car has just changed
// its level. Returns their numbers of nodes.
std::vector<size_t> before_a_pile_up(double share_of_what_three_fine_cars_take, float least = 0.5f, const char* changed = "") {
  Scene scene;
  Inbox inbox = {scene.wall(3)};
  std::vector<CarPose> poses;
  for (int k = 0; k < 3; ++k) {
    const std::string id(1, char('a' + k));
    inbox.push_back({"car/" + id, host::spawn(level(0)->hash, "game", pose_at(0, 3 * (k - 1)))});
    poses.push_back({id, pose_at(0, 3 * (k - 1)), {12, 0, 0}});
    poses.back().importance = k == 1 ? 1 : least;
  }
  inbox.push_back({"host/game/poses", host::poses(++scene.sequence, poses)});
  scene.step(inbox);
  for (auto& [id, car] : scene.world->cars) {
    if (id == changed) car.level_tick = tick_count(*scene.world);
  }
  const double fine = crash_work(*scene.world, scene.car(), *level(0));
  scene.step({budget_message(uint64_t(share_of_what_three_fine_cars_take * 3 * fine))});
  std::vector<size_t> out;
  for (const auto& [id, car] : scene.world->cars) out.push_back(car.body.node.size());
  return out;
}

TEST(Levels, AreNoFinerThanTheBudgetHasRoomForWhereCarsAreAboutToBeHit) {
  using Nodes = std::vector<size_t>;
  EXPECT_EQ(before_a_pile_up(1, 1), (Nodes{nodes(0), nodes(0), nodes(0)}));
  EXPECT_EQ(before_a_pile_up(0.001, 1), (Nodes{nodes(2), nodes(2), nodes(2)}));
  EXPECT_EQ(before_a_pile_up(0.6, 0.9f), (Nodes{nodes(1), nodes(0), nodes(1)})) << "those that matter less go first";
  EXPECT_EQ(before_a_pile_up(0.6, 0.9f, "a"), (Nodes{nodes(0), nodes(1), nodes(1)})) << "what may not change makes no room";
}

TEST(Levels, ComeBackToAFinerOneOnlyWhereTheBudgetHasRoomToSpare) {
  for (const auto& [share, which] : std::vector<std::pair<double, int>>{{1.1, 2}, {1.3, 0}}) {
    Scene scene;
    scene.spawn();
    scene.step({scene.wall(8), scene.pose(0.1f, 12)});
    const double fine = crash_work(*scene.world, scene.car(), *level(0));
    scene.step({scene.wall(4), scene.pose(0.1f, 12)});
    ASSERT_EQ(scene.nodes(), nodes(2));
    for (int k = 0; k < 70; ++k) scene.step({scene.wall(40), scene.pose(1, 12)});
    scene.step({scene.wall(4), scene.pose(1, 12), budget_message(uint64_t(share * fine))});
    EXPECT_EQ(scene.nodes(), nodes(which)) << share;
  }
}

TEST(Levels, OfCarsThatStandBesideSomethingDoNotFollowTheBudget) {
  Scene scene;
  scene.spawn();
  for (int k = 0; k < 5; ++k) scene.step({scene.wall(0.02), scene.pose(1), budget_message(1)});
  EXPECT_EQ(scene.nodes(), nodes(0));
  scene.step({scene.pose(1, 5)});
  EXPECT_EQ(scene.nodes(), nodes(2));
}

TEST(Levels, ASavedStateIsLoadedOnItsOwnLevel) {
  Scene scene, other;
  scene.spawn();
  crash(scene, 0.1f);
  ASSERT_EQ(scene.nodes(), nodes(2));
  scene.step({{"car/a", host::save(), 3}});
  const auto* answer = host::read_as<schema::Answer>(scene.outbox.at(0).bytes);
  const auto* data = reinterpret_cast<const std::byte*>(answer->state()->data());
  const Bytes state(data, data + answer->state()->size());
  other.spawn();
  other.step({{"car/a", host::load(state), 4}});
  const auto* loaded = host::read_as<schema::Answer>(other.outbox.at(0).bytes);
  EXPECT_TRUE(loaded->ok()) << (loaded->sentence() ? loaded->sentence()->str() : "");
  EXPECT_EQ(other.nodes(), nodes(2));
  EXPECT_EQ(other.car().told[0].latest, scene.car().told[0].latest);
}

// Forty cars before a wall, more than a worker takes at once. Half of them change their level in the same tick, with a budget.
void drive_forty(Scene& scene) {
  Inbox inbox = {scene.wall(1.5)};
  std::vector<CarPose> poses;
  for (int k = 0; k < 40; ++k) {
    const std::string id = "car" + std::to_string(k);
    inbox.push_back({"car/" + id, host::spawn(level(0)->hash, "game", pose_at(0, 0.2 * k - 4))});
    poses.push_back({id, pose_at(0, 0.2 * k - 4), {12, 0, 0}});
    poses.back().importance = k % 2 ? 1.0f : k % 4 ? 0.5f : 0.1f;
  }
  inbox.push_back({"host/game/poses", host::poses(++scene.sequence, poses)});
  inbox.push_back(budget_message(3'000'000));
  scene.step(inbox);
}

std::vector<uint64_t> hashes(int threads) {
  Scene scene;
  scene.threads = threads;
  drive_forty(scene);
  std::vector<uint64_t> out;
  std::map<size_t, int> sizes;
  uint64_t most = 0;
  for (int k = 0; k < 25; ++k) {
    out.push_back(hash(*scene.world));
    most = std::max(most, scene.step().done);
  }
  for (const auto& [id, car] : scene.world->cars) ++sizes[car.body.node.size()];
  EXPECT_GE(sizes.size(), 2u);
  EXPECT_GT(most, 0u);
  return out;
}

TEST(Levels, AWorldSavedInMidCrashOnABudgetGoesOnBitForBit) {
  for (int ticks : {1, 8, 9}) {
    if (sanitized && ticks != 8) continue;  // the same code
    Scene scene, copy;
    drive_forty(scene);
    for (int k = 1; k < ticks; ++k) scene.step();
    load_world(save_world(*scene.world), *copy.world);
    uint64_t most = 0;
    for (int k = 0; k < 30; ++k) {
      Inbox inbox;
      if (k == 15) inbox = {budget_message(200'000)};
      most = std::max(most, scene.step(inbox).done);
      copy.step(inbox);
      ASSERT_EQ(hash(*copy.world), hash(*scene.world)) << ticks << " and " << k << " ticks";
    }
    EXPECT_GT(most, 0u) << ticks;
  }
}

TEST(Levels, AreTheSameBitForBitForAnyThreadCount) {
  const tbb::global_control four(tbb::global_control::max_allowed_parallelism, 4);
  const auto one = hashes(1);
  EXPECT_EQ(hashes(1), one);
  EXPECT_EQ(hashes(4), one);
}

}  // namespace
}  // namespace crumple

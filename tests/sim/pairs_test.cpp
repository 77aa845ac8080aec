// Tests of cars that touch each other: laws that hold in every scene, and answers that are known.
#include "sim/pairs.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "box_car.h"
#include "crash.h"
#include "reference/pile_up.h"
#include "sanitized.h"

namespace crumple {
namespace {

using Eigen::Vector3d;

constexpr double pi = 3.14159265358979;
constexpr double half = 2.25;  // length of the box car, m

double rms_difference(const std::vector<Vec3>& a, const std::vector<Vec3>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += (a[i] - b[i]).squaredNorm();
  return std::sqrt(sum / double(a.size()));
}

// Two cars 5 cm apart that drive at each other at v and w, m/s. aside: how far the second is to the left of the first's way, m.
PileUp head_on(double v, double w, double aside = 0) {
  PileUp scene;
  scene.add(box_car(), -half - 0.025, 0, 0, v);
  scene.add(box_car(), half + 0.025, aside, pi, w);
  return scene;
}

// What the laws below keep: scenes with every kind of touch.
struct Scene {
  const char* name;
  PileUp pile_up;
};
std::vector<Scene> scenes() {
  std::vector<Scene> all;
  all.push_back({"head-on", head_on(14, 14)});
  all.push_back({"offset", head_on(14, 14, 0.9)});
  all.push_back({"side-swipe", head_on(14, 14, 1.75)});
  PileUp t_bone;
  t_bone.add(box_car(), 0, -half - 0.95, pi / 2, 14);
  t_bone.add(box_car(), -1.2, 0, 0, 0);
  all.push_back({"T-bone", std::move(t_bone)});
  PileUp queue;
  for (int k = 0; k < 3; ++k) queue.add(box_car(), k * (2 * half + 0.1), 0, 0, k == 0 ? 18 : 0);
  all.push_back({"queue", std::move(queue)});
  PileUp unlike;
  unlike.add(box_car({5, 3, 2}, 800), -half - 0.025, 0, 0, 20);
  unlike.add(box_car({9, 4, 3}, 3000, 5), 2.7, 0.3, pi - 0.2, 5);
  for (Material& material : unlike.cars[1].parameters.region) material.young_modulus *= 2;
  all.push_back({"unlike", std::move(unlike)});
  return all;
}

TEST(Pairs, TheBoundaryIsTheOutsideOfTheTets) {
  const auto car = box_car({2, 1, 1});
  EXPECT_EQ(car->boundary.node.size(), 12u);
  ASSERT_EQ(car->boundary.triangle.size(), 2u * 2 * (1 + 2 + 2));
  double volume = 0;  // by the divergence theorem: that of the box, if all triangles face outward
  for (const auto& t : car->boundary.triangle) {
    const Vec3 &a = car->model.node[t[0]], &b = car->model.node[t[1]], &c = car->model.node[t[2]];
    volume += double(a.dot(b.cross(c))) / 6;
  }
  EXPECT_NEAR(volume, 4.5 * 1.8 * 1.5, 1e-4);
}

TEST(Law, CarsThatTouchKeepTheirMomentumAndTheirSpin) {
  for (Scene& scene : scenes()) {
    SCOPED_TRACE(scene.name);
    PileUp& cars = scene.pile_up;
    const Vector3d momentum = cars.momentum(), spin = cars.angular_momentum();
    double size = 0;
    for (const CrashCar& car : cars.cars) size += car.mass.mass * car.motion.velocity.norm();
    cars.run(0.3);
    EXPECT_GT(cars.cars[1].impulse.norm(), 0.1 * size);
    EXPECT_LT((cars.momentum() - momentum).norm(), 1e-12 * size);
    // Planar cars turn about the vertical axis only.
    EXPECT_LT(std::fabs(cars.angular_momentum().z() - spin.z()), 1e-10 * size);
  }
}

TEST(Law, CarsThatTouchFindTheEnergyThatTheyBrought) {
  for (Scene& scene : scenes()) {
    SCOPED_TRACE(scene.name);
    PileUp& cars = scene.pile_up;
    const double brought = cars.kinetic();
    for (int k = 0; k < 20; ++k) {
      cars.tick();
      EXPECT_LT(cars.energy(), 1.01 * brought) << "tick " << k;
    }
    EXPECT_GT(cars.energy(), 0.98 * brought);
    EXPECT_LT(cars.kinetic(), 0.8 * brought);
  }
}

TEST(Law, RandomCrashesFindTheEnergyThatTheyBrought) {
  const auto car = box_car({9, 4, 3}, 1200);
  for (uint32_t seed = 0; seed < (sanitized ? 10 : 60); ++seed) {
    SCOPED_TRACE(seed);
    PileUp cars = random_crash(car, seed);
    const double brought = cars.kinetic();
    double most = 0;
    for (int k = 0; k < 30; ++k) {
      cars.tick();
      most = std::max(most, cars.energy());
    }
    EXPECT_GT(cars.energy(), 0.97 * brought);
    EXPECT_LT(most, 1.02 * brought);  // corners of so coarse a box slip past each other
    EXPECT_LT(cars.kinetic(), brought);
  }
}

TEST(Law, CarsRubWithTheGeometricMeanOfTheirFriction) {
  const auto sideways = [](float first, float second) {
    PileUp scene = head_on(8, 8);
    scene.cars[0].motion.velocity.y() = 6;
    for (Material& material : scene.cars[0].parameters.region) material.friction = first;
    for (Material& material : scene.cars[1].parameters.region) material.friction = second;
    scene.run(0.1);
    const Vector3d& impulse = scene.cars[1].impulse;
    return impulse.y() / impulse.norm();
  };
  EXPECT_NEAR(sideways(0, 0.8f), sideways(0, 0), 1e-6);
  EXPECT_NEAR(sideways(0.1f, 0.4f), sideways(0.2f, 0.2f), 1e-6);
  EXPECT_GT(sideways(0.1f, 0.1f), sideways(0, 0) + 0.05);
  EXPECT_GT(sideways(0.2f, 0.2f), sideways(0.1f, 0.1f) + 0.005);  // with more, the boxes stick
}

TEST(Law, TwoCarsInEachOthersWayCrushAsInAFrictionlessWall) {
  for (const double v : {5.0, 8.0}) {  // faster, corners of the two equal boxes slip past each other
    PileUp wall = head_on(v, 0), pair = head_on(v, v);
    wall.cars.pop_back();
    Obstacle& plane = wall.obstacles.emplace_back();
    make_box({0.5f, 5, 5}, plane);
    plane.pose.position.x() = 0.5;
    plane.friction = 0;
    wall.run(0.3);
    pair.run(0.3);
    const double crush = wall.cars[0].nose_crush();
    EXPECT_GT(crush, 0.02);
    EXPECT_NEAR(pair.cars[0].nose_crush(), crush, 0.02 * crush);
    EXPECT_NEAR(pair.cars[1].nose_crush(), crush, 0.02 * crush);
    EXPECT_NEAR(pair.cars[0].motion.velocity.x() / v, wall.cars[0].motion.velocity.x() / v, 0.01);
  }
}

TEST(Law, OnlyTheWayOfTheCarsAgainstEachOtherCounts) {
  PileUp even = head_on(14, 14), odd = head_on(28, 0);
  even.run(0.2);
  odd.run(0.2);
  for (int k = 0; k < 2; ++k) EXPECT_LT(rms_difference(even.cars[k].body.node, odd.cars[k].body.node), 2e-4);
}

TEST(Law, TheOrderOfTheCarsChangesNothing) {
  PileUp one = head_on(14, 10, 0.4), other;
  other.add(box_car(), half + 0.025, 0.4, pi, 10);
  other.add(box_car(), -half - 0.025, 0, 0, 14);
  one.run(0.2);
  other.run(0.2);
  for (int k = 0; k < 2; ++k)
    EXPECT_LT(rms_difference(one.cars[k].body.node, other.cars[1 - k].body.node), 2e-4);  // sums round differently
}

TEST(Law, AMovedAndTurnedPairGivesTheSameDents) {
  PileUp here = head_on(14, 10, 0.4), there = head_on(14, 10, 0.4);
  const Eigen::Quaterniond turn(Eigen::AngleAxisd(2.1, Vector3d::UnitZ()));
  for (CrashCar& car : there.cars) {
    car.motion.pose.position = turn * car.motion.pose.position + Vector3d(900, -400, 3);
    car.motion.pose.orientation = turn * car.motion.pose.orientation;
    car.motion.velocity = turn * car.motion.velocity + Vector3d(30, 5, 0);
  }
  here.run(0.2);
  there.run(0.2);
  for (int k = 0; k < 2; ++k) EXPECT_LT(rms_difference(here.cars[k].body.node, there.cars[k].body.node), 1e-4);
}

// Cars of an island that do not touch do not know of each other: bit for bit.
TEST(Law, ACarAloneDoesNotNoticeWhoElseIsNear) {
  Crash alone;
  alone.wall();
  alone.motion.velocity.x() = 14;
  PileUp with;
  with.cars.reserve(2);
  CrashCar& first = with.add(alone.car, 0, 0, 0, 14);
  first.motion = alone.motion;
  with.add(box_car(), 0, 4, 0, 14);  // 2.2 m beside it, into the same wall
  with.obstacles = alone.obstacles;
  for (int k = 0; k < 10; ++k) {
    alone.tick();
    with.tick();
  }
  EXPECT_GT(alone.crush(), 0.1);
  EXPECT_EQ(hash(alone.body), hash(with.cars[0].body));
}

TEST(Law, NoCarEndsInsideAnother) {
  for (Scene& scene : scenes()) {
    SCOPED_TRACE(scene.name);
    scene.pile_up.run(0.1);  // in the middle of the crash
    for (const CrashCar& a : scene.pile_up.cars) {
      for (const CrashCar& b : scene.pile_up.cars) EXPECT_LT(&a == &b ? 0 : measure_overlap(a, b).node, 2e-3);
    }
  }
}

TEST(Law, CarsThatMetComeToRestAndCostNothing) {
  PileUp cars = head_on(6, 6);
  cars.run(2);
  for (const CrashCar& car : cars.cars) {
    EXPECT_TRUE(car.body.settled);
    EXPECT_EQ(car.last.substeps, 0u);
  }
}

TEST(Law, ACarOnAScriptedPathGivesWayToNobody) {
  PileUp cars = head_on(10, 10);
  cars.cars[1].mass.mass = std::numeric_limits<double>::infinity();
  cars.cars[1].mass.inertia.setConstant(cars.cars[1].mass.mass);
  cars.run(0.3);
  EXPECT_EQ(cars.cars[1].motion.velocity.x(), -10);
  EXPECT_LT(cars.cars[0].motion.velocity.x(), -10);  // thrown back by something that comes on
  EXPECT_GT(cars.cars[0].motion.velocity.x(), -18);
  EXPECT_GT(cars.cars[0].nose_crush(), 0.1);
}

// A car is pulled against one that gives way to nobody, as by its weight, for minutes: from the front, and on its roof.
TEST(Law, ACarThatLeansOrLiesOnAnotherDoesNotCreep) {
  const int ticks = sanitized ? 600 : 10'000;
  for (const bool roof : {false, true}) {
    SCOPED_TRACE(roof ? "lies" : "leans");
    PileUp scene;
    scene.cars.reserve(2);
    CrashCar& below = scene.add(box_car({5, 3, 2}), 0, 0, 0, 0);
    below.mass.mass = std::numeric_limits<double>::infinity();
    below.mass.inertia.setConstant(below.mass.mass);
    CrashCar& resting = scene.add(box_car({5, 3, 2}), roof ? 0.3 : -2 * half - 0.005, 0.1, 0, 0);
    if (roof) {
      resting.motion.pose.orientation = Eigen::AngleAxisd(pi, Vector3d::UnitX());
      resting.motion.pose.position = {0.3, 0.1, 3.005};
      resting.mass.planar = false;
    }
    resting.pull = roof ? Vector3d(0, 0, -9.81) : Vector3d(3, 0, 0);
    std::vector<Vec3> early;
    Vector3d place = Vector3d::Zero();
    for (int tick = 0; tick < ticks; ++tick) {
      scene.tick();
      if (tick == 119) early = resting.body.node, place = resting.motion.pose.position;
    }
    EXPECT_LT(rms_difference(early, resting.body.node), 1e-4);
    EXPECT_LT((resting.motion.pose.position - place).norm(), roof ? 5e-3 : 1e-3);
    EXPECT_LT(resting.motion.velocity.norm(), 0.2);
    EXPECT_LT(measure_overlap(resting, below).node, 2e-3);
    EXPECT_GT(resting.impulse.norm(), 0.99 * resting.pull.norm() * resting.mass.mass * ticks / 60);
  }
}

TEST(Law, ABlockThatIsACarIsAWall) {
  const auto crash = [](bool wall) {
    PileUp scene;
    scene.cars.reserve(2);
    CrashCar& car = scene.add(box_car(), -half - 0.025, 0, 0, 12);
    car.parameters.region[0].friction = 0;
    if (wall) {
      Obstacle& plane = scene.obstacles.emplace_back();
      make_box({0.5f, 5, 5}, plane);
      plane.pose.position.x() = 0.5;
      plane.friction = 0;
    } else {
      CrashCar& block = scene.add(box_car({3, 3, 3}, 1200, 12), 6, 0, 0, 0);
      block.mass.mass = 1e9;
      block.mass.inertia.setConstant(1e10);
      block.motion.pose.position.z() = -1.1;
      block.parameters.region[0].young_modulus *= 100;
      block.parameters.region[0].friction = 0;
    }
    scene.run(0.3);
    return std::move(scene.cars[0]);
  };
  const CrashCar wall = crash(true), block = crash(false);
  EXPECT_GT(wall.nose_crush(), 0.1);
  EXPECT_NEAR(block.nose_crush(), wall.nose_crush(), 0.01 * wall.nose_crush());
  EXPECT_NEAR(block.motion.velocity.x(), wall.motion.velocity.x(), 0.01 * 12);
  EXPECT_LT(rms_difference(block.body.node, wall.body.node), 2e-3);
}

// Where methods fail: everything stays finite, and no energy comes from nowhere.
TEST(Law, HostileScenesOfCarsAreSurvived) {
  const auto rigid = [](CrashCar& car) {
    car.mass.mass = std::numeric_limits<double>::infinity();
    car.mass.inertia.setConstant(car.mass.mass);
  };
  const auto plane = [](PileUp& scene, const Vec3& size, const Vector3d& at) {
    Obstacle& obstacle = scene.obstacles.emplace_back();
    make_box(size, obstacle);
    obstacle.pose.position = at;
  };
  std::vector<Scene> all;
  all.push_back({"1 : 1,000,000", head_on(14, 14)});
  all.back().pile_up.cars[1].mass.mass *= 1e6;
  all.back().pile_up.cars[1].mass.inertia *= 1e6;
  all.push_back({"1 : 1,000 in stiffness", head_on(14, 14)});
  all.back().pile_up.cars[1].parameters.region[0].young_modulus *= 1000;
  all.push_back({"born inside", head_on(-1, -1)});
  all.back().pile_up.cars[0].motion.pose.position.x() += 0.4;
  PileUp crushed;
  crushed.add(box_car(), 0, 0, 0, 0);
  rigid(crushed.add(box_car(), -2 * half - 0.01, 0, 0, 3));
  plane(crushed, {0.5f, 5, 5}, {half + 0.51, 0, 0});
  all.push_back({"between a wall and a car that comes on", std::move(crushed)});
  PileUp box;
  for (int k = 0; k < 20; ++k)
    box.add(box_car({5, 3, 2}), (k % 4) * 5 - 7.5, (k / 4) * 2.2 - 4.4, 0.05 * ((k * 7) % 5 - 2), 4 * ((k * 3) % 5 - 2));
  for (const double side : {-1.0, 1.0}) {
    plane(box, {0.5f, 12, 5}, {side * 11, 0, 0});
    plane(box, {12, 0.5f, 5}, {0, side * 6.8, 0});
  }
  all.push_back({"20 in a box", std::move(box)});
  PileUp spinning;
  for (int k = 0; k < 4; ++k) spinning.add(box_car({5, 3, 2}), 0, k * 1.9, 0, 0);
  spinning.add(box_car(), 4.8, 2.5, 0, -5).motion.angular_velocity.z() = 20;
  all.push_back({"spinning into a row", std::move(spinning)});
  for (Scene& scene : all) {
    SCOPED_TRACE(scene.name);
    PileUp& cars = scene.pile_up;
    const double brought = cars.kinetic();
    const bool driven = !std::isfinite(brought);  // a car of infinite mass brings as much energy as is asked for
    for (int k = 0; k < (sanitized ? 20 : 60); ++k) {
      cars.tick();
      for (const CrashCar& car : cars.cars) {
        ASSERT_TRUE(std::isfinite(car.largest_displacement())) << "tick " << k;
        ASSERT_TRUE(car.motion.pose.position.allFinite() && car.motion.velocity.allFinite()) << "tick " << k;
        EXPECT_LT(car.motion.velocity.norm(), 60) << "tick " << k;
      }
      if (!driven) {
        EXPECT_LT(cars.energy(), 1.01 * brought) << "tick " << k;
      }
    }
    if (!driven) {
      EXPECT_GT(cars.energy(), 0.9 * brought);
    }
  }
}

}  // namespace
}  // namespace crumple

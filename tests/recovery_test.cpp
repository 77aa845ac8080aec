// How `nodal` gets to its answer and back: mixing, bodies that have lost their shape, bodies that come to rest and are woken.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <random>

#include "kernel_body.h"

namespace crumple {
namespace {

using Vector3d = Eigen::Vector3d;

// ---- mixing -----------------------------------------------------------------------------------------------------------------

// A map x -> A x + b whose slowest part needs hundreds of steps, on 25 nodes of 28 places.
struct Linear {
  static constexpr size_t count = 25, places = 28;
  static constexpr float factor[5] = {0.995f, 0.97f, 0.8f, 0.3f, -0.6f};
  std::vector<Quad> solution = std::vector<Quad>(places);
  Scratch scratch;
  History history;

  Linear() {
    std::mt19937 random(2);
    std::normal_distribution<float> normal(0, 1);
    for (size_t i = 0; i < count; ++i) solution[i] = {normal(random), normal(random), normal(random), 0};
    scratch.node.assign(places, Quad{});
    begin_mixing(scratch);
  }
  void step() {
    scratch.from = scratch.node;
    for (size_t i = 0; i < count; ++i) {
      Quad& x = scratch.node[i];
      const Quad& s = solution[i];
      const float by = factor[i % 5];
      x = {s.x + by * (x.x - s.x), s.y + by * (x.y - s.y), s.z + by * (x.z - s.z), 0};
    }
  }
  void mix() {
    compare_step(scratch, history);
    crumple::mix(scratch, history);
  }
  double error() const {
    double sum = 0;
    for (size_t i = 0; i < count; ++i) {
      const Quad &x = scratch.node[i], &s = solution[i];
      sum += (Vec3(x.x, x.y, x.z) - Vec3(s.x, s.y, s.z)).squaredNorm();
    }
    return std::sqrt(sum);
  }
};

TEST(Mixing, SolvesInAFewStepsWhatPlainStepsNeedHundredsFor) {
  Linear mixed, plain;
  const double start = mixed.error();
  for (int k = 0; k < 12; ++k) {
    mixed.step();
    mixed.mix();
  }
  for (int k = 0; k < 100; ++k) plain.step();
  EXPECT_LT(mixed.error(), 2e-3 * start);
  EXPECT_GT(plain.error(), 0.2 * start);
  EXPECT_EQ(mixed.history.count, mixing_depth);
}

TEST(Mixing, WhatWasLearnedInOneSubstepServesTheNext) {
  for (const bool forget : {false, true}) {
    Linear linear;
    for (int k = 0; k < 7; ++k) {
      linear.step();
      linear.mix();
    }
    for (Quad& each : linear.solution) each = {1.2f * each.x, 1.2f * each.y, 1.2f * each.z, 0};  // the load grows
    const double start = linear.error();
    begin_mixing(linear.scratch);
    if (forget) linear.history = {};
    for (int k = 0; k < 2; ++k) {
      linear.step();
      linear.mix();
    }
    const double left = linear.error() / start;
    EXPECT_TRUE(forget ? left > 0.3 : left < 0.1) << left;
  }
}

TEST(Mixing, IsUndoneAndForgottenWhereItMadeTheResidualGrow) {
  Linear linear;
  for (int k = 0; k < 4; ++k) {
    linear.step();
    linear.mix();
  }
  for (auto& list : linear.history.result) {
    for (Quad& each : list) each = {1e4f * each.x, 1e4f * each.y, 1e4f * each.z, 0};  // the planted fault
  }
  linear.step();
  const std::vector<Quad> swept = linear.scratch.node;
  linear.mix();
  EXPECT_FALSE(same(swept, linear.scratch.node));
  linear.step();
  linear.mix();
  EXPECT_TRUE(same(swept, linear.scratch.node));
  EXPECT_EQ(linear.history.count, 0);
  const double start = linear.error();
  for (int k = 0; k < 12; ++k) {  // and it begins anew
    linear.step();
    linear.mix();
  }
  EXPECT_LT(linear.error(), 0.02 * start);
}

TEST(Mixing, DoesNotSeeWhatThePaddingOrTheLastCarLeft) {
  Linear clean, dirty;
  for (size_t i = Linear::count; i < Linear::places; ++i) dirty.scratch.node[i] = {3e5f, -7, 11, 13};
  const float none = std::numeric_limits<float>::quiet_NaN();
  for (auto* list : {&dirty.scratch.residual, &dirty.scratch.result, &dirty.scratch.unmixed, &dirty.scratch.from}) {
    list->assign(Linear::places + 100, Quad{none, none, none, none});
  }
  for (int k = 0; k < 10; ++k) {
    for (Linear* each : {&clean, &dirty}) {
      each->step();
      each->mix();
    }
    for (size_t i = 0; i < Linear::count; ++i) {
      ASSERT_EQ(std::memcmp(&clean.scratch.node[i], &dirty.scratch.node[i], sizeof(Quad)), 0) << "step " << k << ", node " << i;
    }
  }
}

// ---- bodies that have lost their shape or come to rest
// ------------------------------------------------------------------------

// A car whose path is law, and a wall that goes as it is told.
struct Scene {
  std::shared_ptr<const Car> car = box_car();
  const Model& model = car->model;
  Parameters parameters;
  Mass mass;
  Body body = make_body(model);
  Motion motion;
  std::vector<Obstacle> obstacles;
  ScratchHandle scratch = make_scratch();

  Scene() {
    mass.mass = std::numeric_limits<double>::infinity();
    mass.inertia.setConstant(mass.mass);
    mass.center = model.center_of_mass.cast<double>();
  }
  Obstacle& wall() {
    Obstacle wall;
    make_box({0.5f, 5, 5}, wall);
    wall.pose.position = {2.75, 0, 0};
    return obstacles.emplace_back(wall);
  }
  Response tick(double seconds = 1.0 / 60) {
    const Response response = deform(model, parameters, mass, obstacles, seconds, *scratch, body, motion);
    for (Obstacle& each : obstacles) each.pose = advance(each.pose, each.velocity, each.angular_velocity, seconds);
    return response;
  }
  void run(int ticks) {
    for (int k = 0; k < ticks; ++k) tick();
  }
  float farthest() const {
    float most = 0;
    for (size_t i = 0; i < body.node.size(); ++i) most = std::max(most, (body.node[i] - model.node[i]).norm());
    return most;
  }
  // How far a node stands in the wall, m.
  double inside() const {
    double most = -1;
    for (const Vec3& node : body.node) most = std::max(most, double(node.x()) - (obstacles[0].pose.position.x() - 0.5));
    return most;
  }
  // An elastic body under a wall that has come in 40 mm and stands.
  void press() {
    for (Material& material : parameters.region) material.yield = 0.2f;
    wall().velocity.x() = -0.6;
    run(4);
    obstacles[0].velocity.x() = 0;
    for (int k = 0; k < 300 && !body.settled; ++k) tick();
  }
};

TEST(LostShape, AMirroredBodySpringsBackAndHasNotFlowed) {
  for (int axis = 0; axis < 3; ++axis) {
    Scene scene;
    for (Vec3& node : scene.body.node) node[axis] = 2 * scene.model.center_of_mass[axis] - node[axis];
    measure_reach(scene.model, scene.body);
    scene.body.settled = false;
    scene.run(180);
    EXPECT_LT(scene.farthest(), 0.01f) << "axis " << axis;
    for (float kappa : scene.body.hardening) ASSERT_EQ(kappa, 0) << "axis " << axis;
  }
}

TEST(LostShape, ABodyWithANodeThatIsNoNumberHeals) {
  Scene scene;
  scene.body.node[7].y() = std::numeric_limits<float>::quiet_NaN();
  scene.body.settled = false;
  EXPECT_TRUE(scene.tick().recovered);
  for (const Vec3& node : scene.body.node) ASSERT_TRUE(node.allFinite());
  int undone = 0;
  for (int k = 0; k < 120; ++k) undone += scene.tick().recovered;
  EXPECT_EQ(undone, 0);
  EXPECT_LT(scene.farthest(), 1e-3f);
  EXPECT_TRUE(scene.body.settled);
}

TEST(LostShape, ATickThatIsUndoneInTheMiddleOfACrashForgetsWhatMixingKnew) {
  Scene scene;
  scene.wall().velocity.x() = -6;
  scene.run(4);
  EXPECT_GT(scene.body.history.count, 0);
  scene.body.node[7].y() = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(scene.tick().recovered);
  ASSERT_EQ(scene.body.history.count, 0);
  for (int k = 0; k < 4; ++k) EXPECT_FALSE(scene.tick().recovered);
  for (const Vec3& node : scene.body.node) ASSERT_TRUE(node.allFinite());
}

TEST(Rest, UnderALoadItCostsNothingAndStillTellsItsForce) {
  Scene scene;
  scene.press();
  ASSERT_TRUE(scene.body.settled);
  EXPECT_TRUE(scene.body.touching);
  const Vector3d force = scene.body.force;
  EXPECT_LT(force.x(), -1e4);
  // 40 mm over the 1.5 m in front of the cell, of 1.8 m x 1.5 m: E A strain, and a little more where the cell holds the rim.
  EXPECT_NEAR(force.x(), -double(scene.parameters.region[0].young_modulus) * 2.7 * 0.04 / 1.5, 0.25 * -force.x());
  const uint64_t before = hash(scene.body);
  for (int k = 0; k < 60; ++k) EXPECT_EQ(scene.tick().substeps, 0u);
  EXPECT_EQ(hash(scene.body), before);
  EXPECT_EQ(scene.body.force, force);
}

TEST(Rest, AnObstacleThatLeavesWakesIt) {
  for (const double speed : {1.0, 0.02}) {
    Scene scene;
    scene.press();
    ASSERT_TRUE(scene.body.settled);
    scene.obstacles[0].velocity.x() = speed;
    scene.run(int(60 * 0.025 / speed));  // while it is still within reach, the body follows it
    EXPECT_GT(scene.inside(), -3e-3) << speed << " m/s";
    scene.run(120 + int(60 * 0.05 / speed));
    EXPECT_TRUE(scene.body.settled);
    EXPECT_FALSE(scene.body.touching);
    EXPECT_LT(scene.farthest(), 1e-3f) << speed << " m/s";
    EXPECT_EQ(scene.body.force, Vector3d::Zero());
    for (float kappa : scene.body.hardening) ASSERT_EQ(kappa, 0);
  }
}

TEST(Rest, AnObstacleThatVanishesWakesIt) {
  Scene scene;
  scene.press();
  ASSERT_TRUE(scene.body.settled);
  scene.obstacles.clear();
  scene.run(120);
  EXPECT_TRUE(scene.body.settled);
  EXPECT_LT(scene.farthest(), 1e-3f);
  EXPECT_EQ(scene.body.force, Vector3d::Zero());
}

TEST(Rest, AnObstacleThatCreepsOnPushesIt) {
  for (const double speed : {0.3, 0.02}) {
    Scene scene;
    scene.press();
    ASSERT_TRUE(scene.body.settled);
    const double force = scene.body.force.x();
    scene.obstacles[0].velocity.x() = -speed;
    scene.run(int(60 * 0.03 / speed));
    EXPECT_LT(scene.inside(), 2e-3) << speed << " m/s";
    EXPECT_LT(scene.body.force.x(), 1.4 * force) << speed << " m/s";
  }
}

TEST(Rest, AnObstacleThatRubsAlongItDragsIt) {
  Scene scene;
  scene.press();
  ASSERT_TRUE(scene.body.settled);
  scene.obstacles[0].velocity.y() = 0.5;
  scene.run(12);
  EXPECT_GT(scene.body.force.y(), 1e3);
}

TEST(Rest, NodesOfTheCellStandAtRestAsSoonAsNothingTouchesThem) {
  Scene scene;
  for (Material& material : scene.parameters.region) material.young_modulus = 1e6f;
  Obstacle ball;
  make_sphere(1, ball);
  ball.pose.position = {0, 1.95, 0.75};  // beside the cell
  scene.obstacles.push_back(ball);
  float pushed = 0, adrift = 0;
  for (int k = 0; k < 80; ++k) {
    scene.obstacles[0].velocity.y() = k < 40 ? -3 : 3;
    if (scene.tick(1.0 / 480).substeps == 0) continue;
    for (size_t i = 0; i < scene.body.node.size(); ++i) {
      if (!scene.model.node_anchored[i]) continue;
      float& most = scene.scratch->contact_first[i] ? pushed : adrift;
      most = std::max(most, (scene.body.node[i] - scene.model.node[i]).norm());
    }
  }
  EXPECT_GT(pushed, 1e-3f);
  EXPECT_EQ(adrift, 0);
}

}  // namespace
}  // namespace crumple

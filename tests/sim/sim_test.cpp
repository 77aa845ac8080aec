// Tests the physics: doors with hand-calculated numbers, twins, and the laws that hold in every scene.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <random>

#include "crash.h"
#include "sanitized.h"
#include "sim/classic.h"
#include "sim/flow.h"
#include "sim/scratch.h"
#include "sim/wakes.h"

namespace crumple {
namespace {

double rms_difference(const std::vector<Vec3>& a, const std::vector<Vec3>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += (a[i] - b[i]).squaredNorm();
  return std::sqrt(sum / double(a.size()));
}

// ---- doors --------------------------------------------------------------------------------------------------------------

TEST(Classic, DistanceConstraintMovesBothEndsByHalfTheDifference) {
  const EdgeCorrection correction = distance_correction({0, 0, 0}, {3, 0, 0}, 2);
  EXPECT_EQ(correction.a, Vec3(0.5f, 0, 0));
  EXPECT_EQ(correction.b, Vec3(-0.5f, 0, 0));
}

TEST(Classic, VolumeConstraintIsTheThesissFormula) {
  // Unit tet of volume 1/6, rest 1/3: d1 = (1, 1, 1), d2..d4 = -(unit axes), sum |d|^2 = 6, so d (V - V0) / 6 = -d / 36.
  const Vec3 a(0, 0, 0), b(1, 0, 0), c(0, 1, 0), d(0, 0, 1);
  EXPECT_FLOAT_EQ(signed_volume(a, b, c, d), 1.0f / 6);
  const TetCorrection correction = volume_correction(a, b, c, d, 1.0f / 3);
  EXPECT_TRUE(correction.node[0].isApprox(Vec3(-1, -1, -1) / 36));
  EXPECT_TRUE(correction.node[1].isApprox(Vec3(1, 0, 0) / 36));
  EXPECT_TRUE(correction.node[2].isApprox(Vec3(0, 1, 0) / 36));
  EXPECT_TRUE(correction.node[3].isApprox(Vec3(0, 0, 1) / 36));
}

TEST(Obstacle, EveryShapeGivesThePlaneThatSeparatesAPointFromIt) {
  Obstacle box, sphere, capsule, half_space;
  make_box({1, 2, 3}, box);
  make_sphere(2, sphere);
  make_capsule(0.5f, 3, capsule);
  make_half_space(half_space);
  const auto distance = [](const Obstacle& obstacle, const Vec3& point) {
    const Plane plane = separating_plane(obstacle, point);
    return plane.normal.dot(point) - plane.offset;
  };
  EXPECT_FLOAT_EQ(distance(box, {0, 2.5f, 0}), 0.5f);
  EXPECT_FLOAT_EQ(distance(box, {0.9f, 0, 0}), -0.1f);
  EXPECT_FLOAT_EQ(distance(sphere, {0, 3, 0}), 1);
  EXPECT_FLOAT_EQ(distance(capsule, {1, 0, 2}), 0.5f);
  EXPECT_FLOAT_EQ(distance(capsule, {0, 0, 4}), 0.5f);
  EXPECT_FLOAT_EQ(distance(half_space, {7, 8, 0.25f}), 0.25f);
}

TEST(Obstacle, TheHullOfABoxsCornersIsTheBox) {
  std::vector<Vec3> corners;
  for (int k = 0; k < 8; ++k) corners.emplace_back(k & 1 ? 1.f : -1.f, k & 2 ? 2.f : -2.f, k & 4 ? 3.f : -3.f);
  Obstacle hull, box;
  ASSERT_FALSE(make_hull(corners, hull).has_value());
  make_box({1, 2, 3}, box);
  EXPECT_EQ(hull.faces.size(), 6u);
  std::mt19937 random(7);
  std::uniform_real_distribution<float> coordinate(-5, 5);
  for (int k = 0; k < 1000; ++k) {
    const Vec3 point(coordinate(random), coordinate(random), coordinate(random));
    const Plane a = separating_plane(hull, point), b = separating_plane(box, point);
    EXPECT_NEAR(a.normal.dot(point) - a.offset, b.normal.dot(point) - b.offset, 1e-5);
  }
}

TEST(Obstacle, IsAsWideAsTheGapBetweenNodesThatItNeeds) {
  Obstacle post, plate, pole, ball, ground, hull;
  make_box({2, 0.1f, 0.05f}, post);
  make_box({0.01f, 5, 3}, plate);
  make_capsule(0.15f, 2, pole);
  make_sphere(0.5f, ball);
  make_half_space(ground);
  std::vector<Vec3> corners;
  for (int k = 0; k < 8; ++k) corners.emplace_back(k & 1 ? 3.f : 1.f, k & 2 ? 0.2f : 0.f, k & 4 ? 0.1f : 0.f);
  ASSERT_EQ(make_hull(corners, hull), std::nullopt);
  EXPECT_FLOAT_EQ(post.width, 0.2f);
  EXPECT_FLOAT_EQ(plate.width, 6);
  EXPECT_FLOAT_EQ(pole.width, 0.3f);
  EXPECT_FLOAT_EQ(ball.width, 1);
  EXPECT_TRUE(std::isinf(ground.width));
  EXPECT_FLOAT_EQ(hull.width, 0.2f);
}

TEST(Obstacle, AFlatHullIsRefusedWithASentenceAndLeavesTheObstacleAlone) {
  Obstacle obstacle;
  make_sphere(1, obstacle);
  const std::vector<Vec3> flat = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}, {2, 1, 0}};
  const auto refusal = make_hull(flat, obstacle);
  ASSERT_TRUE(refusal.has_value());
  EXPECT_NE(refusal->find("volume"), std::string::npos);
  EXPECT_FLOAT_EQ(obstacle.radius, 1);
  EXPECT_TRUE(make_hull(std::vector<Vec3>(33, Vec3::Zero()), obstacle).has_value());
}

Obstacle random_obstacle(int kind, std::mt19937& random) {
  std::uniform_real_distribution<double> unit(-1, 1);
  const auto some = [&] { return Eigen::Vector3d(unit(random), unit(random), unit(random)); };
  Obstacle obstacle;
  if (kind == 0) make_box((Vec3::Constant(1.1f) + some().cast<float>()), obstacle);
  if (kind == 1) make_capsule(0.3f, 2, obstacle);
  if (kind == 2) make_half_space(obstacle);
  if (kind == 3) {
    std::vector<Vec3> points;
    for (int k = 0; k < 12; ++k) points.push_back(some().cast<float>());
    EXPECT_EQ(make_hull(points, obstacle), std::nullopt);
  }
  obstacle.pose = {8 * some(), Eigen::Quaterniond(Eigen::Vector4d(unit(random), unit(random), unit(random), 1.5)).normalized()};
  obstacle.velocity = 20 * some();
  if (unit(random) > 0) obstacle.angular_velocity = 5 * some();
  return obstacle;
}

TEST(Contacts, WhateverComesNearIsACandidate) {
  std::mt19937 random(7);
  constexpr int scenes = sanitized ? 160 : 1200;
  int met = 0, passed_over = 0;
  for (int scene = 0; scene < scenes; ++scene) {
    Crash crash;
    crash.motion.velocity = 20 * Eigen::Vector3d::Random();
    crash.motion.angular_velocity = 6 * Eigen::Vector3d::Random();
    const Obstacle obstacle = random_obstacle(scene % 4, random);
    const double seconds = scene % 8 < 4 ? tick_seconds : 0.5;
    ContactSet contacts;
    const std::vector<Candidates>& found = contacts.candidate;
    const StepInput input{crash.model, crash.parameters, crash.mass, {&obstacle, 1}, seconds};
    find_candidates(input, crash.body, crash.motion, contacts);
    std::vector<uint8_t> near(crash.body.node.size(), 0);
    for (const Candidates& one : found) {
      for (uint32_t node : one.node) near[node] = 1;
    }
    EXPECT_EQ(encounter(input, crash.body, crash.motion).near, !found.empty());
    passed_over += found.empty();
    for (int k = 0; k <= 32; ++k) {
      const double t = seconds * k / 32;
      const Relative now = relative(advance(crash.motion, crash.mass, t),
                                    advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, t));
      for (size_t i = 0; i < near.size(); ++i) {
        const Vec3 local = now.rotation * crash.body.node[i] + now.translation;
        const Plane plane = separating_plane(obstacle, local);
        if (plane.normal.dot(local) > plane.offset) continue;
        ASSERT_TRUE(near[i]) << "scene " << scene << ", node " << i << " is inside after " << t << " s";
        ++met;
      }
    }
  }
  EXPECT_GT(met, 1000);
  EXPECT_GT(passed_over, scenes / 4);
}

TEST(Contacts, WhatIsDrivenAtIsMetAndWhatIsPassedByIsNot) {
  Crash crash;
  const auto meets = [&](const Eigen::Vector3d& velocity, const Eigen::Vector3d& at, const Vec3& half, double driven = 0) {
    Obstacle box;
    make_box(half, box);
    box.pose.position = at;
    box.velocity.x() = driven;
    crash.motion.velocity = velocity;
    return encounter({crash.model, crash.parameters, crash.mass, {&box, 1}, 0.5}, crash.body, crash.motion).hit;
  };
  const double nose = crash.front;
  const Vec3 wall(0.5f, 5, 5), rail(50, 0.1f, 1), pole(0.05f, 0.05f, 2);
  EXPECT_TRUE(meets({20, 0, 0}, {nose + 9, 0, 0}, wall)) << "ahead";
  EXPECT_TRUE(meets({20, 0, 0}, {nose + 5, 0.5, 0}, pole));
  EXPECT_TRUE(meets({0, 0, 0}, {nose + 5, 0, 0}, wall, -20)) << "it comes";
  EXPECT_FALSE(meets({20, 0, 0}, {nose + 11, 0, 0}, wall)) << "not yet";
  EXPECT_FALSE(meets({20, 0, 0}, {-nose - 1, 0, 0}, wall)) << "behind";
  EXPECT_FALSE(meets({20, 0, 0}, {0, 1.2, 0}, rail)) << "driven along, at 0.2 m";
  EXPECT_FALSE(meets({20, 0, 0}, {nose + 5, 1.3, 0}, pole)) << "passed by, at 0.35 m";
  EXPECT_FALSE(meets({0, 0, 0}, {nose + 0.52, 0, 0}, wall)) << "stood beside";
  EXPECT_FALSE(meets({1e-3, 0, 0}, {nose + 0.5, 0, 0}, wall)) << "a host that rounds";
}

// By its own motion the light car stands still, but the block pushes it through the plate within one tick.
TEST(Contacts, ACarIsNotPushedThroughWhatItStandsBeside) {
  Crash crash;
  crash.mass.mass = 100;
  crash.mass.inertia *= 100.0 / double(crash.model.mass);
  Obstacle plate, block;
  make_box({0.01f, 5, 5}, plate);
  plate.pose.position = {crash.front + 0.06, 0, 0};
  make_box({0.5f, 5, 5}, block);
  block.pose.position = {-crash.front - 0.51, 0, 0};
  block.velocity.x() = 15;
  crash.obstacles = {plate, block};
  for (int k = 0; k < 4; ++k) {
    crash.tick();
    for (const Vec3& node : crash.body.node) {
      const double x = (crash.motion.pose.position + crash.motion.pose.orientation * node.cast<double>()).x();
      ASSERT_LT(x, crash.front + 0.06) << "tick " << k;
    }
  }
}

TEST(Deform, GivesTheSameWhateverItsScratchWasUsedForBefore) {
  const auto hit = [](const std::shared_ptr<const Car>& car, Scratch& scratch) {
    const Model& model = car->model;
    DeformableState body = make_body(model);
    Motion motion;
    motion.velocity = {12, 1, 0};
    Obstacle wall;
    make_box({0.5f, 5, 5}, wall);
    wall.pose.position = {2.25 + 0.55, 0, 0};
    for (int k = 0; k < 3; ++k)
      deform({model,
              {},
              {model.mass, model.inertia.cast<double>(), model.center_of_mass.cast<double>()},
              {&wall, 1},
              tick_seconds},
             scratch, body, motion);
    return hash(body);
  };
  const std::shared_ptr<const Car> cars[] = {box_car({12, 6, 4}), box_car({8, 4, 3}), box_car({5, 2, 2})};
  for (const auto& first : cars) {
    for (const auto& then : cars) {
      const ScratchHandle fresh = make_scratch(), used = make_scratch();
      hit(first, *used);
      EXPECT_EQ(hit(then, *used), hit(then, *fresh)) << first->model.node.size() << ", " << then->model.node.size();
    }
  }
}

TEST(Deform, SaysBeforehandWhichSettledBodiesATickWillSolve) {
  std::mt19937 random(11);
  constexpr int scenes = sanitized ? 80 : 400;
  int solved = 0, not_solved = 0;
  for (int scene = 0; scene < scenes; ++scene) {
    Crash crash;
    crash.motion.velocity = Eigen::Vector3d::Random() * (scene % 3 ? 8.0 : 0.0);
    Obstacle obstacle = random_obstacle(scene % 4, random);
    obstacle.pose.position *= 0.4;
    if (scene % 2) obstacle.velocity.setZero(), obstacle.angular_velocity.setZero();
    crash.obstacles.push_back(obstacle);
    for (int k = 0; k < 3 && crash.body.settled; ++k) {
      const bool said = wakes({crash.model, crash.parameters, crash.mass, crash.obstacles, tick_seconds}, *crash.scratch,
                              crash.body, crash.motion);
      const bool was = crash.tick().substeps > 0;
      EXPECT_EQ(was, said) << "scene " << scene;
      ++(was ? solved : not_solved);
    }
  }
  EXPECT_GT(solved, scenes / 4);
  EXPECT_GT(not_solved, scenes / 4);
}

TEST(Material, AValueOutsideItsRangeIsNamedWithTheRange) {
  Parameters parameters;
  EXPECT_FALSE(out_of_range(parameters).has_value());
  parameters.region[3].poisson_ratio = 0.5f;
  ASSERT_TRUE(out_of_range(parameters).has_value());
  EXPECT_EQ(*out_of_range(parameters), "poisson_ratio of region 3 is 0.5; allowed are 0 to 0.45");
  parameters.region[3].poisson_ratio = std::nanf("");
  EXPECT_TRUE(out_of_range(parameters).has_value());
}

// ---- plasticity ---------------------------------------------------------------------------------------------------------

Eigen::Matrix3d kirchhoff(const Elastic& e, const Eigen::Matrix3d& f) {
  const double j = f.determinant();
  return double(e.mu) * f * f.transpose() + double(e.l) * (j - double(e.gamma)) * j * Eigen::Matrix3d::Identity();
}

Gradients identity_gradients() { return {{Vec3::UnitX(), Vec3::UnitY(), Vec3::UnitZ()}}; }

TEST(Flow, BelowYieldNothingChanges) {
  const Material material;
  Gradients gradients = identity_gradients();
  float kappa = 0;
  const Mat3 f = Vec3(1 - 0.9f * material.yield_strain, 1, 1).asDiagonal();
  EXPECT_EQ(flow(elastic(material), yield_law(material), f, gradients, kappa), 0);
  EXPECT_EQ(kappa, 0);
  EXPECT_EQ(gradients.corner[0], Vec3::UnitX());
}

TEST(Flow, AfterwardsTheStressLiesOnTheHardenedYieldSurface) {
  std::mt19937 random(11);
  std::normal_distribution<float> entry(0, 0.15f);
  for (float poisson : {0.0f, 0.2f, 0.4f}) {
    Material material;
    material.poisson_ratio = poisson;
    const Elastic e = elastic(material);
    const YieldLaw law = yield_law(material);
    int flowed = 0;
    for (int k = 0; k < 300; ++k) {
      Mat3 f = Mat3::Identity();
      for (int i = 0; i < 9; ++i) f(i / 3, i % 3) += entry(random);
      if (f.determinant() < 0.1f) continue;
      Gradients gradients = identity_gradients();
      float kappa = 0;
      const float work = flow(e, law, f, gradients, kappa);
      if (work == 0) continue;
      ++flowed;
      Mat3 rows;
      for (int i = 0; i < 3; ++i) rows.row(i) = gradients.corner[i].transpose();
      const Mat3 after = f * rows;
      const double yield = double(yield_stress(law, kappa));
      EXPECT_NEAR(kirchhoff(e, after.cast<double>()).norm() / yield, 1, 0.01) << "poisson " << poisson << ", case " << k;
      EXPECT_GT(work, 0);
    }
    EXPECT_GT(flowed, 250);
  }
}

TEST(Flow, APressedFoamCompactsAndDoesNotBulge) {
  Material material;  // Poisson ratio 0 for elastic strain and for flow
  Gradients gradients = identity_gradients();
  float kappa = 0;
  flow(elastic(material), yield_law(material), Vec3(0.8f, 1, 1).asDiagonal(), gradients, kappa);
  EXPECT_GT(gradients.corner[0].x(), 1.2f);  // the rest length shrank
  EXPECT_NEAR(gradients.corner[1].y(), 1, 0.01);
  EXPECT_NEAR(gradients.corner[2].z(), 1, 0.01);
}

TEST(Flow, PlasticStrainStopsAtItsLimit) {
  Material material;
  material.plastic_limit = 0.3f;
  const YieldLaw law = yield_law(material);
  Gradients gradients = identity_gradients();
  float kappa = 0;
  for (int k = 0; k < 50; ++k) {
    Mat3 rows;
    for (int i = 0; i < 3; ++i) rows.row(i) = gradients.corner[i].transpose();
    flow(elastic(material), law, Vec3(0.3f, 1, 1).asDiagonal() * rows, gradients, kappa);
  }
  EXPECT_LE(kappa, 0.3f);
  EXPECT_GT(kappa, 0.29f);
  EXPECT_LT(gradients.corner[0].x(), std::exp(0.31f));
}

TEST(Flow, AnInvertedTetDoesNotFlow) {
  Gradients gradients = identity_gradients();
  float kappa = 0;
  const Mat3 mirrored = Vec3(-1, 1, 1).asDiagonal();
  EXPECT_EQ(flow(elastic({}), yield_law({}), mirrored, gradients, kappa), 0);
  EXPECT_EQ(kappa, 0);
}

TEST(Flow, SecantModuliGiveTheFlowedStressAtTheTrialStrain) {
  const Material material;
  const Elastic e = elastic(material);
  const YieldLaw law = yield_law(material);
  const Mat3 f = Vec3(0.9f, 1, 1.02f).asDiagonal();
  const Elastic soft = secant(e, law, f, 0);
  const double trial = kirchhoff(e, f.cast<double>()).norm(), flowed = kirchhoff(soft, f.cast<double>()).norm();
  EXPECT_LT(flowed, 0.2 * trial);
  // |tau| = Y(kappa), where kappa is the released stress as a strain.
  const double kappa = (trial - flowed) / material.young_modulus;
  EXPECT_NEAR(flowed, double(yield_stress(law, float(kappa))), 0.02 * flowed);
}

TEST(Flow, YieldStressRisesToItsPlateauAndAgainWhereTheMaterialIsDense) {
  Material material;
  material.young_modulus = 1e7f;
  material.yield_strain = 0.01f;
  material.hardening = 0.2f;
  material.hardening_strain = 0.1f;
  material.densification = 0.4f;
  material.densification_strain = 0.5f;
  const YieldLaw law = yield_law(material);
  EXPECT_FLOAT_EQ(yield_stress(law, 0), 1e5f);
  EXPECT_FLOAT_EQ(yield_stress(law, 0.1f), 1e5f + 0.5f * 2e5f);  // half of hardening times hardening_strain
  EXPECT_FLOAT_EQ(yield_stress(law, 0.4f), 1e5f + 0.8f * 2e5f);
  EXPECT_FLOAT_EQ(yield_stress(law, 0.9f), 1e5f + 0.9f * 2e5f + 4e6f * 0.16f);
  EXPECT_FLOAT_EQ(yield_stress(crushed(law, 0.5f), 0.9f), 0.5f * yield_stress(law, 0.9f));
  material.yield_strain = material.hardening = material.densification = 0;
  EXPECT_FLOAT_EQ(yield_stress(yield_law(material), 1), 1e-5f * 1e7f);  // never a fluid
}

TEST(Flow, VolumeRatioIsThatOfTheTetWithoutLoad) {
  // Edges of 2, 3 and 4 m along the axes.
  const float rest = 4;  // m^3
  Gradients gradients{{Vec3(0.5f, 0, 0), Vec3(0, 1 / 3.0f, 0), Vec3(0, 0, 0.25f)}};
  EXPECT_FLOAT_EQ(volume_ratio(rest, gradients), 1);
  gradients.corner[0] *= 2;  // crushed to half of its length
  EXPECT_FLOAT_EQ(volume_ratio(rest, gradients), 0.5f);
  gradients.corner[1] /= 3;
  EXPECT_FLOAT_EQ(volume_ratio(rest, gradients), 1.5f);
  gradients.corner[2] *= 1e6f;
  EXPECT_EQ(volume_ratio(rest, gradients), least_volume_ratio);
  gradients.corner[2] = -gradients.corner[2];  // no flow makes this
  EXPECT_EQ(volume_ratio(rest, gradients), 1);
}

// One tet of unit edges, pressed or pulled along x in small steps. Its force is the stress over the section that it had at
// rest.
struct Pressed {
  Material material;
  Gradients gradients = identity_gradients();
  float kappa = 0;
  double work = 0, force = 0;
  void to(float stretch) {
    Mat3 rows;
    for (int i = 0; i < 3; ++i) rows.row(i) = gradients.corner[i].transpose();
    const YieldLaw law = crushed(yield_law(material), volume_ratio(1 / 6.0f, gradients));
    work += double(flow(elastic(material), law, Vec3(stretch, 1, 1).asDiagonal() * rows, gradients, kappa));
    for (int i = 0; i < 3; ++i) rows.row(i) = gradients.corner[i].transpose();
    const Mat3 after = Vec3(stretch, 1, 1).asDiagonal() * rows;
    force = kirchhoff(elastic(material), after.cast<double>())(0, 0) / double(stretch);
  }
};

TEST(Flow, TheForceOfABarIsItsYieldStressTimesItsSectionAndNeverFalls) {
  for (const float end : {0.25f, 2.5f}) {
    Pressed bar;
    const YieldLaw law = yield_law(bar.material);
    constexpr int steps = 400;
    double last = 0;
    for (int k = 1; k <= steps; ++k) {
      bar.to(std::pow(end, float(k) / steps));
      EXPECT_GE(std::fabs(bar.force), last * (1 - 1e-4)) << "step " << k;
      last = std::fabs(bar.force);
      if (bar.kappa < 0.05f) continue;
      // The elastic part of the stretch and the length of a step stay between the two.
      EXPECT_NEAR(last / double(yield_stress(law, bar.kappa)), 1, 0.06) << "step " << k;
    }
    EXPECT_NEAR(bar.kappa, std::fabs(std::log(end)), 0.06);
  }
}

TEST(Flow, TheWorkIsTheAreaUnderTheYieldStress) {
  for (const float stretch : {0.95f, 0.7f, 0.35f}) {  // in one step, however long
    Pressed bar;
    const YieldLaw law = yield_law(bar.material);
    bar.to(stretch);
    double area = 0;
    constexpr int slices = 1000;
    for (int k = 0; k < slices; ++k) {
      area += double(yield_stress(law, (float(k) + 0.5f) / slices * bar.kappa)) * double(bar.kappa) / slices;
    }
    EXPECT_NEAR(bar.work / area, 1, 0.02) << "stretch " << stretch;
  }
}

// ---- twin: the sweeps against an independent gradient in double precision -------------------------------------------------

// Returns the elastic forces on the nodes from a plain gradient in double precision, N, and the sum of their sizes over the
// tets of each node.
struct Forces {
  std::vector<Eigen::Vector3d> force;
  std::vector<double> size;
};
Forces elastic_forces(const Crash& crash) {
  const Model& model = crash.model;
  const Elastic e = elastic(crash.parameters.region[0]);
  Forces out{std::vector<Eigen::Vector3d>(model.node.size(), Eigen::Vector3d::Zero()), std::vector<double>(model.node.size())};
  for (size_t t = 0; t < model.tet.size(); ++t) {
    const uint32_t* n = model.tet[t].node;
    Eigen::Matrix3d edges, rest;
    for (int k = 0; k < 3; ++k) {
      edges.col(k) = (crash.body.node[n[k + 1]] - crash.body.node[n[0]]).cast<double>();
      rest.col(k) = (model.node[n[k + 1]] - model.node[n[0]]).cast<double>();
    }
    const Eigen::Matrix3d f = edges * rest.inverse();
    const double j = f.determinant();
    const Eigen::Matrix3d first = double(e.mu) * f + double(e.l) * (j - double(e.gamma)) * j * f.inverse().transpose();
    const Eigen::Matrix3d corner = first * rest.inverse().transpose() * (rest.determinant() / 6);
    for (int k = 0; k < 3; ++k) {
      out.force[n[k + 1]] += corner.col(k);
      out.force[n[0]] -= corner.col(k);
      out.size[n[k + 1]] += corner.col(k).norm();
    }
  }
  return out;
}

// Scripted and converged, and nothing flows, so the minimiser is a plain one.
void minimise_elastically(Crash& crash) {
  crash.scripted();
  crash.parameters.iterations = 400;
  crash.parameters.tolerance = 0;
  for (Material& material : crash.parameters.region) {
    material.yield_strain = 1;
    material.drag = 0;
  }
}

TEST(Nodal, ConvergedNodesCarryNoForceByAnIndependentDoublePrecisionGradient) {
  Crash crash;
  minimise_elastically(crash);
  crash.wall(0).velocity = {-1.2, 0, 0};
  crash.obstacles[0].friction = 0;
  crash.tick();
  crash.tick();  // 40 mm in

  const auto [force, size] = elastic_forces(crash);
  double largest = 0, residual = 0;
  const double wall = crash.obstacles[0].pose.position.x() - 0.5;
  for (size_t i = 0; i < force.size(); ++i) {
    largest = std::max(largest, size[i]);
    const bool held = crash.model.node_anchored[i] || crash.body.node[i].x() > wall - 1e-4;
    if (!held) residual = std::max(residual, force[i].norm());
  }
  EXPECT_GT(crash.crush(), 0.035);
  EXPECT_LT(residual, 2e-3 * largest);
}

TEST(Nodal, TwoPlanesTogetherPressWithTheForceThatTheirNodeLacks) {
  Crash crash;
  minimise_elastically(crash);
  // The gap between two poles along z closes on the middle of the nose. Their planes meet at 60 degrees.
  for (const double side : {0.1, -0.1}) {
    Obstacle& pole = crash.obstacles.emplace_back();
    make_capsule(0.2f, 3, pole);
    pole.friction = 0;
    pole.pose.position = {crash.front + std::sqrt(0.03), side, 0.7};
    pole.velocity = {-1.2, 0, 0};
  }
  crash.tick();
  crash.tick();
  const std::vector<Eigen::Vector3d> force = elastic_forces(crash).force;
  int nodes = 0;
  for (uint32_t node = 0; node < force.size(); ++node) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    int planes = 0;
    for (size_t k = 0; k < crash.scratch->contacts.contact.size(); ++k) {
      const ContactForce& held = crash.scratch->solver.contact_forces[k];
      if (crash.scratch->contacts.contact[k].node != node || !held.active) continue;
      sum += held.force.cast<double>();
      ++planes;
    }
    if (planes < 2) continue;
    ++nodes;
    EXPECT_LT((sum - force[node]).norm(), 0.05 * force[node].norm()) << "node " << node;
  }
  EXPECT_GE(nodes, 4);
}

// ---- laws ---------------------------------------------------------------------------------------------------------------

TEST(Law, AThousandTicksAtRestMoveNoNodeAndSolveNothing) {
  Crash crash;
  crash.wall(0.5);
  const uint64_t before = hash(crash.body);
  for (int k = 0; k < 1000; ++k) EXPECT_EQ(crash.tick().substeps, 0u);
  EXPECT_EQ(hash(crash.body), before);
}

TEST(Law, ACrashTakesTheSpeedThatItsImpulseSays) {
  Crash crash;
  crash.wall();
  crash.motion.velocity = {13, 0, 0};
  crash.run(0.4);
  EXPECT_LT(crash.motion.velocity.x(), 0);  // thrown back
  EXPECT_NEAR(crash.total.impulse.x(), crash.mass.mass * (crash.motion.velocity.x() - 13), 1);
  EXPECT_GT(crash.crush(), 0.1);
}

TEST(Law, EnergyBroughtIsAbsorbedStoredOrLeftHoweverLongTheSubSteps) {
  const std::pair<double, int> cases[] = {{5, 4}, {10, 2}, {10, 4}, {10, 16}, {14, 4}};
  for (const auto& [speed, substeps] : cases) {
    Crash crash;
    crash.parameters.substeps = uint16_t(substeps);
    crash.wall();
    crash.motion.velocity = {speed, 0, 0};
    const double brought = crash.energy();
    double absorbed = 0;
    for (int k = 0; k < 30; ++k) {
      crash.tick();
      EXPECT_GE(crash.body.absorbed, absorbed);  // absorbed energy never decreases
      absorbed = crash.body.absorbed;
    }
    EXPECT_NEAR(crash.energy() / brought, 1, 0.005) << speed << " m/s, " << substeps << " sub-steps";
  }
}

TEST(Law, HostsAt30To240HzCrushTheSame) {
  std::vector<double> crush;
  for (double rate : {30.0, 60.0, 120.0, 240.0}) {
    Crash crash;
    crash.wall();
    crash.motion.velocity = {50 / 3.6, 0, 0};
    crash.run(0.4, rate);
    crush.push_back(crash.crush());
  }
  for (double each : crush) EXPECT_NEAR(each, crush[0], 0.01 * crush[0]);
}

TEST(Law, CrushGrowsWithSpeed) {
  double last = 0;
  for (double speed : {16.0, 32.0, 48.0, 57.0}) {
    Crash crash;
    crash.wall();
    crash.motion.velocity = {speed / 3.6, 0, 0};
    crash.run(0.4);
    EXPECT_GT(crash.crush(), last + 0.02);
    last = crash.crush();
  }
}

TEST(Law, NoNodeEndsInsideAnObstacle) {
  Crash crash;
  crash.motion.velocity = {14, 2, 0};
  Obstacle pole;
  make_capsule(0.2f, 3, pole);
  pole.pose.position = {crash.front + 0.3, 0.3, 0};
  crash.obstacles.push_back(pole);
  crash.wall(0.4);
  for (int k = 0; k < 30; ++k) {
    crash.tick();
    for (const Obstacle& obstacle : crash.obstacles) {
      const Relative to = relative(crash.motion.pose, obstacle.pose);
      for (const Vec3& node : crash.body.node) {
        const Vec3 local = to.rotation * node + to.translation;
        const Plane plane = separating_plane(obstacle, local);
        EXPECT_GT(plane.normal.dot(local) - plane.offset, -2e-3) << "tick " << k;
      }
    }
  }
}

TEST(Law, ATwoCentimetrePlateIsNotTunnelledAt300MetresASecond) {
  for (double speed : {50.0, 150.0, 300.0}) {
    Crash crash;
    crash.scripted();
    Obstacle plate;
    make_box({0.01f, 5, 5}, plate);
    plate.pose.position = {crash.front + 1, 0, 0};
    plate.velocity = {-speed, 0, 0};
    crash.obstacles.push_back(plate);
    for (int k = 0; k < 8 && plate.pose.position.x() > crash.front - 0.6; ++k) {
      crash.tick(1.0 / 960);
      plate = crash.obstacles[0];
      for (const Vec3& node : crash.body.node) EXPECT_LT(node.x(), plate.pose.position.x()) << speed << " m/s";
    }
  }
}

TEST(Law, AMovedAndTurnedSceneGivesTheSameDent) {
  const auto crash_at = [](const Pose& scene) {
    Crash crash;
    Obstacle& wall = crash.wall();
    wall.pose = {scene.position + scene.orientation * wall.pose.position, scene.orientation};
    crash.motion.pose = scene;
    crash.motion.velocity = scene.orientation * Eigen::Vector3d(10, 0, 0);
    crash.run(0.3);
    return crash.body.node;
  };
  Pose elsewhere;
  elsewhere.position = {1234.5, -678.9, 0};
  elsewhere.orientation = Eigen::AngleAxisd(2.1, Eigen::Vector3d::UnitZ());
  EXPECT_LT(rms_difference(crash_at({}), crash_at(elsewhere)), 1e-3);
}

TEST(Law, AMirroredSceneGivesTheMirroredDentWithinWhatTheSolverLeavesUndone) {
  const auto depth_at = [](double side) {
    Crash crash;
    Obstacle pole;
    make_capsule(0.2f, 3, pole);
    pole.pose.position = {crash.front + 0.25, side, 0};
    crash.obstacles.push_back(pole);
    crash.motion.velocity = {10, 0, 0};
    crash.run(0.3);
    return std::pair(crash.crush(), crash.motion.angular_velocity.z());
  };
  const auto left = depth_at(0.5), right = depth_at(-0.5);  // the tets themselves are not mirrored
  EXPECT_NEAR(left.first, right.first, 0.12 * left.first);
  EXPECT_LT(left.second * right.second, 0);
}

TEST(Law, ATouchBelowYieldLeavesNoDent) {
  Crash crash;
  crash.scripted();
  for (Material& material : crash.parameters.region) material.yield_strain = 0.1f;
  crash.wall(0).velocity = {-0.3, 0, 0};
  for (int k = 0; k < 4; ++k) crash.tick();
  EXPECT_GT(crash.crush(), 0.015);
  crash.obstacles[0].velocity = {1, 0, 0};
  crash.run(0.5);
  EXPECT_TRUE(crash.body.settled);
  EXPECT_LT(crash.crush(), 1e-3);
  for (float kappa : crash.body.hardening) EXPECT_EQ(kappa, 0);
}

TEST(Law, ALightHitAgainAndAgainDoesNotCreep) {
  Crash crash;
  crash.scripted();
  crash.wall(0);
  double first = 0;
  for (int hit = 0; hit < 10; ++hit) {
    crash.obstacles[0].velocity = {-0.6, 0, 0};
    crash.run(0.1);
    crash.obstacles[0].velocity = {0.6, 0, 0};
    crash.run(0.1);
    if (hit == 0) first = crash.body.absorbed;
  }
  EXPECT_GT(first, 0);
  EXPECT_LT(crash.body.absorbed, 1.35 * first);  // from the drag of nine elastic hits without flow
}

TEST(Law, TheCellHoldsAndNoTetIsInvertedAfterADeepPush) {
  Crash crash;
  crash.scripted();
  crash.wall(0).velocity = {-0.6, 0, 0};
  for (int k = 0; k < 40; ++k) crash.tick();
  crash.obstacles[0].velocity = {2, 0, 0};
  crash.run(0.3);
  EXPECT_GT(crash.crush(), 0.3);
  for (size_t i = 0; i < crash.model.node.size(); ++i) {
    if (crash.model.node[i].x() < -1) {
      EXPECT_LT((crash.body.node[i] - crash.model.node[i]).norm(), 1e-3);
    }
  }
  for (const Tet& tet : crash.model.tet) {
    const auto& n = crash.body.node;
    EXPECT_GT(signed_volume(n[tet.node[0]], n[tet.node[1]], n[tet.node[2]], n[tet.node[3]]), 0);
  }
}

TEST(Law, ResidualCrushDoesNotDependOnTheSweepCount) {
  const auto residual = [](uint16_t iterations) {
    Crash crash;
    crash.scripted();
    crash.parameters.iterations = iterations;
    crash.parameters.tolerance = 0;
    crash.wall(0).velocity = {-0.6, 0, 0};
    for (int k = 0; k < 40; ++k) crash.tick();
    crash.obstacles[0].velocity = {2, 0, 0};
    crash.run(0.3);
    return crash.crush();
  };
  const double few = residual(5), many = residual(100);
  EXPECT_NEAR(few, many, 0.02 * many);
}

TEST(Law, AWallThatReachesTheCellStopsTheCarAndMovesTheCellLittle) {
  Crash crash;
  for (Material& material : crash.parameters.region)
    material.young_modulus = 1e6f;  // so soft that the nose alone cannot stop the car
  crash.wall();
  crash.motion.velocity = {25, 0, 0};
  const double brought = crash.energy();
  crash.run(0.5);
  EXPECT_LE(crash.motion.velocity.x(), 0.1);
  EXPECT_LT(crash.energy(), 1.005 * brought);
  for (const Vec3& node : crash.body.node) EXPECT_TRUE(node.allFinite());
}

TEST(Law, APoleThatHasPressedTheCellLeavesItWithoutNewEnergy) {
  const std::pair<double, double> cases[] = {{0, 14}, {0.9, 6}};  // place along the side, m; speed, m/s
  for (const auto& [x, speed] : cases) {
    Crash crash;
    Obstacle pole;
    make_capsule(0.6f, 3, pole);
    pole.pose.position = {x, 0.9 + 0.62, 0};
    crash.obstacles.push_back(pole);
    crash.motion.velocity = {0, speed, 0};
    const double brought = crash.energy();
    crash.run(0.3);
    EXPECT_LT(crash.motion.velocity.y(), 0);
    EXPECT_NEAR(crash.energy() / brought, 1, 0.005) << "at " << x << " m";
  }
}

TEST(Law, AnObstacleBornInsideIsLeftGently) {
  Crash crash;
  Obstacle ball;
  make_sphere(0.3f, ball);
  ball.pose.position = {crash.front - 0.1, 0, 0.7};
  crash.obstacles.push_back(ball);
  crash.run(0.5);
  EXPECT_LT(crash.motion.velocity.norm(), 15);
  for (const Vec3& node : crash.body.node) EXPECT_TRUE(node.allFinite());
}

// Four half-spaces close on a car from all sides until they overlap. Their forces are far larger than in any crash, and give
// the car no sensible direction.
TEST(Law, ObstaclesThatLeaveACarNoRoomDoNotThrowIt) {
  constexpr double speed = 5;
  Crash crash;
  for (int k = 0; k < 4; ++k) {
    const double angle = 0.4 + 1.5 * k;
    const Eigen::Vector3d inward(-std::cos(angle), -std::sin(angle), 0);
    Obstacle& side = crash.obstacles.emplace_back();
    make_half_space(side);
    side.pose.position = crash.mass.center - 1.5 * inward;
    side.pose.orientation = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), inward);
    side.velocity = speed * inward;
  }
  constexpr int ticks = sanitized ? 24 : 40;  // all four overlap from the 19th on
  for (int k = 0; k < ticks; ++k) {
    EXPECT_FALSE(crash.tick().recovered) << "tick " << k;
    EXPECT_LT(crash.motion.velocity.norm(), 15 * speed) << "tick " << k;  // without the bound: 1,300 m/s
    EXPECT_LT(crash.motion.angular_velocity.norm(), 3 * speed) << "tick " << k;
  }
}

// Two nearly parallel walls leave a node only the wedge between them, which begins far away.
TEST(Law, WallsThatCloseAtASharpAngleDoNotSendNodesToWhereTheyMeet) {
  Crash crash;
  crash.scripted();
  for (const double side : {1.0, -1.0}) {
    const Eigen::Vector3d inward(-side * std::cos(0.03), std::sin(0.03), 0);
    Obstacle& wall = crash.obstacles.emplace_back();
    make_half_space(wall);
    wall.pose.position = {side * (crash.front + 0.05), 0, 0};
    wall.pose.orientation = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), inward);
    wall.velocity = 4 * inward;
  }
  constexpr int ticks = sanitized ? 40 : 60;  // both have passed each other from the 35th on
  for (int k = 0; k < ticks; ++k) {
    EXPECT_FALSE(crash.tick().recovered) << "tick " << k;
    ASSERT_LT(crash.farthest(), 10) << "tick " << k;  // without the bound: 11 m and more
  }
}

TEST(Law, AStiffBodyStretchedFarBeyondItsSizeStaysFinite) {
  Crash crash;
  crash.scripted();
  for (Material& material : crash.parameters.region) material.young_modulus = 1e10f, material.poisson_ratio = 0.45f;
  for (size_t i = 0; i < crash.body.node.size(); ++i) {
    if (!crash.model.node_anchored[i]) crash.body.node[i] *= 30;
  }
  crash.body.settled = false;
  for (int k = 0; k < 10; ++k) EXPECT_FALSE(crash.tick().recovered) << "tick " << k;
}

// A block so stiff that one sub-step of its contact force turns the motion around many times over.
TEST(Law, AWallThrowsNoCarBackFasterThanItCame) {
  for (const double wall_speed : {0.0, 8.0}) {
    Crash crash;
    for (Material& material : crash.parameters.region) {
      material.young_modulus = 1e10f;
      material.yield_strain = 1;
    }
    crash.wall().velocity.x() = -wall_speed;
    crash.motion.velocity.x() = 10;
    for (int k = 0; k < 30; ++k) {
      crash.tick();
      EXPECT_GT(crash.motion.velocity.x(), -2 * wall_speed - 10 - 1e-6) << "tick " << k;
    }
    EXPECT_LT(crash.motion.velocity.x(), 0);
  }
}

TEST(Law, FrictionTurnsAGlancingCarAndNeverSpeedsItUp) {
  for (float friction : {0.0f, 0.6f}) {
    Crash crash;
    Obstacle rail;
    make_box({20, 0.1f, 2}, rail);
    rail.pose.position = {0, 1.2, 0};  // the side of the box car is at 0.9
    rail.friction = friction;
    crash.obstacles.push_back(rail);
    crash.motion.velocity = {15, 3, 0};
    crash.run(0.3);
    EXPECT_LE(crash.motion.velocity.x(), 15 + 1e-6);
    if (friction > 0) {
      EXPECT_LT(crash.motion.velocity.x(), 14.5);
    }
    if (friction == 0) {
      EXPECT_NEAR(crash.motion.velocity.x(), 15, 0.3);
    }
  }
}

TEST(Law, RepairGivesTheUndamagedCarBitForBit) {
  Crash crash;
  crash.wall();
  crash.motion.velocity = {10, 0, 0};
  crash.run(0.3);
  const DeformableState fresh = make_body(crash.model);
  repair(crash.model, 1, crash.body);
  EXPECT_EQ(crash.body.node, fresh.node);
  EXPECT_EQ(crash.body.hardening, fresh.hardening);
  EXPECT_GT(crash.body.absorbed, 0);
}

TEST(Law, HalfARepairTakesAwayHalfTheDent) {
  Crash crash;
  crash.wall();
  crash.motion.velocity = {10, 0, 0};
  crash.run(0.3);
  const double crush = crash.crush();
  repair(crash.model, 0.5f, crash.body);
  EXPECT_NEAR(crash.crush(), 0.5 * crush, 1e-3);
}

TEST(Classic, WithoutPlasticityTheDentGoesAndWithItStays) {
  for (float keep : {1.0f, 0.5f}) {
    Crash crash;
    crash.scripted();
    crash.parameters.solver = Solver::classic;
    crash.parameters.iterations = 20;
    for (Material& material : crash.parameters.region) material.plasticity = keep;
    crash.wall(0).velocity = {-1.2, 0, 0};
    crash.run(0.2);
    crash.obstacles[0].velocity = {5, 0, 0};
    crash.run(3);
    if (keep == 1) {
      EXPECT_LT(crash.crush(), 0.02);
    }
    if (keep < 1) {
      EXPECT_GT(crash.crush(), 0.05);
    }
    EXPECT_EQ(crash.total.impulse.norm(), 0);  // the thesis has no force feedback
  }
}

// The box car, fast and turning, with six obstacles around it.
Crash random_scene(int scene, std::mt19937& random) {
  std::uniform_real_distribution<double> unit(-1, 1);
  Crash crash;
  crash.mass.planar = scene % 2;
  crash.parameters.iterations = 12;
  crash.motion.velocity = 30 * Eigen::Vector3d(unit(random), unit(random), 0.2 * unit(random));
  if (crash.mass.planar) crash.motion.velocity.z() = 0;  // nothing could slow it in z
  crash.motion.angular_velocity = 5 * Eigen::Vector3d(0, 0, unit(random));
  for (int k = 0; k < 6; ++k) {
    Obstacle obstacle;
    if (k % 3 == 0) make_box(Vec3::Constant(float(0.3 + 0.2 * unit(random))), obstacle);
    if (k % 3 == 1) make_sphere(float(0.4 + 0.2 * unit(random)), obstacle);
    if (k % 3 == 2) make_capsule(0.2f, 2, obstacle);
    // Around the car, but not inside it.
    const Eigen::Vector3d direction = Eigen::Vector3d(unit(random), unit(random), 0.3 * unit(random)).normalized();
    obstacle.pose.position = Eigen::Vector3d(0, 0, 0.7) + 3.4 * direction;
    crash.obstacles.push_back(obstacle);
  }
  return crash;
}

TEST(Hostile, RandomScenesStayFiniteAndCreateNoEnergy) {
  // Of the 1,800 scenes of seeds 1 to 150 one in eighty ends with more energy, the worst with 1.66 times the initial energy:
  // cells of half a metre, hit at up to 40 m/s, absorb more in one sub-step than the motion has. This surplus never moves a
  // car.
  const unsigned seed = GTEST_FLAG_GET(random_seed) > 0 ? unsigned(GTEST_FLAG_GET(random_seed)) : 1;
  std::mt19937 random(seed);
  for (int scene = 0; scene < 12; ++scene) {
    SCOPED_TRACE("seed " + std::to_string(seed) + " scene " + std::to_string(scene) + " (--gtest_random_seed)");
    Crash crash = random_scene(scene, random);
    const double brought = crash.energy();
    for (int k = 0; k < 20; ++k) {
      EXPECT_FALSE(crash.tick().recovered);
      EXPECT_LE(kinetic_energy(crash.motion, crash.mass), 1.000001 * brought);
    }
    for (const Vec3& node : crash.body.node) ASSERT_TRUE(node.allFinite());
    EXPECT_LT(crash.energy(), 1.02 * brought);
  }
}

// The scenes in which bodies stored the most energy that did not come from the motion. When this energy was returned to the
// motion, cars ended with 1.14 to 1.47 times the initial energy.
TEST(Hostile, WhatTheMotionDidNotGiveIsNotReturnedToIt) {
  for (const auto& [seed, number] : {std::pair{82u, 10}, {146u, 2}, {25u, 11}, {65u, 9}}) {
    std::mt19937 random(seed);
    for (int scene = 0; scene < number; ++scene) random_scene(scene, random);
    Crash crash = random_scene(number, random);
    const double brought = crash.energy();
    for (int k = 0; k < 20; ++k) crash.tick();
    EXPECT_LT(crash.energy(), 1.02 * brought) << "seed " << seed << " scene " << number;
  }
}

// ---- the list of a body's fields ------------------------------------------------------------------------------------------

float& first_number(std::vector<Vec3>& list) { return list[0].x(); }
float& first_number(std::vector<Gradients>& list) { return list[0].corner[0].x(); }
float& first_number(std::vector<float>& list) { return list[0]; }
double& first_number(Eigen::Vector3d& v) { return v.x(); }
int& first_number(AndersonHistory& history) { return history.next; }
float& first_number(PairMemory& memory) {
  return memory.touch.emplace_back(PairMemory::Touch{7, 0, Vec3::UnitX(), 1, Vec3::Zero()}).pressure;
}
template <class Number>
Number& first_number(Number& number) {
  return number;
}

TEST(DeformableState, HashesEachFieldOfItsListAndRefusesWhatIsNotFiniteInIt) {
  const std::shared_ptr<const Car> car = box_car({3, 2, 2});
  const DeformableState body = make_body(car->model);
  EXPECT_EQ(refuse_fields(car->model, body, false), std::nullopt);
  for_each_field([&](const auto& field) {
    DeformableState changed = body;
    auto& number = first_number(changed.*field.value);
    using Number = std::remove_reference_t<decltype(number)>;
    if constexpr (std::is_same_v<Number, bool>) {
      number = !number;
    } else {
      number += 1;
    }
    EXPECT_NE(hash(changed), hash(body)) << field.name;
    if constexpr (std::is_floating_point_v<Number>) {
      number = std::numeric_limits<Number>::quiet_NaN();
      const auto refusal = refuse_fields(car->model, changed, false);
      ASSERT_TRUE(refusal) << field.name;
      EXPECT_NE(refusal->find(field.name), std::string::npos) << *refusal;
      EXPECT_EQ(refuse_fields(car->model, changed, true).has_value(), field.traits.saved) << field.name;
    }
  });
}

}  // namespace
}  // namespace crumple

// Tests the dents of two cars that touch against the reference minimiser. Both cars' frames follow prescribed paths, so only
// the minimisation is compared.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "box_car.h"
#include "reference/newton.h"
#include "reference/pile_up.h"
#include "sanitized.h"

namespace crumple {
namespace {

using Eigen::Vector3d;

const double h = substep_seconds(Parameters());

// Two unlike boxes, nose to nose, that come nearer at `speed`, m/s. Their frames do not react.
struct Press {
  double speed;
  float friction = 0;

  PileUp scene() const {
    PileUp out;
    out.cars.reserve(2);
    out.add(box_car({4, 2, 2}), -2.25, 0, 0, 0.6 * speed);
    out.add(box_car({5, 3, 2}, 2000), 2.25, 0.17, M_PI, 0.4 * speed);
    for (CrashCar& car : out.cars) {
      car.mass.mass = std::numeric_limits<double>::infinity();
      car.mass.inertia.setConstant(car.mass.mass);
      car.body.touching = true;  // else the first sub-step would be shorter
      for (Material& material : car.parameters.region) material.friction = friction;
    }
    for (Material& material : out.cars[1].parameters.region) material.young_modulus *= 2;
    return out;
  }
  // Default settings; sweeps > 0: exactly as many, whatever they move.
  PileUp solved(int substeps, uint16_t sweeps) const {
    PileUp out = scene();
    for (CrashCar& car : out.cars) {
      if (sweeps == 0) continue;
      car.parameters.iterations = sweeps;
      car.parameters.tolerance = 0;
    }
    for (int k = 0; k < substeps; ++k) out.tick(h);
    return out;
  }
};

struct Answer {
  std::vector<std::vector<Vector3d>> node;  // per car
  std::vector<PairContact> contact;         // of the last sub-step
  double depth = 0;                         // deepest dent, m

  // RMS over all nodes of both cars, relative to the deepest dent.
  double difference(const PileUp& solved) const {
    double sum = 0;
    size_t count = 0;
    for (size_t c = 0; c < node.size(); ++c) {
      for (size_t i = 0; i < node[c].size(); ++i, ++count) {
        sum += (solved.cars[c].body.node[i].cast<double>() - node[c][i]).squaredNorm();
      }
    }
    return std::sqrt(sum / double(count)) / depth;
  }
};

Answer reference(const Press& press, int substeps, double tolerance = 1e-9) {
  const PileUp scene = press.scene();
  std::vector<std::vector<Pose>> path(2);
  std::vector<ReferenceState> state;
  std::vector<ReferenceCar> cars;
  for (size_t c = 0; c < 2; ++c) {
    for (int k = 0; k <= substeps; ++k) {
      path[c].push_back(scene.cars[c].motion.pose);
      path[c].back().position += k * h * scene.cars[c].motion.velocity;
    }
    state.push_back(make_reference(scene.cars[c].car->model));
  }
  for (size_t c = 0; c < 2; ++c) cars.push_back({scene.cars[c].car->model, scene.cars[c].parameters, path[c], state[c]});
  ReferenceOptions options;
  options.law = FlowLaw::secant;  // as the sweeps use
  options.tolerance = tolerance;
  Answer out;
  follow_reference(cars, {}, h, options, [&](size_t k, std::span<const ReferenceStep> steps, std::span<const PairContact> met) {
    EXPECT_TRUE(steps.front().converged) << "sub-step " << k << ", residual " << steps.front().residual.back();
    out.contact.assign(met.begin(), met.end());
  });
  for (size_t c = 0; c < 2; ++c) {
    for (size_t i = 0; i < state[c].node.size(); ++i) {
      out.depth = std::max(out.depth, (state[c].node[i] - scene.cars[c].car->model.node[i].cast<double>()).norm());
    }
    out.node.push_back(state[c].node);
  }
  return out;
}

// The pairs of the reference against its obstacles, which share no code: a car so stiff and large that it is a wall.
TEST(ReferencePairs, AStiffCarDentsAnotherLikeAWall) {
  constexpr int substeps = 12;
  constexpr double speed = 3, stiff = 1e4;
  const auto soft = box_car({4, 2, 2}), wide = box_car({2, 2, 2}, 5000, 9);
  Parameters parameters, hard;
  for (Material& material : parameters.region) material.friction = 0;
  hard = parameters;
  for (Material& material : hard.region) material.young_modulus *= float(stiff);
  Pose still;
  still.position = Vector3d(4.5 + 2.25, 0.1, -0.6);
  still.orientation = Eigen::AngleAxisd(M_PI, Vector3d::UnitZ());
  std::vector<Pose> path(substeps + 1), stays(substeps + 1, still);
  for (int k = 0; k <= substeps; ++k) path[size_t(k)].position.x() = k * h * speed;
  Obstacle wall;
  make_box({0.5f, 5, 5}, wall);
  wall.friction = 0;
  wall.pose.position.x() = 2.25 + 0.5;

  ReferenceState by_wall = make_reference(soft->model), by_car = by_wall, other = make_reference(wide->model);
  follow_reference(soft->model, parameters, {&wall, 1}, path, h, {}, {}, by_wall);
  const ReferenceCar cars[] = {{soft->model, parameters, path, by_car}, {wide->model, hard, stays, other}};
  ReferenceOptions options;
  options.tolerance = 1e-5;  // nodes of both cars hold the same faces, so single forces are slow to settle
  follow_reference(cars, {}, h, options, [&](size_t k, std::span<const ReferenceStep> steps, std::span<const PairContact> met) {
    EXPECT_TRUE(steps.front().converged) << "sub-step " << k << ", residual " << steps.front().residual.back();
    EXPECT_GE(met.size(), 9u);
  });
  double worst = 0, depth = 0;
  for (size_t i = 0; i < by_car.node.size(); ++i) {
    worst = std::max(worst, (by_car.node[i] - by_wall.node[i]).norm());
    depth = std::max(depth, (by_wall.node[i] - soft->model.node[i].cast<double>()).norm());
  }
  EXPECT_NEAR(depth, substeps * h * speed, 0.02 * depth);
  EXPECT_LT(worst, 1e-4 * depth);
}

TEST(ReferencePairs, OneSubstepGivesTheSameNodesAndForces) {
  for (const float friction : {0.0f, 0.5f}) {
    for (const double way : {1e-3, 3e-3, 1e-2}) {
      SCOPED_TRACE(testing::Message() << "friction " << friction << ", pressed by " << way << " m");
      const Press press{way / h, friction};
      const Answer answer = reference(press, 1);
      EXPECT_GT(answer.depth, 0.7 * way);
      const double few = answer.difference(press.solved(1, 8));
      const PileUp many = press.solved(1, 2000);
      EXPECT_LT(few, 0.08);
      EXPECT_LT(answer.difference(press.solved(1, 64)), 0.05 * few);
      EXPECT_LT(answer.difference(many), 4e-7 / way + 8e-5);  // single precision at 2 m from the origin is exact to 0.1 um
      float largest = 0;
      for (const PairContact& contact : answer.contact) largest = std::max(largest, contact.pressed);
      double sum = 0, theirs = 0;
      for (const PairContact& contact : answer.contact) {
        for (const PairMemory::Touch& touch : many.cars[contact.car[0]].body.pairs.touch) {
          if (touch.node != contact.node) continue;
          EXPECT_NEAR(touch.pressure, contact.pressed, 0.03f * largest) << "node " << touch.node;
          theirs += double(touch.pressure);
        }
        sum += double(contact.pressed);
      }
      EXPECT_NEAR(theirs, sum, 5e-3 * sum);
    }
  }
}

TEST(ReferencePairs, DentsOfACrashComeToTheReferenceAsTheSweepsGrow) {
  struct Case {
    float friction;
    int substeps;
    double usual, many;  // largest difference at the default settings and with few sweeps, and with 1000 sweeps
  };
  // After some 20 sub-steps without friction corners slip past edges.
  for (const auto& [friction, whole, usual, many] : {Case{0.3f, 12, 0.02, 2e-5}, Case{0, 20, 0.05, 5e-4}}) {
    const int substeps = sanitized ? 8 : whole;                    // the reference is slow there
    const double few = sanitized ? std::max(usual, 0.05) : usual;  // an error of the first sub-steps fades only later
    SCOPED_TRACE(testing::Message() << "friction " << friction << ", " << substeps << " sub-steps");
    const Press press{3, friction};
    const Answer answer = reference(press, substeps, 1e-7);
    EXPECT_GT(answer.depth, 0.7 * press.speed * substeps * h);
    for (const int sweeps : {0, 8, 24, 64, 1000}) {
      const double difference = answer.difference(press.solved(substeps, uint16_t(sweeps)));
      EXPECT_LT(difference, sweeps == 1000 ? many : few) << sweeps << " sweeps";
      RecordProperty("friction_" + std::to_string(friction) + "_sweeps_" + std::to_string(sweeps), std::to_string(difference));
    }
  }
}

}  // namespace
}  // namespace crumple

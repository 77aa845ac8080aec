// Tests the reference minimiser against closed forms and against itself, because other code is measured by it. Then tests the
// float law of the sweeps and the sweeps themselves against it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "box_car.h"
#include "reference/newton.h"
#include "sim/deform.h"
#include "sim/flow.h"

namespace crumple {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

const double h = substep_seconds(Parameters());

Material material(float poisson = 0, float yield = 0.009f) {
  Material out;
  out.poisson_ratio = poisson;
  out.yield_strain = yield;
  out.plastic_limit = 1.2f;
  return out;
}

Vector3d random_strain(std::mt19937& random, double size) {
  std::normal_distribution<double> entry(0, size);
  return {entry(random), entry(random), entry(random)};
}

// A box of tets. The test chooses the anchored nodes and their places.
struct Block {
  std::shared_ptr<const Car> car;
  std::vector<Vec3> node;
  std::vector<uint8_t> anchored;
  Model model;
  Parameters parameters;
  ReferenceState state;
  Vector3d low, high;

  explicit Block(const Material& each, BoxCells cells = {3, 2, 2}, bool keep_anchors = false)
      : car(box_car(cells)),
        node(car->model.node.begin(), car->model.node.end()),
        anchored(node.size(), 0),
        model(car->model),
        state(make_reference(model)),
        low(Vector3d::Constant(1e9)),
        high(-low) {
    parameters.region.fill(each);
    model.node = node;
    if (!keep_anchors) model.node_anchored = anchored;
    for (const Vec3& x : node) {
      low = low.cwiseMin(x.cast<double>());
      high = high.cwiseMax(x.cast<double>());
    }
  }
  bool on_boundary(size_t i) const {
    const Vector3d x = node[i].cast<double>();
    return ((x - low).array().abs() < 1e-6).any() || ((x - high).array().abs() < 1e-6).any();
  }
  ReferenceStep step(const std::vector<Contact>& contacts = {}, double seconds = h) {
    return step_reference(model, parameters, contacts, seconds, {}, state);
  }
  // Two plates without friction with this distance along x. The left plate does not move.
  std::vector<Contact> plates(double room, float friction = 0, const Vec3& carry = Vec3::Zero()) const {
    std::vector<Contact> contacts;
    for (uint32_t i = 0; i < node.size(); ++i) {
      const bool left = node[i].x() - low.x() < 1e-6, right = high.x() - node[i].x() < 1e-6;
      if (!left && !right) continue;
      const Vec3 normal = left ? Vec3::UnitX() : Vec3(-Vec3::UnitX());
      const double offset = left ? low.x() : -low.x() - room;
      contacts.push_back(
          {i, 0, normal, float(offset), 0, -1, state.node[i].cast<float>() + (right ? carry : Vec3::Zero()), friction});
    }
    return contacts;
  }
  double area() const { return (high - low).y() * (high - low).z(); }
};

// ---- the law ------------------------------------------------------------------------------------------------------------

TEST(ReferenceLaw, FlowEndsOnTheHardenedYieldSurfaceAndGoesAlongTheStress) {
  std::mt19937 random(3);
  for (float poisson : {0.0f, 0.2f, 0.4f}) {
    const ReferenceMaterial m = reference_material(material(poisson));
    int flowed = 0, full = 0;
    for (int k = 0; k < 1000; ++k) {
      const double kappa = k % 3 * 0.55;
      const Vector3d trial = random_strain(random, 0.15);
      const Mapped mapped = map_strain(m, trial, kappa);
      if (mapped.growth == 0) continue;
      const bool at_limit = kappa + mapped.growth > m.limit - 1e-9;
      const double yield = m.yield(kappa + mapped.growth);
      EXPECT_NEAR(((trial - mapped.strain) / mapped.growth - mapped.stress.normalized()).norm(), 0, 1e-9);
      EXPECT_LE(kappa + mapped.growth, m.limit + 1e-12);
      if (at_limit) {
        EXPECT_GE(mapped.stress.norm(), yield * (1 - 1e-9));
      } else {
        EXPECT_NEAR(mapped.stress.norm() / yield, 1, 1e-10);
      }
      ++(at_limit ? full : flowed);
    }
    EXPECT_GT(flowed, 300);
    EXPECT_GT(full, 100);
  }
}

TEST(ReferenceLaw, StressIsTheSlopeOfTheEnergyAndTheTangentThatOfTheStress) {
  std::mt19937 random(4);
  constexpr double nudge = 1e-6;
  for (float poisson : {0.0f, 0.3f}) {
    const ReferenceMaterial m = reference_material(material(poisson));
    for (int k = 0; k < 200; ++k) {
      const double kappa = k % 3 * 0.55;
      const Vector3d trial = random_strain(random, 0.1);
      const Mapped here = map_strain(m, trial, kappa);
      for (int i = 0; i < 3; ++i) {
        const Vector3d d = nudge * Vector3d::Unit(i);
        const Mapped up = map_strain(m, trial + d, kappa), down = map_strain(m, trial - d, kappa);
        if ((up.growth > 0) != (down.growth > 0)) continue;  // the tangent has a kink between the two
        EXPECT_NEAR((up.energy - down.energy) / (2 * nudge), here.stress[i], 1e-7 * m.shear);
        if ((kappa + up.growth > m.limit - 1e-9) != (kappa + down.growth > m.limit - 1e-9)) continue;
        EXPECT_LT(((up.stress - down.stress) / (2 * nudge) - here.tangent.col(i)).norm(), 1e-5 * m.shear);
      }
    }
  }
}

TEST(ReferenceLaw, PressureAloneGivesTheClosedForm) {
  // All three strains e: |tau| = sqrt(3) |mu exp(2e) + l (exp(3e) - gamma) exp(3e)| = Y(sqrt(3) |trial - e|).
  for (float poisson : {0.0f, 0.3f}) {
    const ReferenceMaterial m = reference_material(material(poisson));
    for (double trial : {-0.15, -0.05, 0.05, 0.2}) {
      const auto excess = [&](double e) {
        const double j = std::exp(3 * e);
        return std::sqrt(3.0) * std::fabs(m.mu * std::exp(2 * e) + m.l * (j - m.gamma) * j) -
               m.yield(std::sqrt(3.0) * std::fabs(trial - e));
      };
      double low = 0, high = trial;
      for (int k = 0; k < 100; ++k) (excess(0.5 * (low + high)) > 0 ? high : low) = 0.5 * (low + high);
      const Mapped mapped = map_strain(m, Vector3d::Constant(trial), 0);
      EXPECT_LT((mapped.strain - Vector3d::Constant(low)).norm(), 1e-12);
      EXPECT_NEAR(mapped.growth, std::sqrt(3.0) * std::fabs(trial - low), 1e-12);
    }
  }
}

TEST(ReferenceLaw, TheSlopeAndTheAreaOfTheYieldStressAreItsOwn) {
  const ReferenceMaterial m = reference_material(material(), 0.7);
  EXPECT_NEAR(m.yield(0), 0.7 * 25e6 * 0.009, 1);
  constexpr double nudge = 1e-6;
  double area = 0;
  constexpr int slices = 20000;
  for (int k = 0; k < slices; ++k) {
    const double kappa = 1.2 * (k + 0.5) / slices;
    area += m.yield(kappa) * 1.2 / slices;
    if (k % 100 == 0) {
      EXPECT_NEAR((m.yield(kappa + nudge) - m.yield(kappa - nudge)) / (2 * nudge), m.rise(kappa), 1e-5 * m.shear);
    }
    if (k % 1000 == 0) {
      EXPECT_NEAR(m.plastic(kappa, 0.3), m.plastic(0, kappa + 0.3) - m.plastic(0, kappa), 1e-9 * area);
    }
  }
  EXPECT_NEAR(m.plastic(0, 1.2), area, 1e-6 * area);
}

TEST(ReferenceLaw, ASmallPullGivesTheKappaOfTheLinearLaw) {
  // Strains so small that stress = E strain: kappa = (E strain - start) / (E + slope).
  Material small = material(0, 1e-5f);
  small.hardening_strain = 1000;
  const ReferenceMaterial m = reference_material(small);
  const Mapped mapped = map_strain(m, {3e-5, 0, 0}, 0);
  EXPECT_NEAR(mapped.growth, 2e-5 / (1 + double(small.hardening)), 1e-9);
}

TEST(ReferenceLaw, TheTangentOfATetIsTheSlopeOfItsStressAndProjectedItIsNeverNegative) {
  std::mt19937 random(5);
  std::normal_distribution<double> entry(0, 0.1);
  constexpr double nudge = 1e-6;
  int negative = 0;
  for (int k = 0; k < 100; ++k) {
    const ReferenceMaterial m = reference_material(material(k % 2 ? 0.3f : 0.0f));
    Matrix3d f = Matrix3d::Identity();
    for (int i = 0; i < 9; ++i) f(i / 3, i % 3) += entry(random);
    if (k % 10 == 0) f.col(0) *= -1;  // inverted tets too
    const TetLaw here = tet_law(FlowLaw::mapped, m, f, 0, true, false);
    for (int i = 0; i < 9; ++i) {
      Matrix3d d = Matrix3d::Zero();
      d(i % 3, i / 3) = nudge;
      const TetLaw up = tet_law(FlowLaw::mapped, m, f + d, 0, false, false),
                   down = tet_law(FlowLaw::mapped, m, f - d, 0, false, false);
      EXPECT_NEAR((up.energy - down.energy) / (2 * nudge), here.stress(i % 3, i / 3), 1e-7 * m.shear);
      const Matrix3d column = Eigen::Map<const Matrix3d>(here.tangent.col(i).data());
      EXPECT_LT(((up.stress - down.stress) / (2 * nudge) - column).norm(), 1e-5 * m.shear);
    }
    using Matrix9d = Eigen::Matrix<double, 9, 9>;
    const Matrix9d projected = tet_law(FlowLaw::mapped, m, f, 0, true, true).tangent;
    negative += Eigen::SelfAdjointEigenSolver<Matrix9d>(here.tangent).eigenvalues().minCoeff() < -1e-6 * m.shear;
    EXPECT_GT(Eigen::SelfAdjointEigenSolver<Matrix9d>(projected).eigenvalues().minCoeff(), -1e-9 * m.shear);
  }
  EXPECT_GT(negative, 10);
}

TEST(ReferenceLaw, TurningATetTurnsItsStressAndCostsNothing) {
  const ReferenceMaterial m = reference_material(material(0.2f));
  const Matrix3d turn = Eigen::AngleAxisd(1.1, Vector3d(1, 2, -1).normalized()).toRotationMatrix();
  EXPECT_NEAR(tet_law(FlowLaw::mapped, m, turn, 0, false, false).energy, 0, 1e-12 * m.shear);
  EXPECT_LT(tet_law(FlowLaw::mapped, m, turn, 0, false, false).stress.norm(), 1e-12 * m.shear);
  Matrix3d f = Matrix3d::Identity();
  f(0, 0) = 0.9;
  f(0, 1) = 0.05;
  const TetLaw still = tet_law(FlowLaw::mapped, m, f, 0, false, false),
               turned = tet_law(FlowLaw::mapped, m, turn * f, 0, false, false);
  EXPECT_NEAR(turned.energy, still.energy, 1e-12 * m.shear);
  EXPECT_LT((turned.stress - turn * still.stress).norm(), 1e-12 * m.shear);
}

// ---- the minimiser ------------------------------------------------------------------------------------------------------

TEST(Reference, TheGradientIsTheSlopeOfThePotential) {
  Block block(material(0.2f));
  std::mt19937 random(6);
  std::normal_distribution<double> entry(0, 0.02);
  std::vector<Vector3d> x = block.state.node, gradient;
  for (Vector3d& each : x) each += Vector3d(entry(random), entry(random), entry(random));
  reference_potential(block.model, block.parameters, block.state, h, x, &gradient);
  double largest = 0;
  for (const Vector3d& each : gradient) largest = std::max(largest, each.norm());
  constexpr double nudge = 1e-6;
  for (size_t i = 0; i < x.size(); i += 5) {
    for (int axis = 0; axis < 3; ++axis) {
      std::vector<Vector3d> up = x, down = x;
      up[i][axis] += nudge;
      down[i][axis] -= nudge;
      const double slope = (reference_potential(block.model, block.parameters, block.state, h, up, nullptr) -
                            reference_potential(block.model, block.parameters, block.state, h, down, nullptr)) /
                           (2 * nudge);
      EXPECT_NEAR(slope, gradient[i][axis], 1e-6 * largest);
    }
  }
}

TEST(Reference, AMovedAndTurnedBodyCarriesNoForceButDrag) {
  Material still = material();
  still.drag = 0;
  Block block(still);
  const Matrix3d turn = Eigen::AngleAxisd(0.8, Vector3d(1, -1, 2).normalized()).toRotationMatrix();
  std::vector<Vector3d> x, gradient;
  for (const Vector3d& each : block.state.node) x.emplace_back(turn * each + Vector3d(3, -2, 1));
  reference_potential(block.model, block.parameters, block.state, h, x, &gradient);
  const double force = double(still.young_modulus) * block.area();
  for (const Vector3d& each : gradient) EXPECT_LT(each.norm(), 1e-6 * force);  // the gradients of a car are in single precision
}

TEST(Reference, APatchWhoseBoundaryIsStretchedStretchesAlikeInside) {
  Matrix3d f;
  f << 1.02, 0.03, 0, -0.01, 0.95, 0.02, 0, 0.01, 1.01;
  for (float yield : {1.0f, 0.009f}) {  // elastic; flowing
    Block block(material(0.2f, yield), {4, 4, 4});
    for (size_t i = 0; i < block.node.size(); ++i) {
      block.anchored[i] = block.on_boundary(i);
      if (block.anchored[i]) block.node[i] = (f * block.node[i].cast<double>()).cast<float>();
    }
    for (Material& each : block.parameters.region) each.drag = 0;
    const std::vector<Vector3d> rest = block.state.node;
    EXPECT_TRUE(block.step().converged);
    int inside = 0;
    for (size_t i = 0; i < rest.size(); ++i) {
      EXPECT_LT((block.state.node[i] - f * rest[i]).norm(), 2e-6);
      inside += !block.anchored[i];
    }
    EXPECT_GT(inside, 20);
    for (double kappa : block.state.hardening) EXPECT_NEAR(kappa, block.state.hardening[0], 1e-5);
    EXPECT_EQ(block.state.hardening[0] > 0.01, yield < 1);
  }
}

TEST(Reference, AnElasticBarBetweenPlatesGivesTheClosedForm) {
  // The lateral stretch s of stress-free sides: mu s + l (r s^2 - gamma) r s = 0 at the axial stretch r.
  for (float poisson : {0.0f, 0.3f}) {
    Material bar = material(poisson, 1);
    bar.drag = 1e-3f;
    Block block(bar);
    const ReferenceMaterial m = reference_material(bar);
    const double stretch = 0.9, room = stretch * (block.high - block.low).x();
    const ReferenceStep step = block.step(block.plates(room));
    EXPECT_TRUE(step.converged);
    const double s2 = (m.gamma - m.mu / (m.l * stretch)) / stretch;
    const double expected = block.area() * (m.mu * stretch + m.l * (stretch * s2 - m.gamma) * s2);
    double right = 0, width_low = 1e9, width_high = -1e9;
    for (size_t i = 0; i < block.node.size(); ++i) {
      if (block.high.x() - block.node[i].x() < 1e-6) right += step.contact_force[i].x();
      width_low = std::min(width_low, block.state.node[i].y());
      width_high = std::max(width_high, block.state.node[i].y());
    }
    EXPECT_NEAR(right / expected, 1, 1e-5);
    EXPECT_NEAR((width_high - width_low) / (block.high - block.low).y(), std::sqrt(s2), 1e-5);
    EXPECT_LT(step.force.norm(), 1e-4 * std::fabs(right));  // the forces of the two plates
  }
}

TEST(Reference, ABlockCrushedBetweenPlatesFlowsEvenlyAndAsOneTetWould) {
  Material foam = material();
  foam.drag = 1e-3f;
  Block block(foam);
  // The history of one tet: at each step, bisection finds the lateral stretch with stress-free sides.
  const double length = (block.high - block.low).x();
  Vector3d elastic = Vector3d::Zero();
  double kappa = 0, last_axial = 1, last_side = 1, volume_ratio = 1;
  for (double axial : {0.97, 0.93, 0.88, 0.83}) {
    const ReferenceStep step = block.step(block.plates(axial * length));
    EXPECT_TRUE(step.converged);
    const ReferenceMaterial m = reference_material(foam, volume_ratio);
    double low = 0.8, high = 1.2;
    Mapped mapped;
    Vector3d trial;
    for (int k = 0; k < 60; ++k) {
      const double side = 0.5 * (low + high);
      const Vector3d more(std::log(axial / last_axial), std::log(side / last_side), std::log(side / last_side));
      trial = elastic + more;
      mapped = map_strain(m, trial, kappa);
      (mapped.stress.y() > 0 ? high : low) = side;
    }
    elastic = mapped.strain;
    volume_ratio *= std::exp((trial - mapped.strain).sum());
    kappa += mapped.growth;
    last_axial = axial;
    last_side = low;
    double right = 0;
    for (size_t i = 0; i < block.node.size(); ++i) {
      if (block.high.x() - block.node[i].x() < 1e-6) right += step.contact_force[i].x();
    }
    EXPECT_NEAR(right / (mapped.stress.x() / axial * block.area()), 1, 1e-4);
    for (double each : block.state.hardening) EXPECT_NEAR(each, kappa, 1e-5);
  }
  EXPECT_GT(kappa, 0.15);
}

TEST(Reference, NewtonsResidualFallsQuadratically) {
  Block block(material(0.2f));
  const ReferenceStep step = block.step(block.plates(0.97 * (block.high - block.low).x()));
  ASSERT_TRUE(step.converged);
  ASSERT_GE(step.residual.size(), 3u);
  // Starts at the first residual under 1e-3. Round-off ends the convergence.
  int seen = 0;
  for (size_t k = 0; k + 1 < step.residual.size(); ++k) {
    if (step.residual[k] > 1e-3) continue;
    EXPECT_LT(step.residual[k + 1], std::max(100 * step.residual[k] * step.residual[k], 1e-12)) << "pass " << k;
    ++seen;
  }
  EXPECT_GE(seen, 1);
  EXPECT_LT(step.residual.size(), 15u);
}

TEST(Reference, FrictionSticksWithinTheConeAndSlidesOnIt) {
  for (const bool slides : {false, true}) {
    Block block(material(0, 1));
    const float friction = 0.3f, aside = slides ? 0.3f : 2e-4f;
    block.step(block.plates(0.97 * (block.high - block.low).x(), friction));
    const ReferenceStep step = block.step(block.plates(0.97 * (block.high - block.low).x(), friction, {0, aside, 0}));
    EXPECT_TRUE(step.converged);
    EXPECT_EQ(step.sliding > 0, slides);
    for (size_t i = 0; i < block.node.size(); ++i) {
      const Vector3d& force = step.contact_force[i];
      const double normal = std::fabs(force.x()), along = std::hypot(force.y(), force.z());
      EXPECT_LE(along, double(friction) * normal * (1 + 1e-7) + 1e-6);
      if (slides && block.high.x() - block.node[i].x() < 1e-6) {
        EXPECT_NEAR(along, double(friction) * normal, 1e-6 * normal);
        EXPECT_GT(force.y(), 0);  // the plate drags the node along
      }
    }
  }
}

TEST(Reference, APlateThatGoesBackLetsItsNodesGo) {
  Material foam = material();
  foam.drag = 1;
  Block block(foam);
  const double length = (block.high - block.low).x();
  EXPECT_GT(block.step(block.plates(0.95 * length)).held, 0);
  ReferenceStep step;
  for (int k = 0; k < 20; ++k) step = block.step(block.plates(1.1 * length));
  EXPECT_TRUE(step.converged);
  EXPECT_LT(step.force.norm(), 1);
  EXPECT_GT(block.state.hardening[0], 0);
}

TEST(Reference, APlaneNeverPulls) {
  // The plate comes 0.1 mm nearer, and the other end moves away by 20 mm. Nodes first touch the plate and must then leave it.
  Block block(material(0, 1));
  std::vector<Contact> contacts;
  for (const Contact& each : block.plates((block.high - block.low).x() - 1e-4)) {
    if (block.node[each.node].x() > 0) contacts.push_back(each);
  }
  for (size_t i = 0; i < block.node.size(); ++i) {
    block.anchored[i] = block.node[i].x() - block.low.x() < 1e-6;
    if (block.anchored[i]) block.node[i].x() -= 0.02f;
  }
  for (Material& each : block.parameters.region) each.drag = 0;
  const ReferenceStep step = block.step(contacts);
  EXPECT_TRUE(step.converged);
  EXPECT_EQ(step.held, 0);
  EXPECT_EQ(step.force.norm(), 0);
  for (const Contact& each : contacts) EXPECT_LT(block.state.node[each.node].x(), block.high.x() - 0.015);
}

// ---- the float code against it --------------------------------------------------------------------------------------------

TEST(ReferenceTwin, FlowIsTheSameInSinglePrecision) {
  std::mt19937 random(8);
  for (float poisson : {0.0f, 0.3f}) {
    const Material each = material(poisson);
    const ReferenceMaterial m = reference_material(each);
    int flowed = 0;
    for (int k = 0; k < 500; ++k) {
      const Vector3d trial = random_strain(random, 0.05);
      const Mat3 f = trial.array().exp().matrix().cast<float>().asDiagonal();
      Gradients gradients{{Vec3::UnitX(), Vec3::UnitY(), Vec3::UnitZ()}};
      float kappa = float(k % 3) * 0.2f;
      const double before = double(kappa);
      const float work = flow(elastic(each), yield_law(each), f, gradients, kappa);
      const Mapped own = flow_strain(m, trial, before);
      if (own.growth < 1e-4) continue;
      ++flowed;
      EXPECT_NEAR(double(kappa) - before, own.growth, 1e-5);
      EXPECT_NEAR(double(work), own.work, 2e-3 * own.work + 1);
      for (int i = 0; i < 3; ++i) {
        EXPECT_NEAR(std::log(double(gradients.corner[i][i])), own.strain[i] - trial[i], 1e-5);
      }
      // The exact law. flow() follows the stress of the logarithmic law instead of the neo-Hookean one.
      const Mapped exact = map_strain(m, trial, before);
      EXPECT_NEAR(exact.growth, own.growth, 0.02 * own.growth + 1e-4);
      EXPECT_LT((exact.strain - own.strain).norm(), 0.1 * own.strain.norm());
    }
    EXPECT_GT(flowed, 300);
  }
}

TEST(ReferenceTwin, SecantIsTheSameInSinglePrecisionAndNearTheExactStress) {
  std::mt19937 random(9);
  double worst = 0;
  for (float poisson : {0.0f, 0.3f}) {
    const Material each = material(poisson);
    const ReferenceMaterial m = reference_material(each);
    for (int k = 0; k < 500; ++k) {
      const Vector3d trial = random_strain(random, 0.02);
      const Matrix3d f = trial.array().exp().matrix().asDiagonal();
      const Elastic e = secant(elastic(each), yield_law(each), f.cast<float>(), 0);
      const double j = f.determinant();
      const Matrix3d stress = double(e.mu) * f + double(e.l) * (j - double(e.gamma)) * j * f.inverse().transpose();
      const Matrix3d own = tet_law(FlowLaw::secant, m, f, 0, false, false).stress;
      EXPECT_LT((stress - own).norm(), 2e-5 * m.shear);
      const Matrix3d exact = tet_law(FlowLaw::mapped, m, f, 0, false, false).stress;
      worst = std::max(worst, (own - exact).norm() / std::max(exact.norm(), m.start));
    }
  }
  RecordProperty("worst", std::to_string(worst));
  EXPECT_LT(worst, 0.15);
}

TEST(ReferenceTwin, NodalComesToTheReferenceAsItsSweepsGrow) {
  Block block(material(), {9, 4, 3}, true);
  const Model& model = block.model;
  constexpr int substeps = 8;
  constexpr double speed = 10;
  Obstacle wall;
  make_box({0.5f, 5, 5}, wall);
  wall.friction = 0;
  wall.pose.position.x() = block.high.x() + 0.5;
  std::vector<Pose> path(1);
  for (int k = 0; k < substeps; ++k) {
    path.push_back(path.back());
    path.back().position.x() += speed * h;
  }
  const auto solved = [&](uint16_t sweeps) {
    Parameters parameters = block.parameters;
    parameters.iterations = sweeps;
    parameters.tolerance = 0;
    Mass mass;
    mass.mass = std::numeric_limits<double>::infinity();
    mass.inertia.setConstant(mass.mass);
    DeformableState body = make_body(model);
    Motion motion;
    motion.velocity.x() = speed;
    const ScratchHandle scratch = make_scratch();
    deform({model, parameters, mass, {&wall, 1}, substeps * h}, *scratch, body, motion);
    return body.node;
  };
  const std::vector<Vec3> with_few = solved(5), with_many = solved(500);
  const auto distance = [](const std::vector<Vec3>& nodes, const std::vector<Vector3d>& reference) {
    double sum = 0;
    for (size_t i = 0; i < reference.size(); ++i) sum += (nodes[i].cast<double>() - reference[i]).squaredNorm();
    return std::sqrt(sum / double(reference.size()));
  };
  for (const FlowLaw law : {FlowLaw::secant, FlowLaw::mapped}) {
    ReferenceOptions options;
    options.law = law;
    ReferenceState state = make_reference(model);
    follow_reference(
        model, block.parameters, {&wall, 1}, path, h, options,
        [](size_t, const ReferenceStep& step) { EXPECT_TRUE(step.converged); }, state);
    const double few = distance(with_few, state.node), many = distance(with_many, state.node), depth = substeps * speed * h;
    EXPECT_LT(many, (law == FlowLaw::secant ? 0.0002 : 0.01) * depth);
    if (law == FlowLaw::secant) {
      EXPECT_LT(many, 0.2 * few);
    }
  }
}

}  // namespace
}  // namespace crumple

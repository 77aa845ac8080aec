// Tests the residual elongation of a bar that was pulled beyond its yield strain, against its closed form, also with few
// sweeps.
#include "reference/bar.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "box_car.h"
#include "sanitized.h"

namespace crumple {
namespace {

constexpr BoxCells cells = sanitized ? BoxCells{10, 2, 2} : BoxCells{20, 4, 4};

// 1.0 x 0.2 x 0.2 m, 1,920 tets; 240 under sanitizers.
TetMesh bar() {
  TetMesh mesh = box_mesh(cells).tets;
  Eigen::AlignedBox3f box;
  for (const Vec3& x : mesh.node) box.extend(x);
  for (Vec3& x : mesh.node) x = (x - box.min()).cwiseQuotient(box.sizes()).cwiseProduct(Vec3(1, 0.2f, 0.2f));
  return mesh;
}

TEST(Bar, KeepsItsPlasticSetAtAnyNumberOfSweeps) {
  Parameters parameters;
  parameters.tolerance = 0;
  for (Material& material : parameters.region) {
    material.yield_strain = 0.02f;
    material.hardening = 0.045f;
    material.hardening_strain = 1000;
  }
  parameters.tolerance = 0;
  const Material& material = parameters.region[0];
  const double expected = closed_form_set(material);
  double kappa = 0;  // by logarithmic elasticity
  for (int k = 0; k < 100; ++k) {
    kappa = std::log1p(bar_pull) - std::exp(kappa) * double(material.yield_strain + material.hardening * float(kappa));
  }
  EXPECT_NEAR(std::expm1(kappa) / expected, 1, 0.01);
  const TetMesh tets = bar();
  for (int sweeps : {4, 8, 16, 32, 64}) {
    if (sanitized && sweeps > 4 && sweeps < 64) continue;  // the same code
    parameters.iterations = uint16_t(sweeps);
    const PulledBar pulled = pull_bar(tets, 1, parameters);
    EXPECT_NEAR(pulled.set / expected, 1, 0.01) << sweeps << " sweeps";
    EXPECT_TRUE(pulled.body.settled) << sweeps << " sweeps";
    if (sweeps < 64) continue;  // with fewer sweeps the set is right, but not yet spread evenly over the tets
    const auto [least, most] = std::minmax_element(pulled.body.hardening.begin(), pulled.body.hardening.end());
    EXPECT_NEAR(double(*least), std::log1p(expected), 0.05 * std::log1p(expected));
    EXPECT_NEAR(double(*most), std::log1p(expected), 0.05 * std::log1p(expected));
  }
}

}  // namespace
}  // namespace crumple

#include "sim/flow.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace crumple {
namespace {

// Our own log and exp, because the C library chooses a variant by processor, and results must have the same bits everywhere.
// Errors are below 1e-12 for arguments as small as strains.
double log_of(double x) {
  int exponent;
  double m = std::frexp(x, &exponent);
  if (m < 0.70710678118654752) {
    m *= 2;
    --exponent;
  }
  const double s = (m - 1) / (m + 1), s2 = s * s;
  double sum = 1.0 / 15;
  for (int k = 13; k >= 1; k -= 2) sum = sum * s2 + 1.0 / k;
  return 2 * s * sum + exponent * 0.69314718055994531;
}

double exp_of(double x) {
  const double k = std::nearbyint(x * 1.4426950408889634);
  const double r = x - k * 0.69314718055994531;
  constexpr double inverse_factorial[] = {
      1.0,        1.0,         1.0 / 2,      1.0 / 6,       1.0 / 24,       1.0 / 120,       1.0 / 720,
      1.0 / 5040, 1.0 / 40320, 1.0 / 362880, 1.0 / 3628800, 1.0 / 39916800, 1.0 / 479001600, 1.0 / 6227020800};
  double sum = 0;
  for (int n = 13; n >= 0; --n) sum = sum * r + inverse_factorial[n];
  return std::ldexp(sum, int(k));
}

// The yield stress is at least that of a strain of 1e-5: without any yield stress a tet would be a fluid.
float yield_of(const YieldLaw& law, float kappa) {
  return std::max(law.start + law.slope * kappa, 1e-5f * std::max(law.shear, law.bulk));
}

}  // namespace

Elastic elastic(const Material& material) {
  const float mu = material.young_modulus / (2 * (1 + material.poisson_ratio));
  const float lambda =
      material.young_modulus * material.poisson_ratio / ((1 + material.poisson_ratio) * (1 - 2 * material.poisson_ratio));
  return {mu, lambda + mu, 1 + mu / (lambda + mu)};
}

YieldLaw yield_law(const Material& material) {
  const Elastic e = elastic(material);
  const float lambda = e.l - e.mu;
  return {2 * e.mu, 3 * lambda + 2 * e.mu, material.young_modulus * material.yield_strain,
          material.young_modulus * material.hardening, material.plastic_limit};
}

float plastic_multiplier(const YieldLaw& law, float deviator, float mean, float kappa) {
  const float norm = std::sqrt(deviator * deviator + mean * mean);
  const float yield = yield_of(law, kappa);
  const float room = law.limit - kappa;
  if (!(norm > yield) || !(room > 0)) return 0;
  const float stiffest = std::max(law.shear, law.bulk);
  // If both moduli were the stiffer one, norm / (1 + k D) (1 - slope D) = yield would be linear in D. Its solution is left of
  // the root of the convex falling function below, so Newton climbs from there to the root.
  float d = (norm - yield) / (stiffest * yield + law.slope * norm);
  if (law.shear != law.bulk) {
    for (int i = 0; i < 5; ++i) {
      const float a = deviator / (1 + law.shear * d), b = mean / (1 + law.bulk * d);
      const float left = std::sqrt(a * a + b * b);
      const float slope = -(a * a * law.shear / (1 + law.shear * d) + b * b * law.bulk / (1 + law.bulk * d)) / left;
      const float rest = 1 - law.slope * d;
      const float value = left * rest - yield;
      const float derivative = slope * rest - left * law.slope;
      if (!(value > 0)) break;
      d -= value / derivative;
    }
  }
  // kappa grows by D times the flowed stress, up to its limit.
  const float flowed = norm / (1 + stiffest * d);
  if (d * flowed > room) d = norm > stiffest * room ? room / (norm - stiffest * room) : d;
  return d;
}

Elastic secant(const Elastic& e, const YieldLaw& law, const Mat3& f, float kappa) {
  const float j = f.determinant();
  const float pressure_like = e.l * (j - e.gamma) * j;
  // tau = mu F F^T + l (J - gamma) J I
  const Mat3 left = f * f.transpose();
  const float mean = e.mu * left.trace() / 3 + pressure_like;
  const float deviator2 = e.mu * e.mu * std::max(0.0f, left.squaredNorm() - left.trace() * left.trace() / 3);
  const float total2 = deviator2 + 3 * mean * mean;
  const float yield = yield_of(law, kappa);
  if (total2 <= yield * yield) return e;
  const float d = plastic_multiplier(law, std::sqrt(deviator2), std::sqrt(3.0f) * std::fabs(mean), kappa);
  const float mu = e.mu / (1 + law.shear * d);
  const float bulk = law.bulk / (1 + law.bulk * d);
  const float l = (bulk + mu) / 3;  // lambda + mu, from 3 K = 3 lambda + 2 mu
  return {mu, l, 1 + mu / l};
}

float flow(const Elastic& e, const YieldLaw& law, const Mat3& f, Gradients& gradients, float& kappa) {
  if (!(f.determinant() > 0.02f)) return 0;
  const Elastic now = secant(e, law, f, kappa);
  if (now.mu == e.mu && now.l == e.l) return 0;

  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> axes;
  const Eigen::Matrix3d right = (f.transpose() * f).cast<double>();
  axes.compute(right);
  const Eigen::Vector3d trial = axes.eigenvalues().cwiseMax(1e-6).unaryExpr([](double x) { return 0.5 * log_of(x); });
  // For the logarithmic law backward Euler has a closed form up to one number s: the deviator is s and the mean is
  // 1 / (1 + (bulk / shear) (1/s - 1)) of the trial's. At the large strain of a trial the neo-Hookean stress differs from that
  // law's. So s is where the neo-Hookean stress meets the yield surface, or where kappa meets its limit. It is found by false
  // position (Illinois); the excess grows with s.
  const double mean = trial.mean(), room = std::max(0.0, double(law.limit) - kappa);
  const Eigen::Vector3d deviator = trial.array() - mean;
  Eigen::Vector3d strain = trial;
  double norm = 0, grown = 0;
  const auto excess = [&](double s) {
    strain = (s * deviator).array() + mean * s / (s + law.bulk / law.shear * (1 - s));
    const Eigen::Vector3d stretch = strain.unaryExpr([](double x) { return exp_of(x); });
    const double j = stretch.prod();
    norm = ((e.mu * stretch.cwiseAbs2()).array() + e.l * (j - e.gamma) * j).matrix().norm();
    grown = (trial - strain).norm();
    return std::min((norm - double(yield_of(law, kappa + float(grown)))) / law.shear, room - grown);
  };
  double low = 0, high = 1, below = excess(0), above = excess(1);
  if (!(above > 0) || below > 0) return 0;
  for (int pass = 0; pass < 16; ++pass) {
    const double s = (low * above - high * below) / (above - below);
    const double value = excess(s);
    if (value > 0) {
      high = s;
      above = value;
      below *= 0.5;
    } else {
      low = s;
      below = value;
      above *= 0.5;
    }
    if (std::fabs(value) < 1e-6) break;
  }
  // Integral of Y d(kappa).
  const double work = 0.5 * (norm + law.start + law.slope * kappa) * grown;
  kappa = std::min(law.limit, kappa + float(grown));
  // Fe_new = Fe V diag(exp(strain - trial)) V^T. The same factor is applied to the rest gradients.
  const Eigen::Vector3d ratio = (strain - trial).unaryExpr([](double x) { return exp_of(x); });
  const Mat3 factor = (axes.eigenvectors() * ratio.asDiagonal() * axes.eigenvectors().transpose()).cast<float>();
  for (Vec3& corner : gradients.corner) corner = factor * corner;
  return float(std::max(0.0, work));
}

float energy_density(const Elastic& e, const Mat3& f) {
  // By g = F - I, so that nothing cancels at rest: |F|^2 - 3 = 2 tr g + |g|^2, J - 1 = tr g + second, and the terms with tr g
  // add to zero, since gamma = 1 + mu/l.
  const Mat3 g = f - Mat3::Identity();
  const float second = g(0, 0) * g(1, 1) - g(0, 1) * g(1, 0) + g(0, 0) * g(2, 2) - g(0, 2) * g(2, 0) + g(1, 1) * g(2, 2) -
                       g(1, 2) * g(2, 1) + g.determinant();
  const float growth = g.trace() + second;
  return 0.5f * (e.mu * (g.squaredNorm() - 2 * second) + e.l * growth * growth);
}

}  // namespace crumple

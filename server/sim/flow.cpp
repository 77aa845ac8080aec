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

// Slope of the yield stress over kappa, Pa.
float slope_of(const YieldLaw& law, float kappa) {
  const float left = 1 / (1 + kappa * law.fold);
  return law.slope * left * left + 2 * law.dense * std::max(kappa - law.dense_from, 0.0f);
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
  const float young = material.young_modulus;
  return {2 * e.mu,
          3 * lambda + 2 * e.mu,
          young * material.yield_strain,
          young * material.hardening,
          1 / material.hardening_strain,
          young * material.densification,
          material.densification_strain,
          material.plastic_limit};
}

YieldLaw crushed(const YieldLaw& law, float volume_ratio) {
  YieldLaw out = law;
  out.start *= volume_ratio;
  out.slope *= volume_ratio;
  out.dense *= volume_ratio;
  return out;
}

float volume_ratio(float rest, const Gradients& gradients) {
  const auto& g = gradients.corner;
  const float ratio = 1 / (6 * rest * g[0].dot(g[1].cross(g[2])));
  return ratio > 0 ? std::clamp(ratio, least_volume_ratio, most_volume_ratio) : 1;
}

float yield_stress(const YieldLaw& law, float kappa) {
  const float left = 1 / (1 + kappa * law.fold), beyond = std::max(kappa - law.dense_from, 0.0f);
  return std::max(law.start + law.slope * kappa * left + law.dense * beyond * beyond, 1e-5f * std::max(law.shear, law.bulk));
}

float plastic_multiplier(const YieldLaw& law, float deviator, float mean, float kappa) {
  const float norm = std::sqrt(deviator * deviator + mean * mean);
  const float room = law.limit - kappa;
  if (!(norm > yield_stress(law, kappa)) || !(room > 0)) return 0;
  const float stiffest = std::max(law.shear, law.bulk);
  // If both moduli were the stiffer one, the growth g of kappa would solve norm - stiffest g = Y(kappa + g). Newton's method
  // climbs from 0 to it while Y is concave; where Y is convex it may pass it, and comes back.
  float grown = 0;
  for (int i = 0; i < growth_steps; ++i) {
    const float value = norm - stiffest * grown - yield_stress(law, kappa + grown);
    grown = std::clamp(grown + value / (stiffest + slope_of(law, kappa + grown)), 0.0f, room);
  }
  float d = grown / (norm - stiffest * grown);
  if (law.shear != law.bulk) {
    for (int i = 0; i < 5; ++i) {
      const float a = deviator / (1 + law.shear * d), b = mean / (1 + law.bulk * d);
      const float left = std::sqrt(a * a + b * b), now = kappa + std::min(d * left, room);
      const float fall = (a * a * law.shear / (1 + law.shear * d) + b * b * law.bulk / (1 + law.bulk * d)) / left;
      const float slope = slope_of(law, now);
      d = std::max(0.0f, d + (left - yield_stress(law, now)) / (fall + slope * std::max(0.0f, left - d * fall)));
    }
    const float flowed = norm / (1 + stiffest * d);
    if (d * flowed > room && norm > stiffest * room) d = room / (norm - stiffest * room);
  }
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
  const float yield = yield_stress(law, kappa);
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
    return std::min((norm - double(yield_stress(law, kappa + float(grown)))) / law.shear, room - grown);
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
  // Integral of Y d(kappa), by Gauss with three points.
  const auto yield_at = [&](double share) { return double(yield_stress(law, kappa + float(share * grown))); };
  const double work = (5 * yield_at(0.11270167) + 8 * yield_at(0.5) + 5 * yield_at(0.88729833)) / 18 * grown;
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

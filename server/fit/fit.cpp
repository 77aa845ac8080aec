#include "fit/fit.h"

#include <tbb/parallel_for.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <stdexcept>
#include <unsupported/Eigen/NonLinearOptimization>

namespace crumple {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double derivative_step = 0.1;  // of ln(factor): crush changes by some 4 %, far more than the solver's error
constexpr double least_ln = -5, most_ln = 5;
constexpr int most_evaluations = 12;

constexpr Constant constants[] = {
    {"stress", "how deep the car is crushed", 1.5, [](float factor, Material& m) { m.young_modulus *= factor; }},
    {"hardening_strain", "at which crush the plateau begins, its height kept", 0.7,
     [](float factor, Material& m) {
       m.hardening_strain *= factor;
       m.hardening /= factor;
     }},
    {"densification", "how it stops a car that is crushed deeply", 0.7,
     [](float factor, Material& m) { m.densification *= factor; }},
    {"stiffness", "how fast it bounces back", 0.7,
     [](float factor, Material& m) {
       m.young_modulus *= factor;
       m.yield_strain /= factor;
       m.hardening /= factor;
       m.densification /= factor;
     }},
};

Parameters with(const Parameters& start, const VectorXd& ln) {
  Parameters out = start;
  for (Eigen::Index k = 0; k < ln.size(); ++k) {
    const float factor = float(std::exp(std::clamp(ln[k], least_ln, most_ln)));
    for (Material& material : out.region) constants[k].apply(factor, material);
  }
  return out;
}

// Residuals of the measurements, in standard deviations, and the constants' own.
struct Problem {
  using Scalar = double;
  const std::shared_ptr<const Car>& car;
  const std::vector<PublishedCar>& tests;
  const Parameters& start;
  const std::function<void(int)>& progress;
  VectorXd at, value;  // the last point and its residuals: the derivative begins with them
  int runs = 0;
  std::mutex told = {};

  // A point whose material is not allowed is as bad as one that is off by ten deviations everywhere.
  VectorXd evaluate(const VectorXd& ln) {
    const Parameters parameters = with(start, ln);
    VectorXd out(measurements() + ln.size());
    if (out_of_range(parameters)) {
      out.setConstant(10);
    } else {
      const std::vector<Comparison> all = compare(tests, play_tests(car, tests, parameters));
      for (size_t k = 0; k < all.size(); ++k) {
        const double off = (all[k].ours - all[k].measured) / all[k].deviation;
        out[Eigen::Index(k)] = std::isfinite(off) ? off : 100;
      }
    }
    for (Eigen::Index k = 0; k < ln.size(); ++k) out[measurements() + k] = ln[k] / constants[k].prior;
    const std::lock_guard lock(told);
    for (const PublishedCar& each : tests) runs += int(each.hits.size());
    if (progress) progress(runs);
    return out;
  }
  Eigen::Index measurements() const {
    Eigen::Index count = 0;
    for (const PublishedCar& each : tests) {
      for (const PublishedHit& hit : each.hits)
        count += (hit.crush > 0) + (hit.travel > 0) + (hit.restitution >= 0) + Eigen::Index(hit.force.size());
    }
    return count;
  }
  MatrixXd derivative(const VectorXd& ln) {
    if (at.size() == 0 || at != ln) at = ln, value = evaluate(ln);
    MatrixXd out(value.size(), ln.size());
    tbb::parallel_for(Eigen::Index{0}, ln.size(), [&](Eigen::Index k) {
      VectorXd beside = ln;
      beside[k] += derivative_step;
      out.col(k) = (evaluate(beside) - value) / derivative_step;
    });
    return out;
  }

  // What Eigen's LevenbergMarquardt asks for.
  int values() const { return int(value.size()); }
  int operator()(const VectorXd& ln, VectorXd& residual) {
    at = ln, value = evaluate(ln);
    residual = value;
    return 0;
  }
  int df(const VectorXd& ln, MatrixXd& jacobian) {
    jacobian = derivative(ln);
    return 0;
  }
};

}  // namespace

std::span<const Constant> fit_constants() { return constants; }

size_t constants_for(const std::vector<PublishedCar>& tests) {
  for (const PublishedCar& each : tests) {
    if (each.hits.size() >= 3) return std::size(constants);
    for (const PublishedHit& hit : each.hits) {
      if (!hit.force.empty()) return std::size(constants);
    }
  }
  return 1;
}

std::vector<std::vector<HitResult>> play_tests(const std::shared_ptr<const Car>& car, const std::vector<PublishedCar>& tests,
                                               const Parameters& parameters, double rate) {
  std::vector<std::vector<HitResult>> out(tests.size());
  tbb::parallel_for(size_t{0}, tests.size(), [&](size_t k) {
    const PublishedCar& each = tests[k];
    const auto scaled = scale_car(car, each.measures);
    CrashTest test(scaled, parameters, each.hits[0].damaged_width);
    for (const PublishedHit& hit : each.hits) {
      test.mass.inertia *= hit.mass / test.mass.mass;
      test.mass.mass = hit.mass;
      out[k].push_back(test.hit(rigid_wall(), hit.speed, rate));
    }
  });
  return out;
}

std::vector<Comparison> compare(const std::vector<PublishedCar>& tests, const std::vector<std::vector<HitResult>>& results) {
  constexpr double gravity = 9.80665;
  std::vector<Comparison> out;
  for (size_t k = 0; k < tests.size(); ++k) {
    for (size_t i = 0; i < tests[k].hits.size(); ++i) {
      const PublishedHit& hit = tests[k].hits[i];
      const HitResult& ours = results[k][i];
      if (hit.crush > 0)
        out.push_back(
            {k, i, "crush, mm", 1e3 * hit.crush, 1e3 * ours.crush, 1e3 * std::hypot(crush_share * hit.crush, crush_least)});
      if (hit.travel > 0)
        out.push_back({k, i, "travel, mm", 1e3 * hit.travel, 1e3 * ours.travel, 1e3 * travel_share * hit.travel});
      if (hit.restitution >= 0) out.push_back({k, i, "restitution", hit.restitution, ours.restitution, restitution_error});
      const std::vector<double> force = ours.force_by_sixtieth();
      double mean = 0;
      for (const double each : hit.force) mean += each / double(hit.force.size());
      for (size_t n = 0; n < hit.force.size(); ++n)
        out.push_back({k, i, "force / mass in sixtieth " + std::to_string(n + 1) + ", g", hit.force[n] / gravity,
                       (n < force.size() ? force[n] : 0) / gravity, force_share * mean / gravity});
    }
  }
  return out;
}

double rms_of(const std::vector<Comparison>& comparisons) {
  const bool crush =
      std::any_of(comparisons.begin(), comparisons.end(), [](const Comparison& c) { return c.what == "crush, mm"; });
  double squares = 0, count = 0;
  for (const Comparison& each : comparisons) {
    if (crush && each.what != "crush, mm") continue;
    squares += std::pow(each.ours / each.measured - 1, 2), ++count;
  }
  return std::sqrt(squares / std::max(count, 1.0));
}

Fit fit(const std::shared_ptr<const Car>& car, const std::vector<PublishedCar>& tests, size_t count, const Parameters& start,
        const std::function<void(int)>& progress) {
  Problem problem{car, tests, start, progress, {}, {}};
  const auto n = Eigen::Index(std::clamp<size_t>(count, 1, std::size(constants)));
  VectorXd ln = VectorXd::Zero(n);
  problem.at = ln, problem.value = problem.evaluate(ln);
  Eigen::LevenbergMarquardt<Problem> search(problem);
  search.parameters.maxfev = most_evaluations;
  search.parameters.ftol = search.parameters.xtol = 2e-3;
  search.parameters.factor = 1;  // the first step changes no constant by more than a factor e
  search.useExternalScaling = true;
  search.diag.setOnes(n);
  search.minimize(ln);

  Fit out;
  out.parameters = with(start, ln);
  // Measurements that scatter more than they should say less.
  const MatrixXd jacobian = problem.derivative(ln);
  const Eigen::Index m = problem.measurements();
  const double scatter = m > n ? problem.value.head(m).squaredNorm() / double(m - n) : 1;
  MatrixXd information = jacobian.topRows(m).transpose() * jacobian.topRows(m) / std::max(1.0, scatter);
  for (Eigen::Index k = 0; k < n; ++k) information(k, k) += 1 / std::pow(constants[k].prior, 2);
  const MatrixXd covariance = information.inverse();
  for (Eigen::Index k = 0; k < n; ++k) {
    FittedConstant fitted{&constants[k], std::exp(ln[k]), std::sqrt(covariance(k, k)), true};
    fitted.determined = fitted.deviation < 2.0 / 3 * fitted.constant->prior;
    out.constants.push_back(fitted);
  }
  if (const auto refused = out_of_range(out.parameters))
    throw std::runtime_error(car->name + ": no allowed material is crushed as these tests say (" + *refused +
                             "); check the units of mass and crush.");
  out.results = play_tests(car, tests, out.parameters);
  out.comparisons = compare(tests, out.results);
  out.rms = rms_of(out.comparisons);
  out.runs = problem.runs;
  return out;
}

}  // namespace crumple

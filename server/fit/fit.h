// Finds the material with which a car is crushed as published tests say: least squares (Levenberg and Marquardt, as in MINPACK)
// over runs of our own solver, in logarithms of a few constants, each with a prior width. The result is the most probable set
// of constants, and how far each of them may be off.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "fit/crash_test.h"
#include "fit/test_file.h"

namespace crumple {

// What the fit may change: a factor on the material, 1 as it is.
struct Constant {
  const char* name;
  const char* decides;  // of what
  double prior;         // how wide it is believed to be before any test: standard deviation of ln(factor)
  void (*apply)(float factor, Material&);
};
// The first one scales all stresses. The others are ordered by how well tests determine them.
std::span<const Constant> fit_constants();

// How exact a test is: standard deviations. 14 tests of one model by several laboratories differ by 5 % in crush (NHTSA tests
// 474-552); a tape measure on a dented bumper errs by 10 mm.
inline constexpr double crush_share = 0.05, crush_least = 0.010;  // and m
inline constexpr double travel_share = 0.05;
inline constexpr double restitution_error = 0.03;
inline constexpr double force_share = 0.12;  // of the pulse's mean

struct Comparison {
  size_t car, hit;        // places in the tests
  std::string what;       // "crush, mm"
  double measured, ours;  // in the unit of `what`
  double deviation;       // the same, of the measurement
};

struct FittedConstant {
  const Constant* constant;
  double factor = 1;
  double deviation = 0;    // of ln(factor)
  bool determined = true;  // false: the tests narrow it to no less than two thirds of its prior width
};

struct Fit {
  Parameters parameters;
  std::vector<FittedConstant> constants;
  std::vector<Comparison> comparisons;
  std::vector<std::vector<HitResult>> results;  // with these parameters, by car and hit
  double rms = 0;                               // of ours / measured - 1, over all published residual crushes, or all else
  int runs = 0;                                 // hits that were computed
};

// How many constants the tests can bear: all if they have a pulse, or three hits of one car; else one.
size_t constants_for(const std::vector<PublishedCar>&);

// Computes all hits on the car, scaled to each test's measures. rate: ticks a second.
std::vector<std::vector<HitResult>> play_tests(const std::shared_ptr<const Car>&, const std::vector<PublishedCar>&,
                                               const Parameters&, double rate = 60);
std::vector<Comparison> compare(const std::vector<PublishedCar>&, const std::vector<std::vector<HitResult>>&);
double rms_of(const std::vector<Comparison>&);

// start: the material from which it searches. progress: hits computed so far. The result does not depend on threads.
Fit fit(const std::shared_ptr<const Car>&, const std::vector<PublishedCar>&, size_t constants, const Parameters& start = {},
        const std::function<void(int)>& progress = {});

}  // namespace crumple

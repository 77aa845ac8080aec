// Reads published crash tests from a CSV file: what a car's mass and measures were, how fast it hit a rigid wall with its whole
// front, and how deep it was crushed.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "fit/scale_car.h"

namespace crumple {

inline constexpr size_t most_tests = 1'000;      // rows of a file: seconds of a fit for each
inline constexpr size_t most_samples = 200'000;  // rows of a pulse: 20 s at 10 kHz
inline constexpr double most_pulse_seconds = 2;  // after first contact, of which the fit uses the first tenths

// One hit. 0: not published.
struct PublishedHit {
  std::string test;           // its name
  double mass = 0;            // kg, as tested
  double speed = 0;           // m/s
  double damaged_width = 0;   // m
  double crush = 0;           // m, residual, mean of C1 to C6; of a car that is hit again it includes the hits before
  double travel = 0;          // m, dynamic
  double restitution = -1;    // -1: not published
  std::vector<double> force;  // barrier force over mass in successive 1/60 s from first contact, m/s^2
  bool derived = false;       // from the linear model's A and B
};

// The hits of one car, in their order.
struct PublishedCar {
  Measures measures;
  std::vector<PublishedHit> hits;
};

// Both throw std::runtime_error with one sentence: file, line, fact, remedy. `name` names the text in sentences; pulses are
// files beside it, in `folder`.
std::vector<PublishedCar> read_tests(const std::filesystem::path& file);
std::vector<PublishedCar> parse_tests(std::string_view text, const std::string& name, const std::filesystem::path& folder);

// Barrier force (kN) over mass (kg) in successive 1/60 s from time 0. Columns t_s and F_barrier_kN; others are ignored. Throws
// like the above.
std::vector<double> parse_pulse(std::string_view text, const std::string& name, double mass);

// The columns of a file of tests, one a line: name, meaning, allowed range.
std::string explain_columns();

}  // namespace crumple

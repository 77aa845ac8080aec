// `crumple fit`: finds the material of a car from published crash tests, and writes it as a preset.
#pragma once

#include <string>
#include <vector>

namespace crumple {

struct FitCommandOptions {
  std::vector<std::string> cars;  // levels of one car: the coarsest is fitted, the others are checked
  std::string tests;              // CSV (fit/test_file.h)
  std::string output;             // the preset, JSON in the form of schema/scene.fbs
  std::string picture;            // PNG; empty: none
  bool scale = false;             // fit only the scale of all stresses
  std::string about;              // of the preset; empty: what it was fitted to
};

// Returns the exit code. Throws std::runtime_error with one sentence: file, fact, remedy.
int fit_command(const FitCommandOptions&);

}  // namespace crumple

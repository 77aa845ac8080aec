// `crumple bake`: a surface (or tets) in, a baked car out, and what was done to it on the way.
#pragma once

#include <string>

#include "asset/bake.h"

namespace crumple {

struct BakeCommandOptions {
  BakeOptions bake;
  std::string output;  // the baked car
};

// Returns the exit code. Throws std::runtime_error with one sentence: file, fact, remedy.
int bake_command(const BakeCommandOptions&);

}  // namespace crumple

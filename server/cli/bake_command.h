// `crumple bake`: a surface (or tets) in, a baked car out, and what was done to it on the way.
#pragma once

#include <string>
#include <vector>

#include "bake/bake.h"

namespace crumple {

struct BakeCommandOptions {
  BakeOptions bake;
  std::vector<size_t> nodes;      // none: BakeOptions' own; more than one: levels of the car
  std::string mesher;             // lattice or ftetwild; empty: BakeOptions' own
  std::filesystem::path regions;  // schema/regions.fbs as JSON; empty: none
  std::string output;             // the baked car; of several NAME-NODES.car
};

// Returns the exit code. Throws std::runtime_error with one sentence: file, fact, remedy.
int bake_command(const BakeCommandOptions&);

}  // namespace crumple

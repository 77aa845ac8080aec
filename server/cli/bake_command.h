// `crumple bake`: reads a surface (or tets), writes a baked car, and reports what it did.
#pragma once

#include <string>
#include <vector>

#include "bake/bake.h"

namespace crumple {

struct BakeCommandOptions {
  BakeOptions bake;
  std::vector<size_t> nodes;      // none: the default of BakeOptions; more than one: levels of the car
  std::string mesher;             // lattice or ftetwild; empty: as the surface needs
  std::filesystem::path regions;  // schema/regions.fbs as JSON; empty: none
  std::filesystem::path parts;    // schema/parts.fbs as JSON; empty: the bake proposes them
  std::string write_parts;        // where to write the parts as JSON; empty: nowhere
  std::string output;             // the baked car; with several levels NAME-NODES.car
  std::string pictures;           // the folder for a picture of each baked car (cli/render.h); empty: none
};

// Returns the exit code. Throws std::runtime_error with one sentence: file, fact, remedy.
int bake_command(const BakeCommandOptions&);

}  // namespace crumple

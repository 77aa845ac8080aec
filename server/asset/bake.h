// From a surface mesh to a baked car: import, tets, constraints, skin, regions, spatial order, one file. Each step is a file of
// its own beside this one; bake() is their table of contents. The same surface and the same tets give the same bytes; fTetWild
// gives slightly other tets each time, so a car that must be the same again is kept, or its tets are.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "asset/car.h"
#include "asset/make_tets.h"
#include "asset/mesh.h"

namespace crumple {

struct BakeOptions {
  std::string input;              // a surface mesh file, or "built-in" or "built-in:VERTICES"
  size_t nodes = 2'500;           // wanted from fTetWild, met within 15 %
  std::filesystem::path tets;     // tets made elsewhere, in the surface's coordinates; empty: fTetWild
  std::filesystem::path regions;  // schema/regions.fbs as JSON; empty: the default safety cell
  double mass = 1'500;            // kg
  ImportOptions import;           // axes and unit of the input
  std::string name;               // empty: the input's file name
  std::string attribution;        // empty: "not stated" for a file
};

struct BakeResult {
  std::shared_ptr<const Car> car;
  std::vector<std::string> report;  // what was read, made, dropped and reached; one fact a line
};

// Throws std::runtime_error with one sentence: file, fact, remedy.
BakeResult bake(const BakeOptions&, const Progress&);

// The part of it that comes after the tets; what tests and benchmarks call.
BakeResult assemble_car(Surface, TetMesh, const BakeOptions&);

// Writes beside the file first and then renames, so that no half car is ever left. Throws like bake.
void write_car(const Car&, const std::filesystem::path& file);

}  // namespace crumple

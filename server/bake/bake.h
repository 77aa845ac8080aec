// From a surface mesh to a baked car: import, tets, constraints, skin, regions, spatial order, one file. Each step is a file of
// its own beside this one; bake() is their table of contents. The same surface and the same tets give the same bytes. The
// lattice gives the same tets each time; fTetWild slightly others, so a car that must be the same again is kept, or its tets
// are.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bake/make_tets.h"
#include "bake/paint_regions.h"
#include "car/car.h"
#include "car/mesh.h"

namespace crumple {

enum class Mesher { lattice, ftetwild };

struct BakeOptions {
  std::string input;                   // a surface mesh file, a baked car, or "built-in" or "built-in:VERTICES"
  size_t nodes = 2'500;                // wanted; the lattice meets them within 5 %, fTetWild within 15 %
  Mesher mesher = Mesher::ftetwild;    // makes the tets: see make_tets.h
  std::filesystem::path tets;          // tets made elsewhere, in the surface's coordinates; empty: the mesher makes them
  std::optional<RegionsText> regions;  // none: the default safety cell
  double mass = 0;                     // kg; 0: a baked car's own, else default_mass
  ImportOptions import;                // axes and unit of the input
  std::string name;                    // empty: a baked car's own, else the input's file name
  std::string attribution;             // empty: a baked car's own, else "not stated" for a file
};
inline constexpr double default_mass = 1'500;  // kg

struct BakeResult {
  std::shared_ptr<const Car> car;
  std::vector<std::string> report;  // what was read, made, dropped and reached; one fact a line
};

// Throws std::runtime_error with one sentence: file, fact, remedy.
BakeResult bake(const BakeOptions&, const Progress&);

// The part of it that comes after the tets; what tests and benchmarks call.
BakeResult assemble_car(Surface, TetMesh, const BakeOptions&);

bool is_baked_car(const std::filesystem::path& file);
// A baked car painted anew: its surface, tets and skin stay; regions, anchors and what depends on them become what a bake of
// its input with these options would have given. No tets are made, so it takes milliseconds.
BakeResult rebake(const Car&, BakeOptions);

// Leaves the whole car or nothing. Throws like bake.
void write_car(const Car&, const std::filesystem::path& file);

}  // namespace crumple

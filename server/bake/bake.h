// From a surface mesh to a baked car: import, tets, constraints, skin, regions, spatial order, one file. Each step has its own
// file here; bake() calls them in order. The same surface and the same tets give the same bytes. The lattice gives the same
// tets each time. fTetWild gives slightly different tets each time, so keep a car, or its tets, if it must stay the same.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "bake/make_tets.h"
#include "bake/paint_regions.h"
#include "bake/parts.h"
#include "car/car.h"
#include "car/mesh.h"

namespace crumple {

enum class Mesher { lattice, ftetwild };

struct BakeOptions {
  std::string input;                   // a surface mesh file, a baked car, or "built-in" or "built-in:VERTICES"
  size_t nodes = 2'500;                // wanted nodes, reached within 5 % by the lattice, within 15 % by fTetWild
  std::optional<Mesher> mesher;        // makes the tets (make_tets.h); none: fTetWild of a closed part, else the lattice
  std::filesystem::path tets;          // tets made elsewhere, in the surface's coordinates; empty: the mesher makes them
  std::optional<RegionsText> regions;  // none: the default safety cell
  std::optional<PartsText> parts;      // none: those that propose_parts() finds
  double mass = 0;                     // kg; 0: a baked car's own, else default_mass
  ImportOptions import;                // axes and unit of the input
  std::string name;                    // empty: a baked car's own, else the input's file name
  std::string attribution;             // empty: a baked car's own, else "not stated" for a file
};
inline constexpr double default_mass = 1'500;  // kg

struct BakeResult {
  std::shared_ptr<const Car> car;
  std::vector<std::string> report;  // what was read, made, dropped and reached; one fact per line
  std::vector<double> distance;     // m, from each vertex of the car to its tet; 0 inside, and of wheels
  std::string parts;                // the parts as JSON, in the form of schema/parts.fbs; empty if the input is a baked car
};

// Throws std::runtime_error with one sentence: file, fact, remedy.
BakeResult bake(const BakeOptions&, const Progress&);

// The steps after the tets. source_to_car: as in Car. part, look: what Surface.part and
// Surface.look name. Tests and benchmarks call it.
BakeResult assemble_car(Surface, TetMesh, const BakeOptions&, std::span<const double> source_to_car = {},
                        const std::vector<Part>& part = {}, const std::vector<Look>& look = {});

bool is_baked_car(const std::filesystem::path& file);
// Paints a baked car anew: surface, tets and skin stay; regions, anchors and everything that depends on them become what a bake
// with these options would give. It makes no tets, so it takes milliseconds.
BakeResult rebake(const Car&, BakeOptions);

// Writes the whole file or none. Throws like bake().
void write_car(const Car&, const std::filesystem::path& file);

}  // namespace crumple

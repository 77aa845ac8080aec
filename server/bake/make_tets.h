// Tets for a surface: a lattice is cut to its shape, or fTetWild makes them in a child process, or they are read from a file of
// another program.
#pragma once

#include <Eigen/Geometry>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "bake/import_surface.h"
#include "car/mesh.h"

namespace crumple {

// Receives a few words about the progress. Each call replaces the previous words, as on a line that is overwritten.
using Progress = std::function<void(const std::string&)>;

// Throws std::runtime_error with a sentence unless a car can have so many nodes.
void check_node_count(size_t nodes);

// Runs fTetWild until the node count is within 15 % of `nodes`. Surfaces may be open or overlap, because winding numbers decide
// what is inside. Throws std::runtime_error with a sentence.
TetMesh tetrahedralise(const ImportedSurface&, size_t nodes, const std::string& name, const Progress&,
                       std::vector<std::string>& report);

// Fills any triangles (fill_surface.h) and stuffs a lattice into them (stuff.h) until the node count is within 5 % of `nodes`.
// Gives one body whose tets are connected by faces, and drops no part. It takes seconds on one thread and gives the same bits
// each time. Throws std::runtime_error with a sentence.
TetMesh fill_with_tets(const ImportedSurface&, size_t nodes, const std::string& name, const Progress&,
                       std::vector<std::string>& report);

// Reads Gmsh .msh 2.2 and 4.1, Medit .mesh, TetGen .node/.ele. from_file transforms the coordinates to the car's frame.
TetMesh import_tets(const std::filesystem::path& file, const Eigen::Affine3d& from_file, std::vector<std::string>& report);

// Orients tets positively, drops tets without volume and nodes without tets, and reports both. Throws if nothing sound is left
// or an index or position is invalid; `name` names the source in messages.
TetMesh clean_tets(const std::vector<double>& nodes, const std::vector<int32_t>& tets, const std::string& name,
                   std::vector<std::string>& report);

}  // namespace crumple

// Tets for a surface: cut out of a lattice, made by fTetWild in a child process, or read from a file that another program made.
#pragma once

#include <Eigen/Geometry>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "bake/import_surface.h"
#include "car/mesh.h"

namespace crumple {

// Told what is going on, in a few words, each replacing the one before; for a line that is overwritten in place.
using Progress = std::function<void(const std::string&)>;

// Throws std::runtime_error with a sentence unless a car can have so many nodes.
void check_node_count(size_t nodes);

// Runs fTetWild until the node count is within 15 % of `nodes`. Open or overlapping surfaces are welcome: what lies inside is
// decided by winding number. Throws std::runtime_error with a sentence.
TetMesh tetrahedralise(const ImportedSurface&, size_t nodes, const std::string& name, const Progress&,
                       std::vector<std::string>& report);

// Fills any triangles (fill_surface.h) and stuffs a lattice into them (stuff.h) until the node count is within 5 % of `nodes`:
// one body whose tets hang together by faces, with nothing dropped; seconds, one thread, the same bits each time. Throws
// std::runtime_error with a sentence.
TetMesh fill_with_tets(const ImportedSurface&, size_t nodes, const std::string& name, const Progress&,
                       std::vector<std::string>& report);

// Gmsh .msh 2.2 and 4.1, Medit .mesh, TetGen .node/.ele; from_file brings its coordinates into the car's frame.
TetMesh import_tets(const std::filesystem::path& file, const Eigen::Affine3d& from_file, std::vector<std::string>& report);

// Turns tets positive, drops those without volume and nodes that nothing uses, and reports both. Throws when nothing sound is
// left or an index or position is wild; `name` stands for their source.
TetMesh clean_tets(const std::vector<double>& nodes, const std::vector<int32_t>& tets, const std::string& name,
                   std::vector<std::string>& report);

}  // namespace crumple

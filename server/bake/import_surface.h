// Imports a surface mesh file in any format that Assimp reads (OBJ, glTF, GLB, STL, PLY, ...). The Surface is in the car's
// frame: X forward, Y left, Z up, metres, lowest point at z = 0, centred in x and y. The import flattens the hierarchy,
// triangulates polygons, and joins vertices at the same position. It repairs nothing silently: the report says what was done.
#pragma once

#include <Eigen/Geometry>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "car/mesh.h"
#include "protocol/parts.h"

namespace crumple {

struct ImportOptions {
  // Which of the file's axes point forward and up: x, y, z, -x, -y, -z. Empty: as the format defines. glTF has z forward and y
  // up; for every other format x is forward and z up.
  std::string forward;
  std::string up;
  double scale = 1;  // metres per unit of the file
};

// A mesh of a node of the file. Its triangles are those from `first` up to the first of the next part.
struct NamedPart {
  std::string name;  // at most 128 bytes of printable ASCII
  size_t first = 0;
  std::vector<std::string> names = {};  // of its material, mesh and node, and of the nodes above; at most 512 bytes in all
  bool transparent = false;             // its material lets light through
  bool blended = false;                 // its material may, if its texture does
  std::optional<Look> look{};           // of its material; none: it has none, or one with a texture of colours
};

struct ImportedSurface {
  Surface surface;
  Eigen::Affine3d from_file;     // from the file's coordinates to the car's frame
  size_t parts = 0;              // connected pieces
  size_t open_edges = 0;         // edges of only one triangle
  std::vector<uint32_t> kept;    // for each triangle, its index before some were dropped; ascending
  std::vector<NamedPart> named;  // at most 4096, the last of which holds all others; none: the file has no names
  std::vector<std::string> report;
};

// Throws std::runtime_error with one sentence: file, fact, remedy.
ImportedSurface import_surface(const std::filesystem::path& file, const ImportOptions&);

// Only those triangles for which `keep` is 1, with their vertices. It has no names and no report.
ImportedSurface keep_triangles(const ImportedSurface&, const std::vector<uint8_t>& keep);

// The same as import_surface for a surface in memory: joins vertices, checks and places them; `name` stands for the file in
// messages. Triangles may be degenerate or wild. Positions are checked here.
ImportedSurface place_surface(const std::vector<Eigen::Vector3d>& positions, const std::vector<uint32_t>& colors,
                              const std::vector<Triangle>& triangles, const ImportOptions&, const std::string& name);

// The vertices of a file in its coordinates, with the transformations of its nodes applied. Throws likewise.
std::vector<Eigen::Vector3d> read_vertices(const std::filesystem::path& file);

}  // namespace crumple

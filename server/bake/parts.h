// The parts of a car: glass, lights, wheels, interior. The bake proposes them by the names and materials of the file and by
// shape, as a text in the form of schema/parts.fbs, or takes such a text. The text then divides the surface.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "bake/import_surface.h"
#include "protocol/parts.h"

namespace crumple {

// JSON as in schema/parts.fbs. source: names it in messages.
struct PartsText {
  std::string source, text;
};
// Throws std::runtime_error with a sentence.
PartsText read_parts(const std::filesystem::path& file);

// Appends to `report` what it chose and why, a line for each kind.
PartsText propose_parts(const ImportedSurface&, std::vector<std::string>& report);

struct Division {
  std::vector<Part> part;            // part 0 is the body; none: all is body
  std::vector<uint8_t> of_triangle;  // none if there are no parts
};
// name: names the surface in messages. Throws std::runtime_error with a sentence: text, fact, remedy.
Division divide_surface(const ImportedSurface&, const PartsText&, const std::string& name);

// Triangles that are connected and belong to one named part of the file.
struct Piece {
  size_t named = 0;                // index into ImportedSurface::named
  std::vector<uint32_t> triangle;  // ascending
};
std::vector<Piece> find_pieces(const ImportedSurface&);

// Whether tets are made for this kind.
bool is_solid(schema::PartKind);

// Makes a vertex for each part that meets at a vertex, and gives each vertex its part.
void split_at_parts(Surface&, const std::vector<uint8_t>& part_of_triangle);

}  // namespace crumple

// Binds the vertices of any mesh of a car, such as a game's own with its seams, hard edges and levels of detail, to the surface
// of the baked car, and moves them with it. Positions are in the car's frame, m. The same positions always get the same
// binding, so seams stay closed.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace crumple::viewer {

using Point = std::array<float, 3>;
using Weights = std::array<float, 3>;
using Corners = std::array<uint32_t, 3>;

using Rows = std::array<Point, 3>;  // of a 3 x 3 matrix
Point operator*(const Rows&, const Point&);
Rows transposed(const Rows&);
Point unit(const Point&);  // of length 1; (0, 0, 1) if the length is 0

// A mapped vertex that is nearer to a vertex of the surface than this lies on it.
inline constexpr float same_place = 1e-4f;  // m: engines convert axes and units in single precision
// A triangle of the surface turns a normal if the angle between both is less than 60 degrees. So hard edges stay hard.
inline constexpr float same_side = 0.5f;  // cosine
// So many triangles around a vertex of the surface turn normals, those with the lowest indices. Cars have 6 on average, some 40
// at most; a hostile one may have all around one vertex.
inline constexpr uint32_t around_limit = 256;

struct Mapping {
  // For each mapped vertex the triangle of the surface that it moves with: three vertices and their weights, which sum to 1.
  std::vector<Corners> corner;
  std::vector<Weights> weight;
  // The triangles that turn its normal: turning[first[i] .. first[i + 1]), each as 2 * triangle + (1 if it faces the other
  // way).
  std::vector<uint32_t> first, turning;
  std::vector<Point> facing;    // their mean normal at rest, of length 1
  std::vector<float> distance;  // m, from the mapped vertex to the surface
  uint32_t on_vertices = 0;     // number of mapped vertices that lie on a vertex of the surface
};

// vertex, triangle: the surface at rest; each triangle names existing vertices, and there is at least one. position: finite.
// normal: of the mapped vertices, of length 1; empty: all triangles around a vertex turn its normal.
Mapping map_vertices(std::span<const Point> vertex, std::span<const Corners> triangle, std::span<const Point> position,
                     std::span<const Point> normal);

// The displacement of a mapped vertex, from the displacements of the surface's vertices.
Point displacement_of(const Mapping&, size_t i, std::span<const Point> displacement);

// A rotation: turns `facing` at rest to the direction in which the same triangles face now.
struct Turn {
  Point axis;  // of the length of the angle's sine
  float cosine;
  Point operator()(const Point&) const;
};
// cross: for each triangle, the cross product of two of its edges now.
Turn turn_of(const Mapping&, size_t i, std::span<const Point> cross);
// Writes the cross products of all triangles of a surface.
void find_crosses(std::span<const Point> vertex, std::span<const Corners> triangle, std::vector<Point>& out);

}  // namespace crumple::viewer

// The two meshes from which a car is baked, as the steps of a bake exchange them: plain arrays in the car's frame (X forward,
// Y left, Z up, metres), in single precision from the start, so that every check sees the numbers of the file.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "sim/model.h"

namespace crumple {

using Triangle = std::array<uint32_t, 3>;

// The surface as the game draws it.
struct Surface {
  std::vector<Vec3> vertex;
  std::vector<Triangle> triangle;
  std::vector<uint32_t> color;  // 0xrrggbb per vertex; empty: not painted
  std::vector<uint8_t> part{};  // per vertex; empty: all is body
  std::vector<uint8_t> look{};  // per triangle, or no_look; empty: none
};

// Positively oriented: (b-a) x (c-a) . (d-a) > 0.
struct TetMesh {
  std::vector<Vec3> node;
  std::vector<Tet> tet;
};

// The faces of only one tet, turned outward.
std::vector<Triangle> boundary(const TetMesh&);

// For each of `count` points the lowest index connected with it. connections: groups of `size` connected points each.
std::vector<uint32_t> connected(size_t count, std::span<const uint32_t> connections, size_t size);

}  // namespace crumple

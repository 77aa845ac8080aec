// The two meshes that a car is baked from. What goes between the steps of a bake: plain arrays, in the car's frame
// (X forward, Y left, Z up, metres), in single precision from the start, so that every check sees what the file will hold.
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
  std::vector<uint32_t> color;  // 0xrrggbb a vertex; empty: not painted
};

// Positively oriented: (b-a) x (c-a) . (d-a) > 0.
struct TetMesh {
  std::vector<Vec3> node;
  std::vector<Tet> tet;
};

// The faces that only one tet has, turned outward.
std::vector<Triangle> boundary(const TetMesh&);

// For each of `count` points the lowest index it hangs together with; connections: groups of `size` points each.
std::vector<uint32_t> connected(size_t count, std::span<const uint32_t> connections, size_t size);

}  // namespace crumple

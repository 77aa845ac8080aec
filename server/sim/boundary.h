// The outside of a car's tets: where it touches other cars.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace crumple {

struct Boundary {
  std::vector<std::array<uint32_t, 3>> triangle;  // faces of only one tet, turned outward, in the order of the tets
  std::vector<uint32_t> node;                     // nodes of the triangles, ascending
};

}  // namespace crumple

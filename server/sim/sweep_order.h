// The order in which `nodal` visits the nodes of a car, made once from its tets. Nodes of one colour share no tet, so they may
// move at the same time. A sub-step takes from this order the nodes that it solves (blocks.h).
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace crumple {

// Vector kernels compute so many nodes or tets at once.
inline constexpr int lanes = 16;

// Length of an array of n nodes: one more for the unused lanes, rounded up to whole rounds of 16 floats.
constexpr size_t padded_nodes(size_t n) { return (n + 4) / 4 * 4; }

// A tet as one of its corners sees it. The other corners are ordered so that the volume they span with this one is positive at
// rest.
struct Corner {
  uint32_t other[3];
  uint32_t tet;
};

// Unused lanes point at node n.
struct TetGroup {
  uint32_t node[4][lanes];
};

struct SweepOrder {
  std::vector<uint32_t> node;    // n, by colour; of one colour free nodes first, nodes with most tets first
  std::vector<uint32_t> colour;  // c + 1: nodes of colour i are node[colour[i]] .. node[colour[i + 1] - 1]
  std::vector<Corner> corner;    // 4 t, as in Model::corner: of node i from node_first[i] to node_first[i + 1]
  std::vector<uint32_t> slot;    // 4 t: corner k of tet i is corner[slot[4 i + k]]
  std::vector<TetGroup> group;   // ceil(t / 16), tets in the model's order
  // Free neighbours of node i: near[near_first[i]] .. near[near_first[i + 1] - 1]; groups with one of its tets: over, likewise.
  std::vector<uint32_t> near_first, near, over_first, over;
};

}  // namespace crumple

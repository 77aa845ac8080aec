// The order in which `nodal` visits the nodes of a car, made once from its tets. Nodes of one colour share no tet, so they may
// move at the same time. A block is 16 nodes of one colour; each row of a block holds one tet of each node. Tets are in groups
// of 16 too. Unused lanes point at node n and tet t, one past the last; arrays indexed by them are one longer.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace crumple {

inline constexpr int lanes = 16;

// Length of an array of n nodes: one more for the unused lanes, rounded up to whole rounds of 16 floats.
constexpr size_t padded_nodes(size_t n) { return (n + 4) / 4 * 4; }

// One tet for each lane's node. The tet's other corners are ordered so that the volume they span with the node is positive at
// rest.
struct Row {
  uint32_t other[3][lanes];
  uint32_t tet[lanes];
};

struct TetGroup {
  uint32_t node[4][lanes];
};

struct Blocks {
  std::vector<uint32_t> node;     // 16 a block
  std::vector<uint16_t> unused;   // b: lanes without a node
  std::vector<uint32_t> row;      // b + 1: rows of block i are row[i] .. row[i + 1)
  std::vector<uint32_t> colour;   // c + 1: blocks of colour i are colour[i] .. colour[i + 1)
  std::vector<uint8_t> anchored;  // b: all its nodes are anchored, or none is
  std::vector<Row> rows;
  std::vector<uint32_t> slot;   // 4 t: 16 * row + lane where corner k of tet i is node: slot[4 i + k]
  std::vector<uint32_t> place;  // n: 16 * block + lane of node i
  std::vector<TetGroup> group;  // ceil(t / 16), tets in the model's order
  // What block i wakes when it moves. near[near_first[i] .. near_first[i + 1]): the free blocks that hold a neighbour of its
  // nodes. over[over_first[i] ..): the groups that hold a tet of its nodes.
  std::vector<uint32_t> near_first, near, over_first, over;
};

}  // namespace crumple

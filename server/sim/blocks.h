// The order in which `nodal` visits a car, made once from its tets. Nodes of one colour share no tet, so that they may move at
// the same time; a block is 16 nodes of one colour, and a row of it holds one tet of each. Tets stand in groups of 16 as well.
// Lanes that are left over point at one node and one tet that the car does not have: index n and t of arrays one longer.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace crumple {

inline constexpr int lanes = 16;

// How long an array of n nodes is: one more for the lanes that are left over, and whole rounds of 16 floats.
constexpr size_t padded_nodes(size_t n) { return (n + 4) / 4 * 4; }

// Of each lane's node one tet: its other corners, so ordered that the volume they span with the node is positive at rest.
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
  // Who must know when block i moves: near[near_first[i] .. near_first[i + 1]), blocks not anchored with a neighbour of its
  // nodes; over[over_first[i] ..), groups with a tet of its nodes.
  std::vector<uint32_t> near_first, near, over_first, over;
};

}  // namespace crumple

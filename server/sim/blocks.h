// The nodes that a sub-step solves, packed for the kernels. A block is 16 nodes of one colour; each row of a block holds one
// tet of each node. Unused lanes point at node n and tet t, one past the last; arrays indexed by them are one longer.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sim/sweep_order.h"

namespace crumple {

struct Model;

// One tet for each lane's node; see Corner.
struct Row {
  uint32_t other[3][lanes];
  uint32_t tet[lanes];
};

// Per lane of a row: dot products of the node's gradient with the gradients of the three other corners, 1/m^2.
struct Weights {
  float other[3][lanes];
};

// The same of one corner. The last number is not used: 16 bytes are moved at once.
struct CornerWeights {
  float other[4] = {};
};

struct Blocks {
  std::vector<uint32_t> node;     // 16 a block
  std::vector<uint16_t> unused;   // b: lanes without a node
  std::vector<uint32_t> row;      // b + 1: rows of block i are row[i] .. row[i + 1)
  std::vector<uint32_t> colour;   // c + 1: blocks of colour i are colour[i] .. colour[i + 1)
  std::vector<uint8_t> anchored;  // b: all its nodes are anchored, or none is
  std::vector<Row> rows;          // at least row.back(); the rest is memory for later
  std::vector<Weights> weights;   // beside rows
  std::vector<uint32_t> place;    // n: 16 * block + lane of node i, if a block holds it
};

// Fills the blocks with the nodes i that have awake[i], in the car's order. weights: of each corner, as in SweepOrder::corner.
void pack(const Model&, std::span<const uint8_t> awake, std::span<const CornerWeights> weights, Blocks&);

}  // namespace crumple

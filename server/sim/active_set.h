// The nodes of a car that a sub-step solves. When it begins, a node is awake if something touches it, or if it lies within two
// tets of a touched node or of one that moved by more than a share of the largest way in the last sub-step. A node that begins
// to move so far in this one wakes its sleeping neighbours, and these wake theirs. All others keep still. The threshold is
// relative because an absolute threshold fails in slow pushes: there each sub-step moves less than any threshold that saves
// time in a crash.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "sim/blocks.h"
#include "sim/model.h"
#include "sim/vector.h"

namespace crumple {

// A node wakes its neighbours if it moves by more than this share of the largest way of any node in the sub-step.
inline constexpr float wake_share = 0.04f;

// Where something happens to a car in a sub-step.
struct ActiveSeeds {
  std::vector<uint32_t> touched;  // nodes that an obstacle or another car may hold
  std::vector<uint32_t> placed;   // anchored nodes that were let go, and so put back to rest
};

struct ActiveSet {
  std::vector<uint8_t> awake;     // n: 0 asleep, 1 awake, 2 awake and has woken its neighbours
  std::vector<uint32_t> node;     // those awake, ascending
  std::vector<uint8_t> stirred;   // per group of tets: a corner of one of its tets is awake
  std::vector<uint16_t> still;    // per block: lanes that sweeps must not move
  std::vector<uint16_t> touched;  // per block: lanes that an obstacle or another car may hold
  Blocks blocks;                  // of the awake nodes
  uint64_t corners = 0;           // of tets at the awake nodes
  bool whole = false;             // all free nodes are awake
};

// Wakes the touched nodes, those that moved in the last sub-step, and what lies around these and around the placed nodes. step:
// way of each node in the last sub-step, m. quiet, m: a node that moves by no more than this is at rest, and wakes nothing.
void wake(const Model&, const ActiveSeeds&, std::span<const Vec3> step, float quiet, ActiveSet&);

// Wakes all free nodes, and the touched ones.
void wake_all(const Model&, const ActiveSeeds&, ActiveSet&);

// Wakes the neighbours of nodes that moved. before, node: positions at the start of the sub-step and now. Returns whether there
// are new ones; then the set must be packed again.
bool widen(const Model&, std::span<const Float4> before, std::span<const Float4> node, float quiet, ActiveSet&);

// Lists the awake nodes, and stirs the groups of tets around them and around the placed nodes.
void stir(const Model&, const ActiveSeeds&, ActiveSet&);

// Packs the awake nodes into blocks.
void pack(const Model&, const ActiveSeeds&, std::span<const CornerWeights>, ActiveSet&);

}  // namespace crumple

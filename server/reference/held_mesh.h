// A mesh of tets as the solver wants it, without a bake, some of its nodes held where the caller says: how scenes that other
// programs play with prescribed nodes (bench/peers) are played by the product's own deform(). A held node is an anchored one
// whose place of rest moves.
#pragma once

#include <memory>
#include <vector>

#include "bake/build_constraints.h"
#include "sim/deform.h"

namespace crumple {

class HeldMesh {
 public:
  // held: per node, 0 or 1. mass: of all nodes together, kg.
  HeldMesh(TetMesh, std::vector<uint8_t> held, double mass);
  HeldMesh(const HeldMesh&) = delete;

  const Model& model() const { return model_; }
  // n: where each held node stands from the next call of deform() on, m; of the others their rest.
  std::vector<Vec3> place;

 private:
  TetMesh tets_;
  Constraints constraints_;
  Masses masses_;
  std::vector<uint8_t> held_, node_region_, tet_region_;
  Blocks blocks_;
  Model model_;
};

// A frame that stands, whatever pushes.
Mass fixed_mass();

// One sub-step of substep_seconds(), the held nodes at their places at its end. A body whose held nodes moved is not at rest.
void hold(const HeldMesh&, const Parameters&, std::span<const Obstacle>, Scratch&, DeformableState&);

// Ticks until nothing moves, at most two seconds. All nodes are awake at first: what held them may have been taken away.
void come_to_rest(const HeldMesh&, const Parameters&, Scratch&, DeformableState&);

}  // namespace crumple

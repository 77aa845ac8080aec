// A mesh of tets in the solver's form, without a bake. The caller prescribes the positions of some nodes. So our own deform()
// can play scenes that other programs play with prescribed nodes (bench/peers). A held node is an anchored node whose rest
// position moves.
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
  // n: position of each held node from the next deform() on, m; for other nodes the rest position.
  std::vector<Vec3> place;

 private:
  TetMesh tets_;
  Constraints constraints_;
  Masses masses_;
  std::vector<uint8_t> held_, node_region_, tet_region_;
  SweepOrder order_;
  Boundary boundary_;
  Model model_;
};

// The mass of a frame that stands still, whatever pushes it.
Mass fixed_mass();

// One sub-step of substep_seconds(); at its end the held nodes are at their places. Marks the body as not settled, because its
// held nodes moved.
void hold(const HeldMesh&, const Parameters&, std::span<const Obstacle>, Scratch&, DeformableState&);

// Makes ticks until nothing moves, for at most two seconds. First wakes all nodes, because what held them may be gone.
void come_to_rest(const HeldMesh&, const Parameters&, Scratch&, DeformableState&);

}  // namespace crumple

// Methods that stand on the chart and in the stability matrix beside `nodal` and `classic`; no server ships them. All solve the
// constraints of `classic` (unique edges, tet volumes) from one projection and differ only in how they gather corrections:
//   naive Jacobi      all corrections from the same positions, added up
//   averaged Jacobi   ... divided by the number of constraints on the node (Ille 2020, algorithm 2)
//   relaxed Jacobi    ... times one factor for all
//   coloured          Gauss-Seidel, constraint by constraint, in groups that share no node and so could be solved side by side
//                     (Ille 2020, 6.4.2; Fratarcangeli, Tibaldo, Pellacini 2016, "Vivace")
//   xpbd              Gauss-Seidel with compliances and multipliers (Macklin, Mueller, Chentanez 2016) and drag in place of
//   mass
// Every solve is a function of its arguments, gives the same bits every time, and keeps anchored nodes where they are.
#pragma once

#include <span>
#include <vector>

#include "sim/body.h"
#include "sim/contacts.h"

namespace crumple {

// Constraint k of a car is edge k, then tet k - edges. C = value is zero when it is met.
struct Constraint {
  int count;  // of nodes: 2 or 4
  uint32_t node[4];
  float value;       // length - rest, m; or volume - rest, m^3
  Vec3 gradient[4];  // of C by the node's position; zero for an edge of no length
};
Constraint measure(const Model&, const DeformableState&, uint32_t constraint);

// Built once a car.
struct Structure {
  std::vector<uint32_t> constraint;   // all of them by colour: those of one colour share no node; edges' colours first
  std::vector<uint32_t> first;        // per colour its first in `constraint`, and one past the last
  std::vector<uint32_t> edges, tets;  // per node: how many of them it has
  std::vector<float> edge_volume;     // of the tets around each edge, m^3
};
Structure build_structure(const Model&);

// One tick each, as solve_classic: contacts of the whole tick are projected once, rest values move once.
void solve_naive_jacobi(const Model&, const Structure&, const Parameters&, std::span<const Contact>, DeformableState&);
void solve_averaged_jacobi(const Model&, const Structure&, const Parameters&, std::span<const Contact>, DeformableState&);
void solve_relaxed_jacobi(const Model&, const Structure&, const Parameters&, std::span<const Contact>, DeformableState&);
void solve_coloured(const Model&, const Structure&, const Parameters&, std::span<const Contact>, DeformableState&);

// One sub-step of h seconds from the positions in the body: minimises
//   sum_i c_i / 2h |x_i - x_i before|^2 + sum_e k_e / 2 (length - rest)^2 + sum_t k_t / 2 (volume - rest)^2
// with c_i the drag of `nodal` (drag times the node's share of the volume), k_e = 0.9 E (volume around e) / rest length^2
// and k_t = E / rest volume, which together give a body without grain Young's modulus E. Contacts are enforced in every
// iteration. Rest values do not move: creep() does that, once a tick.
void solve_xpbd(const Model&, const Structure&, const Parameters&, std::span<const Contact>, float h, DeformableState&);

// The plasticity of `classic` (thesis 3.8): every rest value moves to rest p + (1 - p) now.
void creep(const Model&, const Parameters&, DeformableState&);

// What solve_xpbd takes for c_i, N s/m, and k, N/m or N/m^5.
float drag_of(const Model&, const Parameters&, uint32_t node, float volume);
float stiffness_of(const Model&, const Structure&, const Parameters&, uint32_t constraint);

enum class Baseline : uint8_t { naive_jacobi, averaged_jacobi, relaxed_jacobi, coloured, xpbd };

// One car, one tick, as deform(): xpbd in sub-steps of substep_seconds, each with its contacts; the others as deform() steps
// `classic`. The motion is law.
void deform_baseline(Baseline, const Model&, const Structure&, const Parameters&, const Mass&, std::span<const Obstacle>,
                     double seconds, DeformableState&, Motion&);

}  // namespace crumple

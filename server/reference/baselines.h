// Other methods, shown beside `nodal` and `classic` on the chart and in the stability matrix. No server ships them. All solve
// the constraints of `classic` (unique edges, tet volumes) with one projection and differ only in how they combine corrections:
//   naive Jacobi      all corrections from the same positions, added up
//   averaged Jacobi   ... divided by the number of constraints on the node (Ille 2020, algorithm 2)
//   relaxed Jacobi    ... times one factor for all
//   coloured          Gauss-Seidel, constraint by constraint, in groups that share no node and so could be solved side by side
//                     (Ille 2020, 6.4.2; Fratarcangeli, Tibaldo, Pellacini 2016, "Vivace")
//   xpbd              Gauss-Seidel with compliances and multipliers (Macklin, Mueller, Chentanez 2016), drag in place of mass
// Every solve is a function of its arguments, gives the same bits every time, and keeps anchored nodes in place.
#pragma once

#include <span>
#include <vector>

#include "sim/body.h"
#include "sim/contacts.h"

namespace crumple {

// Constraint k of a car is edge k, then tet k - edges. It is met when C = value is zero.
struct Constraint {
  int count;  // nodes: 2 or 4
  uint32_t node[4];
  float value;       // length - rest, m; or volume - rest, m^3
  Vec3 gradient[4];  // of C with respect to the node's position; zero for an edge of no length
};
Constraint measure(const Model&, const DeformableState&, uint32_t constraint);

// Built once per car.
struct Structure {
  std::vector<uint32_t> constraint;   // all, by colour: constraints of one colour share no node; colours of edges come first
  std::vector<uint32_t> first;        // per colour its first entry in `constraint`; at the end one past the last
  std::vector<uint32_t> edges, tets;  // per node: number of its edges and tets
  std::vector<float> edge_volume;     // volume of the tets around each edge, m^3
};
Structure build_structure(const Model&);

// One tick each, like solve_classic: contacts of the whole tick are projected once, rest values change once.
void solve_naive_jacobi(const Model&, const Structure&, const Parameters&, std::span<const Contact>, DeformableState&);
void solve_averaged_jacobi(const Model&, const Structure&, const Parameters&, std::span<const Contact>, DeformableState&);
void solve_relaxed_jacobi(const Model&, const Structure&, const Parameters&, std::span<const Contact>, DeformableState&);
void solve_coloured(const Model&, const Structure&, const Parameters&, std::span<const Contact>, DeformableState&);

// One sub-step of h seconds from the body's positions. Minimises
//   sum_i c_i / 2h |x_i - x_i before|^2 + sum_e k_e / 2 (length - rest)^2 + sum_t k_t / 2 (volume - rest)^2
// with c_i the drag of `nodal` (drag times the node's share of the volume), k_e = 0.9 E (volume around e) / rest length^2 and
// k_t = E / rest volume, which together give an isotropic body Young's modulus E. Contacts are enforced in every iteration.
// Rest values do not change here; call creep() once a tick.
void solve_xpbd(const Model&, const Structure&, const Parameters&, std::span<const Contact>, float h, DeformableState&);

// The plasticity of `classic` (thesis 3.8): every rest value becomes rest p + (1 - p) now.
void creep(const Model&, const Parameters&, DeformableState&);

// The values that solve_xpbd uses for c_i, N s/m, and k, N/m or N/m^5.
float drag_of(const Model&, const Parameters&, uint32_t node, float volume);
float stiffness_of(const Model&, const Structure&, const Parameters&, uint32_t constraint);

enum class Baseline : uint8_t { naive_jacobi, averaged_jacobi, relaxed_jacobi, coloured, xpbd };

// One car, one tick, like deform(). xpbd makes sub-steps of substep_seconds with their own contacts; the others step like
// `classic` in deform(). Contacts do not change the motion.
void deform_baseline(Baseline, const Model&, const Structure&, const Parameters&, const Mass&, std::span<const Obstacle>,
                     double seconds, DeformableState&, Motion&);

}  // namespace crumple

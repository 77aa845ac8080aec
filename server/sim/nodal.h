// The solver `nodal`: one sub-step of quasi-static equilibrium, node by node.
//   minimise over x  sum_i c_i/(2h) |x_i - before_i|^2 + sum_t V_t W(F_t)   subject to the contacts' planes
// with W the stable neo-Hookean energy, its moduli lowered where the tet flows (flow.h). J is linear in one corner of a tet, so
// the energy is exactly quadratic in one node with a positive definite 3x3 block: each visit minimises it exactly, over-relaxed
// by 0 < omega < 2 it still never rises, inverted tets included.
#pragma once

#include "sim/scratch.h"

namespace crumple {

inline constexpr float relaxation = 1.7f;
// An anchored node that an obstacle reaches yields like a spring this many times as stiff as its tets: contacts always win.
inline constexpr float anchor_ratio = 30.0f;
// All those springs together are no stiffer than this share of (car's mass) / h^2: the rigid motion is stepped explicitly.
inline constexpr float anchor_share = 0.25f;

// m/s: a node that is slower is at rest, and its block is not solved; nor is a body all of whose nodes are.
inline constexpr float settle_speed = 2e-3f;
// m: a tet less high than this does not flow. Positions in single precision, a metre or two from the origin, are known to
// 0.1 um; its strain would be noise of a hundredth of the yield strain and more.
inline constexpr float thinnest = 1e-3f;
// Of all tets: when more have lost their shape, none flows.
inline constexpr double lost_share = 0.002;

// Beside Parameters::tolerance: of the nodes' way in the sub-step the last two sweeps make up no more than this share. Else a
// push so slow that its whole way is within the tolerance would not be solved at all, and its force be several times too high.
inline constexpr double small_share = 0.05;
// Sweeps that together are one step of the mixing, with moduli renewed before it.
inline constexpr int sweeps_a_step = 2;

// Of Scratch::node and a body's history: n + 1, padded to whole rounds of 16 floats.
inline size_t quads_of_nodes(size_t n) { return (n + 4) / 4 * 4; }

// Before the first sub-step of a tick: the car's state as the kernels want it.
void prepare_nodal(const Model&, const Parameters&, const Body&, Scratch&);

struct Effort {
  uint32_t sweeps = 0;
  uint64_t work = 0;   // tets visited by sweeps
  float residual = 0;  // rms over awake nodes of what the last two sweeps moved, m
};

// Solves one sub-step of h seconds. In: body as the last sub-step left it, scratch.contacts, contact_first.
// Out: body.node, and what held each contact in scratch.held. share: h over the last sub-step's. mass: the car's, kg.
Effort solve_nodal(const Model&, const Parameters&, double mass, float h, float share, Scratch&, Body&);

// After it: plastic flow of the tets that are beyond yield, and the drag that the nodes took: J.
double flow_nodal(const Model&, Scratch&, Body&);

// Elastic energy of the tets and of the springs that hold the cell, J.
double stored_nodal(const Model&, Scratch&, const Body&);

}  // namespace crumple

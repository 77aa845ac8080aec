// The solver `nodal`: one sub-step of quasi-static equilibrium, node by node.
//   minimise over x  sum_i c_i/(2h) |x_i - before_i|^2 + sum_t V_t W(F_t)   subject to the contacts' planes
// with W the stable neo-Hookean energy, its moduli lowered where the tet flows (flow.h). J is linear in one corner of a tet, so
// the energy is exactly quadratic in one node with a positive definite 3x3 block: each visit minimises it exactly, over-relaxed
// by 0 < omega < 2 it still never rises, inverted tets included.
#pragma once

#include <cstdint>
#include <vector>

#include "sim/anderson.h"
#include "sim/contacts.h"
#include "sim/kernels.h"
#include "sim/step.h"
#include "sim/team.h"

namespace crumple {

inline constexpr float relaxation = 1.7f;
// An anchored node that an obstacle reaches yields like a spring this many times as stiff as its tets: contacts always win.
inline constexpr float anchor_ratio = 30.0f;
// All those springs together are no stiffer than this share of (car's mass) / h^2: the rigid motion is stepped explicitly.
inline constexpr float anchor_share = 0.25f;

// m: a tet less high than this does not flow. Positions in single precision, a metre or two from the origin, are known to
// 0.1 um; its strain would be noise of a hundredth of the yield strain and more.
inline constexpr float thinnest = 1e-3f;
// Of all tets: when more have lost their shape, none flows.
inline constexpr double lost_share = 0.002;

// Beside Parameters::tolerance: of the nodes' way in the sub-step the last two sweeps make up no more than this share. Else a
// push so slow that its whole way is within the tolerance would not be solved at all, and its force be several times too high.
inline constexpr double small_share = 0.05;
// Sweeps that together are one step: moduli are renewed before it, and after it Anderson's acceleration sets in (anderson.h).
inline constexpr int sweeps_a_step = 2;

// What one sweep over the whole car visits, tets: whole groups of them.
uint64_t sweep_work(const Model&);

// The solver's memory of one tick, as its kernels want it (kernels.h), with what speeds it up.
struct NodalSolver {
  std::vector<Float4> node, before, rest, direction;  // padded_nodes(n)
  std::vector<Float4> step_start;                     // nodes before the step
  std::vector<Float4> stiffness;                      // t, padded to whole groups, + 1
  std::vector<TetLanes> tets;                         // per group of tets
  std::vector<Weights> weights;                       // per row
  std::vector<uint8_t> region;                        // t, padded to whole groups
  std::vector<Law> law;                               // per region
  std::vector<uint16_t> flowing;                      // per group of tets: which are beyond yield
  std::vector<uint16_t> still;                        // per block
  std::vector<uint16_t> touched;                      // per block
  std::vector<uint8_t> awake;                         // per block: 0 at rest, 1 solved, 2 solved and has moved
  std::vector<uint8_t> stirred;                       // per group: one of its blocks is awake
  std::vector<ContactForce> contact_forces;           // per contact
  double volume = 0;                                  // of all tets at rest, m^3
  Anderson anderson;
  Team team;
};

// Before the first sub-step of a tick: the car's state as the kernels want it.
void prepare_nodal(const Model&, const Parameters&, const DeformableState&, NodalSolver&);

struct SolveStats {
  uint32_t sweeps = 0;
  uint64_t work = 0;   // tets visited by sweeps
  float residual = 0;  // rms over awake nodes of what the last two sweeps moved, m
};

// Solves one sub-step of h seconds. In: body as the last sub-step left it, the contacts and their index. Out: body.node, and in
// `held` what each contact did. share: h over the last sub-step's.
SolveStats solve_nodal(const StepInput&, const ContactSet&, float h, float share, NodalSolver&, DeformableState&);

// After it: plastic flow of the tets that are beyond yield, and the drag that the nodes took: J.
double flow_nodal(const Model&, NodalSolver&, DeformableState&);

// Elastic energy of the tets and of the springs that hold the cell, J.
double stored_nodal(const Model&, const ContactSet&, NodalSolver&, const DeformableState&);

}  // namespace crumple

// The solver `nodal`: one sub-step of quasi-static equilibrium, node by node.
//   minimise over x  sum_i c_i/(2h) |x_i - before_i|^2 + sum_t V_t W(F_t)   subject to the contacts' planes
// with W the stable neo-Hookean energy. Its moduli are lowered where the tet flows (flow.h). J is linear in one corner of a
// tet, so the energy is exactly quadratic in one node, with a positive definite 3x3 Hessian. A visit minimises it exactly; with
// over-relaxation 0 < omega < 2 the energy still never rises, even for inverted tets.
#pragma once

#include <cstdint>
#include <vector>

#include "sim/active_set.h"
#include "sim/anderson.h"
#include "sim/contacts.h"
#include "sim/flow.h"
#include "sim/kernels.h"
#include "sim/pairs.h"
#include "sim/step.h"
#include "sim/team.h"

namespace crumple {

inline constexpr float relaxation = 1.7f;
// An anchored node that an obstacle reaches yields like a spring this many times as stiff as its tets, so contacts always win.
inline constexpr float anchor_ratio = 30.0f;
// All these springs together are no stiffer than this share of (car's mass) / h^2: the rigid motion is integrated explicitly.
// h: the length of a sub-step before any halving. With springs that become stiffer when sub-steps become shorter, the loose
// anchored nodes of a crushed car would go to and fro when their number changes from tick to tick, and never rest.
inline constexpr float anchor_share = 0.25f;

// m: a tet lower than this does not flow. Positions in single precision a metre or two from the origin are exact to 0.1 um, so
// its strain would be noise of at least a tenth of the yield strain.
inline constexpr float thinnest = 1e-3f;
// When more than this share of all tets have lost their shape, none flows.
inline constexpr double lost_share = 0.002;

// Besides Parameters::tolerance: the last two sweeps must be no more than this share of the nodes' way in the sub-step. Without
// it a push so slow that its whole way is within the tolerance would not be solved, and its force would be several times too
// high.
inline constexpr double small_share = 0.05;
// Sweeps of one solver step: moduli are updated before the step, and Anderson's acceleration is applied after it (anderson.h).
inline constexpr int sweeps_a_step = 2;

// The solver's memory of one tick, in the layout of its kernels (kernels.h), with the acceleration and the helpers.
struct NodalSolver {
  std::vector<Float4> node, before, rest, direction;  // padded_nodes(n)
  std::vector<Float4> step_start;                     // nodes before the current step
  std::vector<Float4> stiffness;                      // t, padded to whole groups, + 1
  std::vector<TetLanes> tets;                         // per group of tets
  std::vector<CornerWeights> weights;                 // 4 t, as SweepOrder::corner
  std::vector<uint8_t> region;                        // t, padded to whole groups
  std::vector<Law> law;                               // per region
  std::vector<YieldLaw> yield;                        // per region
  std::vector<uint16_t> flowing;                      // per group of tets: bits of the tets beyond yield
  std::vector<uint8_t> loaded;                        // per group: tets, weights, energy and flowing are there
  std::vector<double> energy;                         // per group: elastic energy, J
  ActiveSet active;
  ActiveSeeds seeds;
  std::vector<ContactForce> contact_forces;  // per contact
  std::vector<float> pair_stiffness;         // n, of the nodes that touch another car: mean of its own block, N/m
  double volume = 0;                         // of all tets at rest, m^3
  AndersonStep last_step;
  Team* team = nullptr;  // the island's
};

// Before the first sub-step of a tick: copies the car's state into the layout of the kernels.
void prepare_nodal(const Model&, const Parameters&, const DeformableState&, Team&, NodalSolver&);

// Copies the stirred groups of tets into the layout of the kernels, as long as they are not there.
void load_stirred(const Model&, const DeformableState&, NodalSolver&);

struct SolveStats {
  uint32_t sweeps = 0;
  uint64_t work = 0;   // tets visited by sweeps
  float residual = 0;  // rms over awake nodes of what the last two sweeps moved, m
  uint32_t lost = 0;   // tets that have lost their shape in the sub-step
};

// A car in a sub-step. In: the body after the last sub-step, the contacts and their index. Out: body.node, the force of each
// contact in solver.contact_forces, and stats.
struct NodalPart {
  const StepInput& input;
  const ContactSet& contacts;
  const PairIndex* pairs;  // of this car; null: it touches no other
  float share;             // length of this sub-step divided by the length of the last one
  NodalSolver& solver;
  DeformableState& body;
  double lost = 0;  // tets that have no shape when the sub-step begins
  SolveStats stats = {};
};

// Solves one sub-step of h seconds for cars that touch one another, or for one car. car[k] of a contact between cars is an
// index of `parts`. A sweep sees the other cars as they stood when it began, so no car reads what another moves.
void solve_nodal(std::span<NodalPart> parts, std::span<PairContact>, float h);

// After solve_nodal(): plastic flow of the tets beyond yield. Returns the plastic work and the work of drag, J.
double flow_nodal(const Model&, NodalSolver&, DeformableState&);

// Elastic energy of the tets and of the springs on anchored nodes, J. Keeps the part of the springs in the body.
double stored_nodal(const Model&, const ContactSet&, const PairIndex*, NodalSolver&, DeformableState&);

}  // namespace crumple

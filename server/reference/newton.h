// The reference minimiser: one sub-step of the problem of server/sim/nodal.h in double precision, slow and obvious.
//   minimise over x  sum_i c_i/(2h) |x_i - before_i|^2 + sum_t V_t W(F_t)   subject to the contacts' planes
// with W the incremental plastic potential of reference_law.h, anchored nodes fixed (those that a contact reaches: on a spring,
// as stiffen_anchors in nodal.cpp), Coulomb friction on nodes that one plane holds, and none on those that several hold.
// Newton with each tet's exact tangent, sparse LDLT; where that is not positive definite, each tet's is projected so that it
// is. Contacts are an active set. A step is done when no node is farther from balance than 1e-9 of the largest force of a tet
// on a corner. Converges quadratically; with friction linearly (the cone's size lags a pass), at about a tenth a pass.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "reference/law.h"
#include "sim/contacts.h"

namespace crumple {

// As DeformableState: what one car keeps between sub-steps.
struct ReferenceState {
  std::vector<Eigen::Vector3d> node;       // m, car's frame
  std::vector<Eigen::Matrix3d> gradients;  // per tet: rows are the rest gradients of corners 1..3 after flow, 1/m
  std::vector<double> hardening;           // per tet: kappa
};
ReferenceState make_reference(const Model&);

struct ReferenceOptions {
  FlowLaw law = FlowLaw::mapped;
  double tolerance = 1e-9;  // of the residual, relative
  int most_passes = 300;
  double mass = 1e30;  // of the car, kg: bounds the springs of anchored nodes, as in solve_nodal
};

// What one sub-step came to.
struct ReferenceStep {
  std::vector<double> residual;  // relative, at each Newton pass; the last is the one reached
  bool converged = false;
  Eigen::Vector3d force = Eigen::Vector3d::Zero();  // of all contacts on the car, N, car's frame
  std::vector<Eigen::Vector3d> contact_force;       // per node, N
  int held = 0;                                     // nodes that a contact holds
  int sliding = 0;                                  // of those, nodes that do not stick
  int inverted = 0;                                 // tets too flat to flow (smallest_flowing_ratio) or inverted
  double plastic_work = 0;                          // J
  double drag_work = 0;                             // J
};

// Solves and flows one sub-step of h seconds. Contacts: sorted by node, as find_contacts leaves them.
ReferenceStep step_reference(const Model&, const Parameters&, std::span<const Contact>, double h, const ReferenceOptions&,
                             ReferenceState&);

// Follows a prescribed path: in sub-step k the car's frame goes from path[k] to path[k + 1] while the obstacles move steadily.
// Normals and offsets come from find_contacts on a copy of the nodes in single precision. watch: called after each sub-step.
using ReferenceWatch = std::function<void(size_t substep, const ReferenceStep&)>;
void follow_reference(const Model&, const Parameters&, std::span<const Obstacle>, std::span<const Pose> path, double h,
                      const ReferenceOptions&, const ReferenceWatch& watch, ReferenceState&);

// The potential at the positions `node` of a sub-step that starts from `before`, J, without contacts, and if asked for its
// gradient, N. FlowLaw::mapped.
double reference_potential(const Model&, const Parameters&, const ReferenceState& before, double h,
                           std::span<const Eigen::Vector3d> node, std::vector<Eigen::Vector3d>* gradient);

}  // namespace crumple

// The reference minimiser: solves one sub-step of the problem of server/sim/nodal.h in double precision, slowly and simply.
//   minimise over x  sum_i c_i/(2h) |x_i - before_i|^2 + sum_t V_t W(F_t)   subject to the contacts' planes
// with W the incremental plastic potential of law.h. Anchored nodes are fixed; those that a contact reaches are on a spring, as
// in stiffen_anchors in nodal.cpp. Nodes on one plane have Coulomb friction, nodes on several planes none. It uses Newton's
// method with each tet's exact tangent and sparse LDLT. If the matrix is not positive definite, each tet's tangent is projected
// so that it is. Contacts are an active set. A step is done when no node is farther from balance than 1e-9 of the largest force
// of a tet on a corner. Convergence is quadratic; with friction it is linear, at about a tenth per pass, because the cone's
// size lags by a pass.
// Bodies that touch one another are one system. Their contacts are those of find_pairs, each an augmented Lagrangian that ends
// when its force no longer changes: then gaps that press are closed, and the force is the multiplier.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include "reference/law.h"
#include "sim/contacts.h"
#include "sim/pairs.h"

namespace crumple {

// Like DeformableState: what one car keeps between sub-steps.
struct ReferenceState {
  std::vector<Eigen::Vector3d> node;       // m, car's frame
  std::vector<Eigen::Matrix3d> gradients;  // per tet: rows are the rest gradients of corners 1..3 after flow, 1/m
  std::vector<double> hardening;           // per tet: kappa
};
ReferenceState make_reference(const Model&);

struct ReferenceOptions {
  FlowLaw law = FlowLaw::mapped;
  double tolerance = 1e-9;  // relative residual
  int most_passes = 300;
  double mass = 1e30;  // of the car, kg: limits the springs of anchored nodes, as in solve_nodal
};

// The result of one sub-step.
struct ReferenceStep {
  std::vector<double> residual;  // relative, at each Newton pass; the last is the final one
  bool converged = false;
  Eigen::Vector3d force = Eigen::Vector3d::Zero();  // of all contacts on the car, N, car's frame
  std::vector<Eigen::Vector3d> contact_force;       // per node, N
  int held = 0;                                     // nodes that a contact holds
  int sliding = 0;                                  // how many of them do not stick
  int inverted = 0;                                 // tets that are inverted or too flat to flow (smallest_flowing_ratio)
  double plastic_work = 0;                          // J
  double drag_work = 0;                             // J
};

// A body in a sub-step. contacts: with obstacles, sorted by node, as find_contacts gives them.
struct ReferenceBody {
  const Model& model;
  const Parameters& parameters;
  std::span<const Contact> contacts;
  ReferenceState& state;
};

// Solves and flows one sub-step of h seconds. car[k] of a contact between bodies is an index of `bodies`; its pressed, force
// and heat are written, but are not in ReferenceStep. One result per body; they have the same residuals.
std::vector<ReferenceStep> step_reference(std::span<const ReferenceBody> bodies, std::span<PairContact>, double h,
                                          const ReferenceOptions&);
ReferenceStep step_reference(const Model&, const Parameters&, std::span<const Contact>, double h, const ReferenceOptions&,
                             ReferenceState&);

// Follows prescribed paths, which are equally long: in sub-step k a car's frame moves from path[k] to path[k + 1], and the
// obstacles move steadily. find_contacts and find_pairs give normals and offsets from a single-precision copy of the nodes.
// watch is called after each sub-step with a result per car, and the contacts between cars.
struct ReferenceCar {
  const Model& model;
  const Parameters& parameters;
  std::span<const Pose> path;
  ReferenceState& state;
};
using ReferencePairWatch = std::function<void(size_t substep, std::span<const ReferenceStep>, std::span<const PairContact>)>;
void follow_reference(std::span<const ReferenceCar>, std::span<const Obstacle>, double h, const ReferenceOptions&,
                      const ReferencePairWatch& watch);

// The same for one car.
using ReferenceWatch = std::function<void(size_t substep, const ReferenceStep&)>;
void follow_reference(const Model&, const Parameters&, std::span<const Obstacle>, std::span<const Pose> path, double h,
                      const ReferenceOptions&, const ReferenceWatch& watch, ReferenceState&);

// The potential, J, at the positions `node` of a sub-step that starts from `before`, without contacts; and its gradient, N, if
// asked for. Uses FlowLaw::mapped.
double reference_potential(const Model&, const Parameters&, const ReferenceState& before, double h,
                           std::span<const Eigen::Vector3d> node, std::vector<Eigen::Vector3d>* gradient);

}  // namespace crumple

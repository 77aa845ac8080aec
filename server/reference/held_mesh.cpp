#include "reference/held_mesh.h"

#include <limits>

#include "car/make_boundary.h"
#include "car/make_sweep_order.h"

namespace crumple {

HeldMesh::HeldMesh(TetMesh tets, std::vector<uint8_t> held, double mass)
    : place(tets.node),
      tets_(std::move(tets)),
      constraints_(build_constraints(tets_)),
      masses_(lump_masses(tets_, constraints_.tet_rest, mass)),
      held_(std::move(held)),
      node_region_(tets_.node.size(), 0),
      tet_region_(tets_.tet.size(), 0) {
  model_.node = place;
  model_.node_mass = masses_.node;
  model_.node_region = node_region_;
  model_.node_anchored = held_;
  model_.tet = tets_.tet;
  model_.gradients = constraints_.gradients;
  model_.tet_rest = constraints_.tet_rest;
  model_.tet_region = tet_region_;
  model_.edge = constraints_.edge;
  model_.edge_rest = constraints_.edge_rest;
  model_.node_first = constraints_.node_first;
  model_.corner = constraints_.corner;
  model_.mass = float(mass);
  model_.center_of_mass = masses_.center;
  model_.inertia = masses_.inertia;
  order_ = make_sweep_order(model_);
  boundary_ = make_boundary(model_);
  model_.order = &order_;
  model_.boundary = &boundary_;
}

Mass fixed_mass() {
  Mass mass;
  mass.mass = std::numeric_limits<double>::infinity();
  mass.inertia.setConstant(mass.mass);
  return mass;
}

void hold(const HeldMesh& mesh, const Parameters& parameters, std::span<const Obstacle> obstacles, Scratch& scratch,
          DeformableState& body) {
  Motion motion;
  body.settled = false;
  deform({mesh.model(), parameters, fixed_mass(), obstacles, substep_seconds(parameters)}, scratch, body, motion);
}

void come_to_rest(const HeldMesh& mesh, const Parameters& parameters, Scratch& scratch, DeformableState& body) {
  Motion motion;
  for (Vec3& step : body.step) step.setZero();
  body.settled = false;
  for (int k = 0; k < 120 && !body.settled; ++k)
    deform({mesh.model(), parameters, fixed_mass(), {}, 1.0 / 60}, scratch, body, motion);
}

}  // namespace crumple

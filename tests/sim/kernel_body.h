// Bodies for tests of the kernels: meshes of awkward sizes and orders, and a body whose tets take every branch.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <memory>
#include <random>
#include <vector>

#include "box_car.h"
#include "car/make_boundary.h"
#include "car/make_sweep_order.h"
#include "sim/flow.h"
#include "sim/nodal.h"

namespace crumple {

// ---- meshes -------------------------------------------------------------------------------------------------------------

struct Mesh {
  TetMesh tets;
  Constraints constraints;
  Masses masses;
  std::vector<uint8_t> anchored, node_region, tet_region;
  SweepOrder order;
  Boundary boundary;
  Model model;

  Mesh(TetMesh from, std::vector<uint8_t> held)
      : tets(std::move(from)),
        constraints(build_constraints(tets)),
        masses(lump_masses(tets, constraints.tet_rest, 1200)),
        anchored(std::move(held)),
        node_region(tets.node.size(), 0),
        tet_region(tets.tet.size(), 0) {
    model.node = tets.node;
    model.node_mass = masses.node;
    model.node_region = node_region;
    model.node_anchored = anchored;
    model.tet = tets.tet;
    model.gradients = constraints.gradients;
    model.tet_rest = constraints.tet_rest;
    model.tet_region = tet_region;
    model.edge = constraints.edge;
    model.edge_rest = constraints.edge_rest;
    model.node_first = constraints.node_first;
    model.corner = constraints.corner;
    model.mass = 1200;
    model.center_of_mass = masses.center;
    model.inertia = masses.inertia;
    order = make_sweep_order(model);
    model.order = &order;
    boundary = make_boundary(model);
    model.boundary = &boundary;
  }
  Mesh(const Mesh&) = delete;
};

inline std::unique_ptr<Mesh> box(BoxCells cells) {
  BoxMesh mesh = box_mesh(cells);
  return std::make_unique<Mesh>(std::move(mesh.tets), std::move(mesh.anchored));
}

// The same mesh with nodes and tets in random order.
inline std::unique_ptr<Mesh> shuffled_box(BoxCells cells, unsigned seed) {
  const BoxMesh from = box_mesh(cells);
  std::vector<uint32_t> order(from.tets.node.size());
  for (uint32_t i = 0; i < order.size(); ++i) order[i] = i;
  std::mt19937 random(seed);
  std::shuffle(order.begin(), order.end(), random);
  TetMesh to{std::vector<Vec3>(order.size()), from.tets.tet};
  std::vector<uint8_t> anchored(order.size());
  for (uint32_t i = 0; i < order.size(); ++i) {
    to.node[order[i]] = from.tets.node[i];
    anchored[order[i]] = from.anchored[i];
  }
  for (Tet& tet : to.tet) {
    for (uint32_t& node : tet.node) node = order[node];
  }
  std::shuffle(to.tet.begin(), to.tet.end(), random);
  return std::make_unique<Mesh>(std::move(to), std::move(anchored));
}

// Tets around one edge: two nodes belong to all tets, the others to two each.
inline std::unique_ptr<Mesh> fan(uint32_t count) {
  TetMesh mesh;
  mesh.node = {{0, 0, -0.5f}, {0, 0, 0.5f}};
  for (uint32_t k = 0; k < count; ++k) {
    const float angle = 6.2831853f * float(k) / float(count);
    mesh.node.emplace_back(std::cos(angle), std::sin(angle), 0.0f);
    mesh.tet.push_back({{0, 2 + k, 2 + (k + 1) % count, 1}});
  }
  return std::make_unique<Mesh>(std::move(mesh), std::vector<uint8_t>(count + 2, 0));
}

// Meshes with fewer tets than lanes, with whole groups of tets, and with neither; in random order; with very different nodes.
inline std::vector<std::unique_ptr<Mesh>> meshes() {
  std::vector<std::unique_ptr<Mesh>> all;
  for (const BoxCells cells : {BoxCells{1, 1, 1}, BoxCells{8, 1, 1}, BoxCells{9, 4, 3}}) all.push_back(box(cells));
  all.push_back(shuffled_box({7, 5, 3}, 3));
  all.push_back(fan(100));
  return all;
}

// ---- a body in which every branch is taken ----------------------------------------------------------------------------------

// Regions, side by side in groups of tets: foam; with a Poisson ratio, hardening without end; another Poisson ratio, soft,
// dense from the beginning; nearly at the plastic limit.
inline Parameters materials() {
  Parameters parameters;
  for (Material& material : parameters.region) material.yield_strain = 0.009f, material.plastic_limit = 1.2f;
  parameters.region[1].poisson_ratio = 0.3f;
  parameters.region[1].hardening = 0.2f;
  parameters.region[1].hardening_strain = 1000;
  parameters.region[2].poisson_ratio = 0.4f;
  parameters.region[2].young_modulus = 2e6f;
  parameters.region[2].densification_strain = 0;
  parameters.region[3].plastic_limit = 0.05f;
  return parameters;
}

struct State {
  std::unique_ptr<Mesh> mesh;
  Parameters parameters = materials();
  DeformableState body;
  Team team;
  NodalSolver solver;
  std::mt19937 random;

  // Noise grows along x: the back is at rest, the middle is beyond yield, and tets in front are inverted. `noise` is its size
  // in front, m.
  State(std::unique_ptr<Mesh> of, unsigned seed, float noise) : mesh(std::move(of)), random(seed) {
    for (uint8_t& region : mesh->tet_region) region = uint8_t(random() % 4);
    body = make_body(mesh->model);
    std::normal_distribution<float> normal(0, 1);
    for (size_t t = 0; t < body.gradients.size(); ++t) {
      if (random() % 2) continue;  // has flowed before
      Mat3 factor = Mat3::Identity();
      for (int k = 0; k < 9; ++k) factor(k / 3, k % 3) += 0.02f * normal(random);
      for (Vec3& corner : body.gradients[t].corner) corner = factor * corner;
      const float limit = parameters.region[mesh->tet_region[t]].plastic_limit;
      body.hardening[t] = std::min(limit, limit * 1.1f * float(random() % 1000) / 1000);
    }
    load();
    for (uint32_t i = 0; i < body.node.size(); ++i) {
      const Vec3 rest = mesh->model.node[i];
      const float share = std::max(0.0f, rest.x() / 2.25f + 0.3f);
      const Vec3 moved = rest + noise * share * share * Vec3(normal(random), normal(random), normal(random));
      solver.node[i] = {moved.x(), moved.y(), moved.z(), 0};
      solver.before[i] = {rest.x(), rest.y(), rest.z(), 1e4f + float(random() % 1000)};
      solver.rest[i] = {rest.x(), rest.y(), rest.z(), mesh->anchored[i] && random() % 2 ? 1e6f : 0.0f};
      solver.direction[i] = {0.02f * share * normal(random), 0.02f * share * normal(random), 0.02f * share * normal(random), 0};
    }
    const Blocks& blocks = solver.active.blocks;
    for (size_t b = 0; b < blocks.anchored.size(); ++b) {
      uint16_t& still = solver.active.still[b];
      still = blocks.anchored[b] ? uint16_t(0xffff) : blocks.unused[b];
      solver.active.touched[b] = uint16_t(random() & random() & random() & ~unsigned(blocks.unused[b]));
      still |= solver.active.touched[b];
    }
  }
  // Copies the whole body to the solver.
  void load() {
    prepare_nodal(mesh->model, parameters, body, team, solver);
    wake_all(mesh->model, {}, solver.active);
    std::fill(solver.active.awake.begin(), solver.active.awake.end(), uint8_t(1));  // the anchored nodes too
    stir(mesh->model, {}, solver.active);
    load_stirred(mesh->model, body, solver);
    pack(mesh->model, {}, solver.weights, solver.active);
  }
  size_t tets() const { return mesh->model.tet.size(); }
  uint32_t groups() const { return uint32_t(mesh->order.group.size()); }
  TetView tet_view() const {
    TetView view{};
    view.node = solver.node.data();
    view.group = mesh->order.group.data();
    view.tet = solver.tets.data();
    view.region = solver.region.data();
    view.law = solver.law.data();
    view.stirred = solver.active.stirred.data();
    return view;
  }
  NodeView node_view() {
    const Blocks& blocks = solver.active.blocks;
    NodeView view{};
    view.node = solver.node.data();
    view.before = solver.before.data();
    view.rest = solver.rest.data();
    view.stiffness = solver.stiffness.data();
    view.index = blocks.node.data();
    view.row = blocks.row.data();
    view.anchored = blocks.anchored.data();
    view.rows = blocks.rows.data();
    view.weights = blocks.weights.data();
    view.still = solver.active.still.data();
    view.touched = solver.active.touched.data();
    view.relaxation = relaxation;
    return view;
  }
  uint32_t renew(const Kernels& kernel) {
    return kernel.update_secant_moduli(tet_view(), 0, groups(), solver.stiffness.data(), solver.flowing.data());
  }
  double flow(const Kernels& kernel) { return kernel.flow(tet_view(), solver.tets.data(), 0, groups(), solver.flowing.data()); }
  void visit(const Kernels& kernel, NodeView view) const {
    const auto& colour = solver.active.blocks.colour;
    for (size_t c = 0; c + 1 < colour.size(); ++c) kernel.relax_nodes(view, colour[c], colour[c + 1]);
  }
  // The present shape of the tet.
  Gradients gradients(size_t t) const {
    Gradients out;
    for (int k = 0; k < 9; ++k) out.corner[k / 3][k % 3] = solver.tets[t / lanes].gradient[k][t % lanes];
    return out;
  }
  Vec3 position(uint32_t i) const { return {solver.node[i].x, solver.node[i].y, solver.node[i].z}; }
  Mat3 deformation_of(size_t t) const {
    const uint32_t* n = mesh->model.tet[t].node;
    return deformation(position(n[0]), position(n[1]), position(n[2]), position(n[3]), gradients(t));
  }
  float& kappa(size_t t) { return solver.tets[t / lanes].kappa[t % lanes]; }
  bool flows(size_t t) const { return solver.flowing[t / lanes] >> (t % lanes) & 1; }
  const Material& material(size_t t) const { return parameters.region[mesh->tet_region[t]]; }
  YieldLaw law(size_t t) const { return crushed(yield_law(material(t)), volume_ratio(mesh->model.tet_rest[t], gradients(t))); }
};

inline std::unique_ptr<State> state(float noise = 0.05f, unsigned seed = 5) {
  return std::make_unique<State>(shuffled_box({9, 4, 3}, seed), seed, noise);
}

// ---- comparing ------------------------------------------------------------------------------------------------------------

inline std::vector<const Kernels*> all_kernels() {
  std::vector<const Kernels*> all;
  for (const char* name : {"portable", "avx2", "avx512"}) {
    if (const Kernels* found = kernels(name)) all.push_back(found);
  }
  return all;
}

template <class T>
testing::AssertionResult same(const std::vector<T>& a, const std::vector<T>& b) {
  if (a.size() != b.size()) return testing::AssertionFailure() << a.size() << " and " << b.size() << " entries";
  for (size_t i = 0; i < a.size(); ++i) {
    if (std::memcmp(&a[i], &b[i], sizeof(T)) != 0)
      return testing::AssertionFailure() << "they differ from entry " << i << " on";
  }
  return testing::AssertionSuccess();
}

}  // namespace crumple

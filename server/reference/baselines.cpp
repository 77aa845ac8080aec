#include "reference/baselines.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "sim/classic.h"
#include "sim/deform.h"

namespace crumple {
namespace {

// Factor of relaxed Jacobi. The added corrections of a node's edges overshoot several times. At 0.2 a car of 400 nodes that
// starts at a point ends with numbers that are not finite; at 0.1 more starts are unfinished after 3 s.
constexpr float relaxed_share = 0.15f;
// N s/m: without any drag a node would have no weight relative to its neighbours.
constexpr float least_drag = 1e-3f;
// An isotropic network of springs with sum k length^2 = 6 a E per volume has moduli C11 = 6/5 a E, C12 = 2/5 a E; the volumes
// add E to both. With this a, both together have Young's modulus E (and Poisson ratio 0.40).
constexpr float network_share = 0.9f;

uint32_t edges_of(const Model& model) { return uint32_t(model.edge.size()); }
uint32_t constraints_of(const Model& model) { return uint32_t(model.edge.size() + model.tet.size()); }

float& rest_of(const Model& model, DeformableState& body, uint32_t k) {
  return k < edges_of(model) ? body.edge_rest[k] : body.tet_rest[k - edges_of(model)];
}

const Material& material_of(const Model& model, const Parameters& parameters, uint32_t k) {
  const uint32_t edges = edges_of(model);
  return parameters.region[k < edges ? model.node_region[model.edge[k].node[0]] : model.tet_region[k - edges]];
}

// How far along its gradients a constraint moves its nodes, which all have the same weight. `classic` takes a sixth of the step
// that would meet a volume.
float step_of(const Model& model, const Parameters& parameters, const Constraint& c, uint32_t k) {
  float sum = 0;
  for (int i = 0; i < c.count; ++i) sum += c.gradient[i].squaredNorm();
  if (sum < 1e-26f) return 0;
  const Material& material = material_of(model, parameters, k);
  return -(c.count == 2 ? material.distance_stiffness : material.volume_stiffness / 6) * c.value / sum;
}

void flow_rest(const Model& model, const Parameters& parameters, const Constraint& c, uint32_t k, DeformableState& body) {
  float& rest = rest_of(model, body, k);
  rest += (1 - material_of(model, parameters, k).plasticity) * c.value;
}

void project_contacts(const Model& model, std::span<const Contact> contacts, DeformableState& body) {
  for (const Contact& contact : contacts) {
    if (model.node_anchored[contact.node]) continue;
    Vec3& node = body.node[contact.node];
    node += std::max(0.0f, contact.offset - contact.normal.dot(node)) * contact.normal;
  }
}

// share(node, tets): the share of the node's added corrections that it makes; tets: in the pass over the volumes.
template <class Share>
void solve_jacobi(const Model& model, const Parameters& parameters, std::span<const Contact> contacts, const Share& share,
                  DeformableState& body) {
  project_contacts(model, contacts, body);
  std::vector<Vec3> sum(model.node.size());
  const auto pass = [&](uint32_t from, uint32_t to, bool first) {
    std::fill(sum.begin(), sum.end(), Vec3::Zero());
    for (uint32_t k = from; k < to; ++k) {
      const Constraint c = measure(model, body, k);
      const float step = step_of(model, parameters, c, k);
      for (int i = 0; i < c.count; ++i) sum[c.node[i]] += step * c.gradient[i];
      if (first) flow_rest(model, parameters, c, k, body);
    }
    for (uint32_t i = 0; i < sum.size(); ++i) {
      if (!model.node_anchored[i]) body.node[i] += share(i, from > 0) * sum[i];
    }
  };
  for (int iteration = 0; iteration < parameters.iterations; ++iteration) {
    pass(0, edges_of(model), iteration == 0);
    pass(edges_of(model), constraints_of(model), iteration == 0);
  }
}

}  // namespace

Constraint measure(const Model& model, const DeformableState& body, uint32_t k) {
  if (k < edges_of(model)) {
    const auto [a, b] = model.edge[k].node;
    const Vec3 across = body.node[b] - body.node[a];
    const float length = across.norm();
    const Vec3 direction = length < 1e-9f ? Vec3(Vec3::Zero()) : Vec3(across / length);
    return {2, {a, b}, length - body.edge_rest[k], {-direction, direction}};
  }
  const uint32_t t = k - edges_of(model);
  const uint32_t* n = model.tet[t].node;
  const Vec3& a = body.node[n[0]];
  const Vec3 b = body.node[n[1]] - a, c = body.node[n[2]] - a, d = body.node[n[3]] - a;
  const Vec3 of_b = c.cross(d) / 6, of_c = d.cross(b) / 6, of_d = b.cross(c) / 6;
  return {4, {n[0], n[1], n[2], n[3]}, of_d.dot(d) - body.tet_rest[t], {-of_b - of_c - of_d, of_b, of_c, of_d}};
}

Structure build_structure(const Model& model) {
  Structure out;
  out.edges.assign(model.node.size(), 0);
  out.tets.assign(model.node.size(), 0);
  out.edge_volume.assign(model.edge.size(), 0);
  for (const Edge& edge : model.edge) {
    for (uint32_t node : edge.node) ++out.edges[node];
  }
  for (uint32_t node = 0; node < model.node.size(); ++node)
    out.tets[node] = model.node_first[node + 1] - model.node_first[node];
  // The tets around an edge are those that contain both of its nodes.
  for (size_t e = 0; e < model.edge.size(); ++e) {
    const auto [a, b] = model.edge[e].node;
    for (uint32_t k = model.node_first[a]; k < model.node_first[a + 1]; ++k) {
      const uint32_t tet = model.corner[k] / 4;
      for (uint32_t node : model.tet[tet].node) out.edge_volume[e] += node == b ? model.tet_rest[tet] : 0;
    }
  }
  // Greedy: the lowest colour that none of its nodes has yet. Edges and tets never share a colour.
  const DeformableState rest = make_body(model);
  const auto colour = [&](uint32_t from, uint32_t to) {
    std::vector<std::vector<uint32_t>> groups;
    std::vector<std::vector<bool>> used(model.node.size());  // per node: by colour
    for (uint32_t k = from; k < to; ++k) {
      const Constraint c = measure(model, rest, k);
      size_t chosen = 0;
      const auto taken = [&](uint32_t node) { return chosen < used[node].size() && used[node][chosen]; };
      while (std::any_of(c.node, c.node + c.count, taken)) ++chosen;
      for (int i = 0; i < c.count; ++i) {
        auto& colours = used[c.node[i]];
        if (colours.size() <= chosen) colours.resize(chosen + 1);
        colours[chosen] = true;
      }
      if (groups.size() <= chosen) groups.resize(chosen + 1);
      groups[chosen].push_back(k);
    }
    for (const auto& group : groups) {
      out.first.push_back(uint32_t(out.constraint.size()));
      out.constraint.insert(out.constraint.end(), group.begin(), group.end());
    }
  };
  colour(0, edges_of(model));
  colour(edges_of(model), constraints_of(model));
  out.first.push_back(uint32_t(out.constraint.size()));
  return out;
}

void solve_naive_jacobi(const Model& model, const Structure&, const Parameters& parameters, std::span<const Contact> contacts,
                        DeformableState& body) {
  solve_jacobi(
      model, parameters, contacts, [](uint32_t, bool) { return 1.0f; }, body);
}

void solve_averaged_jacobi(const Model& model, const Structure& structure, const Parameters& parameters,
                           std::span<const Contact> contacts, DeformableState& body) {
  const auto share = [&](uint32_t node, bool tets) { return 1 / float((tets ? structure.tets : structure.edges)[node]); };
  solve_jacobi(model, parameters, contacts, share, body);
}

void solve_relaxed_jacobi(const Model& model, const Structure&, const Parameters& parameters, std::span<const Contact> contacts,
                          DeformableState& body) {
  solve_jacobi(
      model, parameters, contacts, [](uint32_t, bool) { return relaxed_share; }, body);
}

void solve_coloured(const Model& model, const Structure& structure, const Parameters& parameters,
                    std::span<const Contact> contacts, DeformableState& body) {
  project_contacts(model, contacts, body);
  for (int iteration = 0; iteration < parameters.iterations; ++iteration) {
    for (uint32_t k : structure.constraint) {
      const Constraint c = measure(model, body, k);
      const float step = step_of(model, parameters, c, k);
      for (int i = 0; i < c.count; ++i) {
        if (!model.node_anchored[c.node[i]]) body.node[c.node[i]] += step * c.gradient[i];
      }
      if (iteration == 0) flow_rest(model, parameters, c, k, body);
    }
  }
}

float drag_of(const Model& model, const Parameters& parameters, uint32_t node, float volume) {
  const float drag = parameters.region[model.node_region[node]].drag;
  return std::max(least_drag, drag * model.node_mass[node] / model.mass * volume);
}

float stiffness_of(const Model& model, const Structure& structure, const Parameters& parameters, uint32_t k) {
  const float modulus = material_of(model, parameters, k).young_modulus;
  if (k < edges_of(model))
    return network_share * modulus * structure.edge_volume[k] / (model.edge_rest[k] * model.edge_rest[k]);
  return modulus / model.tet_rest[k - edges_of(model)];
}

void solve_xpbd(const Model& model, const Structure& structure, const Parameters& parameters, std::span<const Contact> contacts,
                float h, DeformableState& body) {
  float volume = 0;
  for (float each : model.tet_rest) volume += each;
  std::vector<float> weight(model.node.size());  // m/N
  for (uint32_t i = 0; i < weight.size(); ++i) {
    weight[i] = model.node_anchored[i] ? 0 : h / drag_of(model, parameters, i, volume);
  }
  std::vector<float> multiplier(constraints_of(model));
  for (int iteration = 0; iteration < parameters.iterations; ++iteration) {
    for (uint32_t k = 0; k < multiplier.size(); ++k) {
      const Constraint c = measure(model, body, k);
      const float compliance = 1 / stiffness_of(model, structure, parameters, k);
      float sum = compliance;
      for (int i = 0; i < c.count; ++i) sum += weight[c.node[i]] * c.gradient[i].squaredNorm();
      const float change = (-c.value - compliance * multiplier[k]) / sum;
      multiplier[k] += change;
      for (int i = 0; i < c.count; ++i) body.node[c.node[i]] += (weight[c.node[i]] * change) * c.gradient[i];
    }
    project_contacts(model, contacts, body);
  }
}

void creep(const Model& model, const Parameters& parameters, DeformableState& body) {
  for (uint32_t k = 0; k < constraints_of(model); ++k) flow_rest(model, parameters, measure(model, body, k), k, body);
}

void deform_baseline(Baseline baseline, const Model& model, const Structure& structure, const Parameters& parameters,
                     const Mass& mass, std::span<const Obstacle> obstacles, double seconds, DeformableState& body,
                     Motion& motion) {
  const std::vector<Vec3> before = body.node;
  ContactSet found;
  const std::vector<Contact>& contacts = found.contact;
  find_candidates({model, parameters, mass, obstacles, seconds}, body, motion, found);
  if (found.candidate.empty() && body.settled && !body.touching) {  // what held the body may have gone
    motion.pose = advance(motion, mass, seconds);
    return;
  }
  const int count = baseline == Baseline::xpbd ? std::max(1, int(std::lround(seconds / substep_seconds(parameters)))) : 1;
  const double h = seconds / count;
  for (int k = 0; k < count; ++k) {
    const Pose to = advance(motion, mass, h);
    find_contacts(body, obstacles, {motion.pose, to, k * h, h}, found);
    motion.pose = to;
    switch (baseline) {
      case Baseline::naive_jacobi:
        solve_naive_jacobi(model, structure, parameters, contacts, body);
        break;
      case Baseline::averaged_jacobi:
        solve_averaged_jacobi(model, structure, parameters, contacts, body);
        break;
      case Baseline::relaxed_jacobi:
        solve_relaxed_jacobi(model, structure, parameters, contacts, body);
        break;
      case Baseline::coloured:
        solve_coloured(model, structure, parameters, contacts, body);
        break;
      case Baseline::xpbd:
        solve_xpbd(model, structure, parameters, contacts, float(h), body);
        break;
    }
  }
  body.touching = !contacts.empty();
  if (baseline == Baseline::xpbd) creep(model, parameters, body);
  float most = 0;
  for (size_t i = 0; i < body.node.size(); ++i) {
    body.step[i] = body.node[i] - before[i];
    most = std::max(most, body.step[i].norm());
  }
  body.settled = most <= 1e-6f;  // m in a tick
  measure_reach(model, body);
}

}  // namespace crumple

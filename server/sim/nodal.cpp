#include "sim/nodal.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace crumple {
namespace {

Mat3 tet_deformation(const Model& model, const Body& body, uint32_t tet) {
  const uint32_t* n = model.tet[tet].node;
  return deformation(body.node[n[0]], body.node[n[1]], body.node[n[2]], body.node[n[3]], body.gradients[tet]);
}

Vec3 corner_gradient(const Gradients& gradients, uint32_t corner) {
  return corner > 0 ? gradients.corner[corner - 1] : Vec3(-gradients.corner[0] - gradients.corner[1] - gradients.corner[2]);
}

Mat3 cofactors(const Mat3& f) {
  Mat3 c;
  c << f.col(1).cross(f.col(2)), f.col(2).cross(f.col(0)), f.col(0).cross(f.col(1));
  return c;
}

// The quadratic in one node: energy = gradient . d + d^T hessian d / 2.
struct Block {
  Vec3 gradient;
  Mat3 hessian;
};

// Uses scratch.deformation, which renew_stiffness fills and move_node keeps.
Block node_block(const Model& model, const Scratch& scratch, const Body& body, uint32_t node) {
  const float spring = scratch.drag[node] + scratch.anchor[node];
  Vec3 gradient = scratch.drag[node] * (body.node[node] - scratch.before[node]) +
                  scratch.anchor[node] * (body.node[node] - model.node[node]);
  float diagonal = spring;
  Mat3 volume = Mat3::Zero();
  for (uint32_t k = model.node_first[node]; k < model.node_first[node + 1]; ++k) {
    const uint32_t tet = model.corner[k] / 4;
    const Elastic& e = scratch.stiffness[tet];
    const Mat3& f = scratch.deformation[tet];
    const Vec3 g = corner_gradient(body.gradients[tet], model.corner[k] % 4);
    const Mat3 cofactor = cofactors(f);
    const Vec3 c = cofactor * g;  // d(J)/d(x)
    const float j = f.col(0).dot(cofactor.col(0));
    gradient += e.mu * (f * g) + (e.l * (j - e.gamma)) * c;
    diagonal += e.mu * g.squaredNorm();
    volume += (e.l * c) * c.transpose();
  }
  volume.diagonal().array() += diagonal;
  return {gradient, volume};
}

// One node moves: F changes by move gradient^T in each of its tets, cheaper than all four corners once more.
void move_node(const Model& model, uint32_t node, const Vec3& move, Scratch& scratch, Body& body) {
  body.node[node] += move;
  for (uint32_t k = model.node_first[node]; k < model.node_first[node + 1]; ++k) {
    const uint32_t tet = model.corner[k] / 4;
    const Vec3 g = corner_gradient(body.gradients[tet], model.corner[k] % 4);
    scratch.deformation[tet] += move * g.transpose();
  }
}

// The lowest point of the block on the planes `active` of this node's contacts, or nothing where a multiplier is negative or
// another plane is violated.
bool constrained(const Contact* contacts, int count, unsigned active, const Mat3& inverse, const Vec3& free, Vec3& out,
                 Vec3& multiplier) {
  int chosen[contacts_per_node], size = 0;
  for (int i = 0; i < count; ++i) {
    if (active >> i & 1) chosen[size++] = i;
  }
  Mat3 matrix = Mat3::Identity();
  Vec3 gap = Vec3::Zero();
  for (int i = 0; i < size; ++i) {
    const Contact& contact = contacts[chosen[i]];
    gap[i] = contact.offset - contact.normal.dot(free);
    for (int k = 0; k < size; ++k) matrix(i, k) = contact.normal.dot(inverse * contacts[chosen[k]].normal);
  }
  for (int i = size; i < 3; ++i) matrix(i, i) = matrix(0, 0);
  const float scale = matrix(0, 0) * matrix(1, 1) * matrix(2, 2);
  const float determinant = matrix.determinant();
  if (!(determinant > 1e-4f * scale)) return false;  // planes nearly parallel
  const Vec3 solved = matrix.inverse() * gap;
  out = free;
  multiplier.setZero();
  for (int i = 0; i < size; ++i) {
    if (solved[i] < 0) return false;
    multiplier[chosen[i]] = solved[i];
    out += inverse * (solved[i] * contacts[chosen[i]].normal);
  }
  for (int i = 0; i < count; ++i) {
    if (!(active >> i & 1) && contacts[i].normal.dot(out) < contacts[i].offset - 1e-6f) return false;
  }
  return true;
}

// A node on one plane with Coulomb friction: sticks to the obstacle if the force that this needs lies in the cone, else slides
// against a force on the cone.
Vec3 rub(const Contact& contact, const Block& block, const Mat3& inverse, const Vec3& position, const Vec3& free,
         const Vec3& frictionless, float multiplier) {
  const Vec3& n = contact.normal;
  const Vec3 stuck = contact.carried + (contact.offset - n.dot(contact.carried)) * n;
  const Vec3 force = block.gradient + block.hessian * (stuck - position);
  const float normal_force = n.dot(force);
  if (normal_force > 0 && (force - normal_force * n).norm() <= contact.friction * normal_force) return stuck;
  Vec3 slip = frictionless - stuck;
  const float length = slip.norm();
  if (length < 1e-9f) return stuck;
  slip /= length;
  const Vec3 response = inverse * n;
  const float stiffness = 1 / n.dot(response);
  Vec3 slid = frictionless;
  for (int i = 0; i < 2; ++i) {
    const Vec3 pushed = free - inverse * ((contact.friction * multiplier) * slip);
    multiplier = std::max(0.0f, (contact.offset - n.dot(pushed)) * stiffness);
    slid = pushed + multiplier * response;
  }
  return slip.dot(slid - stuck) > 0 ? slid : stuck;
}

void visit(const Model& model, Scratch& scratch, Body& body, uint32_t node) {
  const uint32_t first = scratch.contact_first[node];
  if (model.node_anchored[node] && first == 0) return;
  const Block block = node_block(model, scratch, body, node);
  const Mat3 inverse = block.hessian.inverse();
  const Vec3 position = body.node[node];
  const auto move_to = [&](const Vec3& target) { move_node(model, node, target - position, scratch, body); };
  const Vec3 move = inverse * block.gradient;
  if (first == 0) {
    return move_node(model, node, -relaxation * move, scratch, body);
  }
  const Contact* contacts = &scratch.contacts[first - 1];
  int count = 1;
  while (first - 1 + count < scratch.contacts.size() && contacts[count].node == node) ++count;
  Held* held = &scratch.held[first - 1];
  for (int i = 0; i < count; ++i) held[i].active = false;

  const Vec3 free = position - move;
  bool clear = true;
  for (int i = 0; i < count; ++i) clear = clear && contacts[i].normal.dot(free) >= contacts[i].offset;
  if (clear) return move_to(free);
  // Few planes at most: try every set, small ones first.
  static constexpr unsigned sets[] = {1, 2, 4, 3, 5, 6, 7};
  Vec3 target, multiplier;
  for (unsigned set : sets) {
    if (set >> count) continue;
    if (!constrained(contacts, count, set, inverse, free, target, multiplier)) continue;
    for (int i = 0; i < count; ++i) held[i].active = set >> i & 1;
    if ((set & (set - 1)) == 0) {
      const int only = set == 1 ? 0 : set == 2 ? 1 : 2;
      const Vec3 rubbed = rub(contacts[only], block, inverse, position, free, target, multiplier[only]);
      bool inside = false;
      for (int i = 0; i < count; ++i) inside = inside || contacts[i].normal.dot(rubbed) < contacts[i].offset - 1e-6f;
      if (!inside) target = rubbed;
    }
    return move_to(target);
  }
  // Planes that leave no room (a car between two closing walls): the deepest one wins.
  move_to(free + (contacts[0].offset - contacts[0].normal.dot(free)) * contacts[0].normal);
  held[0].active = true;
}

// Moves all nodes along `direction` by the factor in [0, most] that lowers the energy most. Along the line the energy is a
// polynomial of degree six, so its minimum needs one pass over the tets.
void search_line(const Model& model, const std::vector<Vec3>& direction, double most, const Scratch& scratch, Body& body) {
  double derivative[6] = {};  // of the energy along the line: sum derivative[k] a^k
  for (size_t i = 0; i < body.node.size(); ++i) {
    const float spring = scratch.drag[i] + scratch.anchor[i];
    const Vec3 pull = scratch.drag[i] * (body.node[i] - scratch.before[i]) + scratch.anchor[i] * (body.node[i] - model.node[i]);
    derivative[1] += double(spring * direction[i].squaredNorm());
    derivative[0] += double(direction[i].dot(pull));
  }
  for (uint32_t tet = 0; tet < model.tet.size(); ++tet) {
    const uint32_t* n = model.tet[tet].node;
    const Mat3 f1 = deformation(direction[n[0]], direction[n[1]], direction[n[2]], direction[n[3]], body.gradients[tet]);
    if (f1.isZero(0)) continue;
    const Mat3 f0 = tet_deformation(model, body, tet);
    const Elastic& e = scratch.stiffness[tet];
    derivative[0] += double(e.mu * f0.cwiseProduct(f1).sum());
    derivative[1] += double(e.mu * f1.squaredNorm());
    // J(a) = j0 + j1 a + j2 a^2 + j3 a^3
    const Mat3 c0 = cofactors(f0), c1 = cofactors(f1);
    const double j[4] = {f0.col(0).dot(c0.col(0)) - e.gamma, c0.cwiseProduct(f1).sum(), c1.cwiseProduct(f0).sum(),
                         f1.col(0).dot(c1.col(0))};
    for (int p = 0; p < 4; ++p) {
      for (int q = 1; q < 4; ++q) derivative[p + q - 1] += double(e.l) * j[p] * q * j[q];
    }
  }
  const auto slope = [&](double a) {
    double sum = 0;
    for (int k = 5; k >= 0; --k) sum = sum * a + derivative[k];
    return sum;
  };
  if (!(slope(0) < 0)) return;
  double low = 0, high = most;
  if (slope(most) <= 0) {
    low = most;
  } else {
    for (int i = 0; i < 20; ++i) (slope(0.5 * (low + high)) < 0 ? low : high) = 0.5 * (low + high);
  }
  for (size_t i = 0; i < body.node.size(); ++i) body.node[i] += float(low) * direction[i];
}

// Sub-steps of a crash resemble one another: start from the last displacement, as much of it as lowers the energy.
// Nodes in contact go where the obstacle takes them first.
void predict(const Model& model, float share, Scratch& scratch, Body& body) {
  for (Vec3& step : body.step) step *= share;
  for (const Contact& contact : scratch.contacts) {
    Vec3& position = body.node[contact.node];
    position += std::max(0.0f, contact.offset - contact.normal.dot(position)) * contact.normal;
    body.step[contact.node].setZero();
  }
  search_line(model, body.step, 1, scratch, body);
}

// What the last pair of sweeps did to the free nodes, once more, as far as it lowers the energy: slow, long waves of the error
// move on in the same direction. For a tenth of a sweep more it halves what 8 or 16 sweeps leave undone (energy missing from a
// 48 km/h crash: 5.8 instead of 8.2 %, 1.7 instead of 3.4 %).
void extrapolate(const Model& model, Scratch& scratch, Body& body) {
  for (size_t i = 0; i < body.node.size(); ++i) {
    if (scratch.contact_first[i] > 0 || model.node_anchored[i]) {
      scratch.direction[i].setZero();
    } else {
      scratch.direction[i] = body.node[i] - scratch.pair_start[i];
    }
  }
  search_line(model, scratch.direction, 2, scratch, body);
}

// What each tet looks like to the next sweep: its F, and its secant moduli times its volume.
void renew_stiffness(const Model& model, const Parameters& parameters, Scratch& scratch, const Body& body) {
  Elastic moduli[region_limit];
  YieldLaw laws[region_limit];
  for (int r = 0; r < region_limit; ++r) {
    moduli[r] = elastic(parameters.region[r]);
    laws[r] = yield_law(parameters.region[r]);
  }
  for (uint32_t tet = 0; tet < model.tet.size(); ++tet) {
    const int region = model.tet_region[tet];
    scratch.deformation[tet] = tet_deformation(model, body, tet);
    const Elastic e = secant(moduli[region], laws[region], scratch.deformation[tet], body.hardening[tet]);
    const float volume = model.tet_rest[tet];
    scratch.stiffness[tet] = {e.mu * volume, e.l * volume, e.gamma};
  }
}

// The gradient left on a node that contacts hold is their force; friction no more than the cone allows.
void measure_forces(const Model& model, Scratch& scratch, const Body& body) {
  for (size_t k = 0; k < scratch.contacts.size(); ++k) {
    const Contact& contact = scratch.contacts[k];
    Held& held = scratch.held[k];
    held.force.setZero();
    if (!held.active) continue;
    Vec3 force = node_block(model, scratch, body, contact.node).gradient;
    int planes = 0;
    for (size_t i = scratch.contact_first[contact.node] - 1; i < scratch.contacts.size(); ++i) {
      if (scratch.contacts[i].node != contact.node) break;
      planes += scratch.held[i].active;
    }
    if (planes > 1) {  // share it: each plane takes what lies along its normal
      held.force = std::max(0.0f, contact.normal.dot(force)) / float(planes) * contact.normal;
      continue;
    }
    const float normal_force = std::max(0.0f, contact.normal.dot(force));
    Vec3 tangential = force - contact.normal.dot(force) * contact.normal;
    const float size = tangential.norm(), most = contact.friction * normal_force;
    if (size > most) tangential *= most / size;
    held.force = normal_force * contact.normal + tangential;
  }
}

// Springs for the anchored nodes that obstacles reach; together at most `most` N/m.
void stiffen_anchors(const Model& model, const Parameters& parameters, float most, Scratch& scratch) {
  float sum = 0;
  for (const Contact& contact : scratch.contacts) {
    const uint32_t node = contact.node;
    if (!model.node_anchored[node] || scratch.anchor[node] > 0) continue;
    for (uint32_t k = model.node_first[node]; k < model.node_first[node + 1]; ++k) {
      const uint32_t tet = model.corner[k] / 4;
      const float squared = corner_gradient(model.gradients[tet], model.corner[k] % 4).squaredNorm();
      scratch.anchor[node] +=
          anchor_ratio * parameters.region[model.tet_region[tet]].young_modulus * model.tet_rest[tet] * squared;
    }
    sum += scratch.anchor[node];
  }
  if (!(sum > most)) return;
  for (const Contact& contact : scratch.contacts) {
    if (scratch.contact_first[contact.node] != uint32_t(&contact - scratch.contacts.data()) + 1) continue;  // once a node
    scratch.anchor[contact.node] *= most / sum;
  }
}

}  // namespace

void solve_nodal(const Model& model, const Parameters& parameters, double mass, float h, float share, Scratch& scratch,
                 Body& body) {
  const uint32_t count = uint32_t(body.node.size());
  for (uint32_t node = 0; node < count; ++node) {
    const Material& material = parameters.region[model.node_region[node]];
    scratch.drag[node] = material.viscosity * model.node_mass[node] / model.mass * scratch.volume / h;
    scratch.anchor[node] = 0;
  }
  renew_stiffness(model, parameters, scratch, body);
  stiffen_anchors(model, parameters, anchor_share * float(mass) / (h * h), scratch);
  predict(model, share, scratch, body);
  for (int sweep = 0; sweep < parameters.iterations; ++sweep) {
    renew_stiffness(model, parameters, scratch, body);
    if (sweep % 2 == 0) {
      if (sweep > 0) extrapolate(model, scratch, body);
      std::copy(body.node.begin(), body.node.end(), scratch.pair_start.begin());
    }
    if (sweep % 2 == 0) {
      for (uint32_t node = 0; node < count; ++node) visit(model, scratch, body, node);
    } else {
      for (uint32_t node = count; node-- > 0;) visit(model, scratch, body, node);
    }
  }
  renew_stiffness(model, parameters, scratch, body);
  measure_forces(model, scratch, body);
}

}  // namespace crumple

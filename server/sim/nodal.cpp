#include "sim/nodal.h"

#include <Eigen/Dense>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <span>

#include "sim/flow.h"
#include "sim/rest.h"
#include "sim/substeps.h"

namespace crumple {
namespace {

Vec3 vec(const Float4& q) { return {q.x, q.y, q.z}; }
Float4 float4(const Vec3& v, float w) { return {v.x(), v.y(), v.z(), w}; }

// The energy as a quadratic in one node: gradient . d + d^T hessian d / 2.
struct Block {
  Vec3 gradient;
  Mat3 hessian;
};

// Between cars: the last two sweeps must have changed the pressures by no more than this share (rms).
constexpr double pressed_share = 0.02;
// Stiffness of a contact between cars, as a share of what its nodes have.
constexpr float pair_softness = 0.5f;

// Planes push a node at most this many times as far as the deepest of them. Two planes at a sharp angle would otherwise send it
// to where they meet, far from the car.
constexpr float farthest_push = 5;

// A node in contact: its quadratic, its position, and where it would go without contacts.
struct NodeProblem {
  const Contact* contacts;
  int count;  // of contacts
  const Block& block;
  Mat3 inverse;  // of the hessian
  Vec3 position, free;
};

// Finds the lowest point of the quadratic on the planes `active` of this node's contacts, and their multipliers, N. Returns
// false if a multiplier is negative, another plane is violated, or the point is too far.
bool solve_active_set(const NodeProblem& problem, unsigned active, Vec3& out, Vec3& multiplier) {
  const auto& [contacts, count, block, inverse, position, free] = problem;
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
  if (size > 1 && (out - free).squaredNorm() > farthest_push * farthest_push * gap.cwiseAbs2().maxCoeff()) return false;
  for (int i = 0; i < count; ++i) {
    if (!(active >> i & 1) && contacts[i].normal.dot(out) < contacts[i].offset - 1e-6f) return false;
  }
  return true;
}

// A node on one plane with Coulomb friction. It sticks to the obstacle if the force that holds it lies in the cone; otherwise
// it slides against a force on the cone.
Vec3 solve_friction(const NodeProblem& problem, const Contact& contact, const Vec3& frictionless, float multiplier) {
  const auto& [contacts, count, block, inverse, position, free] = problem;
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

Block block_of(const float gradient[3], const float h[6]) {
  Block block;
  block.gradient = {gradient[0], gradient[1], gradient[2]};
  block.hessian << h[0], h[3], h[4], h[3], h[1], h[5], h[4], h[5], h[2];
  return block;
}

// Context for the functions that the kernels call for a node in contact.
struct Touch {
  const ContactSet& contacts;
  const PairIndex* pairs;
  std::span<const PairContact> pair_contacts;
  NodalSolver& solver;
};

// Calls visit(contact, entry) for the contacts with other cars in which the node takes part.
template <class Visit>
void for_each_pair(const Touch& touch, uint32_t node, const Visit& visit) {
  if (!touch.pairs) return;
  for (uint32_t k = touch.pairs->first[node]; k < touch.pairs->first[node + 1]; ++k) {
    const PairIndex::Entry& entry = touch.pairs->entry[k];
    visit(touch.pair_contacts[entry.contact], entry.which);
  }
}

// Adds what contacts with other cars contribute to a node's quadratic. Both cars move in the same sweep and neither sees the
// other move, so each counts its own way twice: (g + a + b)^2 <= (g + 2a)^2 / 2 + (g + 2b)^2 / 2, and the sum still descends.
void add_pairs(const Touch& touch, uint32_t node, Block& block) {
  const std::vector<Float4>& now = touch.solver.node;
  for_each_pair(touch, node, [&](const PairContact& contact, uint32_t which) {
    const bool own = which == PairIndex::own;
    Vec3 at = contact.seen_node, point = contact.seen_point;
    if (own) {
      at = 2 * vec(now[node]) - at;
    } else {
      point = -point;
      for (int k = 0; k < 3; ++k) point += 2 * contact.weight[k] * vec(now[contact.corner[k]]);
    }
    const PairForce force = pair_force(contact, at, point);
    if (!(force.normal > 0)) return;
    const float weight = own ? 1 : -contact.weight[which];
    const Vec3& normal = own ? contact.own_normal : contact.normal;
    const Vec3 friction = own ? Vec3(contact.rotation.transpose() * force.friction) : force.friction;
    block.gradient -= weight * (force.normal * normal + friction);
    const float both = 2 * weight * weight;
    block.hessian += both * (contact.stiffness - force.stick) * normal * normal.transpose();
    block.hessian.diagonal().array() += both * force.stick;
  });
}

// Keeps how stiff a node is that touches another car.
void note_stiffness(void* context, uint32_t node, const float[3], const float hessian[6]) {
  static_cast<const Touch*>(context)->solver.pair_stiffness[node] = (hessian[0] + hessian[1] + hessian[2]) / 3;
}

// Moves a node that an obstacle or a car may hold to the lowest point of its quadratic outside the obstacles.
void resolve(void* context, uint32_t node, const float gradient[3], const float hessian[6]) {
  const Touch& touch = *static_cast<const Touch*>(context);
  const ContactSet& all = touch.contacts;
  NodalSolver& solver = touch.solver;
  Block block = block_of(gradient, hessian);
  add_pairs(touch, node, block);
  const auto move_to = [&](const Vec3& target) { solver.node[node] = float4(target, 0); };
  if (!all.holds(node)) return move_to(vec(solver.node[node]) - block.hessian.inverse() * block.gradient);
  const uint32_t first = all.first[node] - 1;
  const Contact* contacts = &all.contact[first];
  int count = 1;
  while (first + count < all.contact.size() && contacts[count].node == node) ++count;
  ContactForce* held = &solver.contact_forces[first];
  for (int i = 0; i < count; ++i) held[i].active = false;

  const Mat3 inverse = block.hessian.inverse();
  const Vec3 position = vec(solver.node[node]);
  const Vec3 free = position - inverse * block.gradient;
  const NodeProblem problem{contacts, count, block, inverse, position, free};
  bool clear = true;
  for (int i = 0; i < count; ++i) clear = clear && contacts[i].normal.dot(free) >= contacts[i].offset;
  if (clear) return move_to(free);
  // There are at most three planes: try every set, small ones first.
  static constexpr unsigned sets[] = {1, 2, 4, 3, 5, 6, 7};
  Vec3 target, multiplier;
  for (unsigned set : sets) {
    if (set >> count) continue;
    if (!solve_active_set(problem, set, target, multiplier)) continue;
    for (int i = 0; i < count; ++i) held[i].active = set >> i & 1;
    if ((set & (set - 1)) == 0) {
      const int only = set == 1 ? 0 : set == 2 ? 1 : 2;
      const Vec3 with_friction = solve_friction(problem, contacts[only], target, multiplier[only]);
      bool inside = false;
      for (int i = 0; i < count; ++i) inside = inside || contacts[i].normal.dot(with_friction) < contacts[i].offset - 1e-6f;
      if (!inside) target = with_friction;
    }
    return move_to(target);
  }
  // The planes leave no room (a car between two closing walls): the deepest one wins.
  move_to(free + (contacts[0].offset - contacts[0].normal.dot(free)) * contacts[0].normal);
  held[0].active = true;
}

// Divides the force on a node among several planes, each pressing along its normal. Returns false if that is impossible: the
// planes are nearly parallel, or one of them would have to pull.
bool press_together(const Vec3& force, std::span<const Contact> contacts, std::span<ContactForce> held) {
  size_t at[contacts_per_node];
  int count = 0;
  for (size_t k = 0; k < contacts.size() && count < int(contacts_per_node); ++k) {
    if (held[k].active) at[count++] = k;
  }
  Mat3 products = Mat3::Identity();
  Vec3 normal_force = Vec3::Zero();
  for (int i = 0; i < count; ++i) {
    const Vec3& normal = contacts[at[i]].normal;
    normal_force[i] = normal.dot(force);
    for (int k = 0; k < count; ++k) products(i, k) = normal.dot(contacts[at[k]].normal);
  }
  if (!(products.determinant() > 1e-4f)) return false;
  const Vec3 multiplier = products.inverse() * normal_force;
  if ((multiplier.array() < 0).any()) return false;
  for (int i = 0; i < count; ++i) held[at[i]].force = multiplier[i] * contacts[at[i]].normal;
  return true;
}

// The gradient that remains on a node in contact is the contact force. Friction is limited by the cone.
void measure(void* context, uint32_t node, const float gradient[3], const float[6]) {
  const Touch& touch = *static_cast<const Touch*>(context);
  const ContactSet& all = touch.contacts;
  NodalSolver& solver = touch.solver;
  if (!all.holds(node)) return;
  Block block{{gradient[0], gradient[1], gradient[2]}, Mat3::Zero()};
  add_pairs(touch, node, block);
  const Vec3 force = block.gradient;
  const size_t first = all.first[node] - 1;
  size_t last = first;
  int planes = 0;
  Vec3 shares = Vec3::Zero();  // sum over the planes of the force's part along each normal
  for (; last < all.contact.size() && all.contact[last].node == node; ++last) {
    if (!solver.contact_forces[last].active) continue;
    const Vec3& normal = all.contact[last].normal;
    shares += std::max(0.0f, normal.dot(force)) * normal;
    ++planes;
  }
  const std::span<const Contact> own = std::span(all.contact).subspan(first, last - first);
  if (planes > 1 && press_together(force, own, std::span(solver.contact_forces).subspan(first, last - first))) return;
  for (size_t k = first; k < last; ++k) {
    const Contact& contact = all.contact[k];
    ContactForce& held = solver.contact_forces[k];
    held.force.setZero();
    if (!held.active) continue;
    const float normal_force = std::max(0.0f, contact.normal.dot(force));
    if (planes > 1) {  // scaled so that all planes together give the force, however they lie to each other
      held.force = normal_force * force.dot(shares) / std::max(shares.squaredNorm(), 1e-20f) * contact.normal;
      continue;
    }
    Vec3 tangential = force - contact.normal.dot(force) * contact.normal;
    const float size = tangential.norm(), most = contact.friction * normal_force;
    if (size > most) tangential *= most / size;
    held.force = normal_force * contact.normal + tangential;
  }
}

NodeView node_view(NodalSolver& solver, Touch& touch) {
  const Blocks& blocks = solver.active.blocks;
  return {.node = solver.node.data(),
          .before = solver.before.data(),
          .rest = solver.rest.data(),
          .stiffness = solver.stiffness.data(),
          .index = blocks.node.data(),
          .row = blocks.row.data(),
          .anchored = blocks.anchored.data(),
          .rows = blocks.rows.data(),
          .weights = blocks.weights.data(),
          .still = solver.active.still.data(),
          .touched = solver.active.touched.data(),
          .relaxation = relaxation,
          .measure = false,
          .resolve = resolve,
          .context = &touch};
}

TetView tet_view(const SweepOrder& order, const NodalSolver& solver) {
  return {.node = solver.node.data(),
          .group = order.group.data(),
          .tet = solver.tets.data(),
          .region = solver.region.data(),
          .law = solver.law.data(),
          .stirred = solver.active.stirred.data()};
}

// Size of a piece of work: a microsecond or two.
constexpr uint32_t blocks_at_once = 2, groups_at_once = 64;

// Calls work(first, last, sums) on all groups of tets.
template <size_t Count, class Work>
std::array<double, Count> sum_over_groups(const SweepOrder& order, NodalSolver& solver, const Work& work) {
  return solver.team->sum<Count>(uint32_t(order.group.size()), groups_at_once, work);
}

// Returns how many tets have lost their shape.
double update_stiffness(const SweepOrder& order, NodalSolver& solver) {
  const TetView view = tet_view(order, solver);
  return sum_over_groups<1>(order, solver, [&](uint32_t first, uint32_t last, double* sum) {
    sum[0] = kernels().update_secant_moduli(view, first, last, solver.stiffness.data(), solver.flowing.data());
  })[0];
}

// Moves all nodes along solver.direction by the factor in [0, 1] that lowers the energy most. Along the line the energy is a
// polynomial of degree six, so one pass over the tets finds its minimum.
void search_line(const SweepOrder& order, NodalSolver& solver) {
  double derivative[6] = {};  // of the energy at factor a: sum derivative[k] a^k
  for (size_t i = 0; i < solver.node.size(); ++i) {
    const Vec3 direction = vec(solver.direction[i]), position = vec(solver.node[i]);
    const float drag = solver.before[i].w, anchor = solver.rest[i].w;
    const Vec3 pull = drag * (position - vec(solver.before[i])) + anchor * (position - vec(solver.rest[i]));
    derivative[1] += double((drag + anchor) * direction.squaredNorm());
    derivative[0] += double(direction.dot(pull));
  }
  const TetView view = tet_view(order, solver);
  const auto elastic = sum_over_groups<6>(order, solver, [&](uint32_t first, uint32_t last, double* sum) {
    kernels().line_derivative(view, first, last, solver.stiffness.data(), solver.direction.data(), sum);
  });
  for (int k = 0; k < 6; ++k) derivative[k] += elastic[k];
  const auto slope = [&](double a) {
    double sum = 0;
    for (int k = 5; k >= 0; --k) sum = sum * a + derivative[k];
    return sum;
  };
  if (!(slope(0) < 0)) return;
  double low = 0, high = 1;
  if (slope(1) <= 0) {
    low = 1;
  } else {
    for (int i = 0; i < 20; ++i) (slope(0.5 * (low + high)) < 0 ? low : high) = 0.5 * (low + high);
  }
  for (size_t i = 0; i < solver.node.size(); ++i) {
    solver.node[i] = float4(vec(solver.node[i]) + float(low) * vec(solver.direction[i]), 0);
  }
}

// Sub-steps of a crash resemble one another: the direction in which to start is the last displacement. First move nodes in
// contact out of their obstacles, and nodes that touch other cars on as in the last sub-step.
void aim(const NodalPart& part) {
  const auto& [input, all, pairs, share, solver, body, lost, stats] = part;
  const std::span<const Contact> contacts = all.contact;
  std::fill(solver.direction.begin(), solver.direction.end(), Float4{});
  for (const uint32_t i : solver.active.node) solver.direction[i] = float4(share * body.step[i], 0);
  for (const Contact& contact : contacts) {
    const Vec3 position = vec(solver.node[contact.node]);
    const float depth = std::max(0.0f, contact.offset - contact.normal.dot(position));
    solver.node[contact.node] = float4(position + depth * contact.normal, 0);
    solver.direction[contact.node] = {};
  }
  if (!pairs) return;
  for (const uint32_t node : pairs->node) {
    if (!all.holds(node)) solver.node[node] = float4(vec(solver.node[node]) + share * body.step[node], 0);
    solver.direction[node] = {};
  }
}

Vec3 point_of(const PairContact& contact, const NodalSolver& solver) {
  Vec3 sum = Vec3::Zero();
  for (int k = 0; k < 3; ++k) sum += contact.weight[k] * vec(solver.node[contact.corner[k]]);
  return sum;
}

// Moves the surfaces of two cars apart by equal ways where they overlap.
void part_surfaces(std::span<const NodalPart> parts, std::span<const PairContact> contacts) {
  for (const PairContact& contact : contacts) {
    NodalSolver &first = parts[contact.car[0]].solver, &second = parts[contact.car[1]].solver;
    const float gap = contact.gap(vec(first.node[contact.node]), point_of(contact, second));
    if (gap >= 0) continue;
    const float squares = 1 + contact.weight.squaredNorm();
    first.node[contact.node] = float4(vec(first.node[contact.node]) - gap / squares * contact.own_normal, 0);
    for (int k = 0; k < 3; ++k) {
      Float4& corner = second.node[contact.corner[k]];
      corner = float4(vec(corner) + gap * contact.weight[k] / squares * contact.normal, 0);
    }
  }
}

// The acceleration also moves sleeping nodes: puts them back.
void keep_still(NodalSolver& solver) {
  for (size_t i = 0; i < solver.active.awake.size(); ++i) {
    if (!solver.active.awake[i]) solver.node[i] = solver.step_start[i];
  }
}

// Calls visit(node) once for each node that an obstacle or another car may hold, and for each loose anchored one.
template <class Visit>
void for_each_touched(const ContactSet& contacts, const PairIndex* pairs, const Visit& visit) {
  for (const Contact& contact : contacts.contact) {
    if (contacts.is_first(contact)) visit(contact.node);
  }
  for (const uint32_t node : contacts.loose) visit(node);
  if (!pairs) return;
  for (const uint32_t node : pairs->node) {
    if (!contacts.holds(node)) visit(node);
  }
}

// Attaches springs to the anchored nodes that obstacles or cars reach or have reached; all springs together have at most the
// stiffness `most`, N/m.
void stiffen_anchors(const Model& model, const Parameters& parameters, float most, const ContactSet& contacts,
                     const PairIndex* pairs, NodalSolver& solver) {
  for (size_t i = 0; i < model.node.size(); ++i) solver.rest[i] = float4(model.node[i], 0);
  float sum = 0;
  for_each_touched(contacts, pairs, [&](uint32_t node) {
    float& spring = solver.rest[node].w;
    if (!model.node_anchored[node]) return;
    for (uint32_t k = model.node_first[node]; k < model.node_first[node + 1]; ++k) {
      const uint32_t tet = model.corner[k] / 4, corner = model.corner[k] % 4;
      const auto& g = model.gradients[tet].corner;
      const float squared = corner > 0 ? g[corner - 1].squaredNorm() : (g[0] + g[1] + g[2]).squaredNorm();
      spring += anchor_ratio * parameters.region[model.tet_region[tet]].young_modulus * model.tet_rest[tet] * squared;
    }
    sum += spring;
  });
  if (!(sum > most)) return;
  for_each_touched(contacts, pairs, [&](uint32_t node) { solver.rest[node].w *= most / sum; });
}

// Writes the dot products of a tet's gradients to its four corners.
void weigh_tet(const DeformableState& body, const SweepOrder& order, uint32_t t, NodalSolver& solver) {
  const auto& g = body.gradients[t].corner;
  const Vec3 first = -g[0] - g[1] - g[2];
  const float d01 = first.dot(g[0]), d02 = first.dot(g[1]), d03 = first.dot(g[2]);
  const float d12 = g[0].dot(g[1]), d13 = g[0].dot(g[2]), d23 = g[1].dot(g[2]);
  const float weight[4][3] = {{d01, d02, d03}, {d01, d13, d12}, {d23, d02, d12}, {d23, d13, d03}};  // in the order of Row
  for (int corner = 0; corner < 4; ++corner) {
    std::copy_n(weight[corner], 3, solver.weights[order.slot[4 * t + corner]].other);
  }
}

// The length of a gradient is one over the height above the opposite face.
bool thin(const Gradients& gradients) {
  const auto& g = gradients.corner;
  const float steepest =
      std::max({g[0].squaredNorm(), g[1].squaredNorm(), g[2].squaredNorm(), (g[0] + g[1] + g[2]).squaredNorm()});
  return steepest * thinnest * thinnest > 1;
}

// Copies the flowed tets of a group to the body, and their dot products to the corners.
void take_flow(const SweepOrder& order, uint32_t group, NodalSolver& solver, DeformableState& body) {
  if (!solver.active.stirred[group]) return;
  const TetLanes& tet = solver.tets[group];
  for (unsigned left = solver.flowing[group]; left != 0; left &= left - 1) {
    const uint32_t lane = uint32_t(std::countr_zero(left)), t = lanes * group + lane;
    for (int k = 0; k < 9; ++k) body.gradients[t].corner[k / 3][k % 3] = tet.gradient[k][lane];
    body.hardening[t] = tet.kappa[lane];
    weigh_tet(body, order, t, solver);
  }
}

// Squared way of all nodes in this sub-step, m^2. Each awake node counts for at least the way at which it would be at rest.
double way_size(float quiet, const NodalSolver& solver) {
  double sum = double(solver.active.node.size()) * double(quiet * quiet);
  for (const uint32_t i : solver.active.node) {
    sum += double((vec(solver.node[i]) - vec(solver.before[i])).squaredNorm());
  }
  return sum;
}

// Stirs what is awake, and packs it.
void gather(const Model& model, const DeformableState& body, NodalSolver& solver) {
  stir(model, solver.seeds, solver.active);
  load_stirred(model, body, solver);
  pack(model, solver.seeds, solver.weights, solver.active);
}

// Whether the body is as it was made. Another one that was never solved may be out of equilibrium anywhere, for it was loaded,
// comes from another level, or has a new material.
bool is_undamaged(const Model& model, const DeformableState& body) {
  const auto same = [](const auto& list, const auto& other) {
    return std::memcmp(list.data(), other.data(), list.size() * sizeof list[0]) == 0;
  };
  return same(body.node, model.node) && same(body.gradients, model.gradients);
}

// Chooses the nodes to solve. All of them if the body's shape was lost, loaded, repaired or just released.
void choose_active(const NodalPart& part, float quiet, bool held) {
  const Model& model = part.input.model;
  NodalSolver& solver = part.solver;
  const DeformableState& body = part.body;
  solver.seeds.touched.clear();
  for_each_touched(part.contacts, part.pairs, [&](uint32_t node) { solver.seeds.touched.push_back(node); });
  const float last_quiet = quiet / part.share;  // of the last sub-step, which may have been longer or shorter
  const bool moved = std::any_of(body.step.begin(), body.step.end(),
                                 [&](const Vec3& step) { return step.squaredNorm() > last_quiet * last_quiet; });
  const bool unknown = body.step_seconds == 0 && (body.stored != 0 || !is_undamaged(model, body));
  if (body.lost || unknown || part.input.parameters.tolerance == 0 || (!moved && (!held || !body.settled))) {
    wake_all(model, solver.seeds, solver.active);
  } else {
    wake(model, solver.seeds, body.step, last_quiet, solver.active);
  }
  gather(model, body, solver);
}

// A body that has lost its shape (a foreign state, or a shape that no crash makes) first springs back to its last sound shape.
// Nothing flows until it has come to rest, or is sound again and an obstacle holds it: flow would keep the wrong shape. lost:
// how many of the tets have lost their shape. Returns whether flow is suspended.
bool suspend_flow(double lost, size_t tets, bool held, NodalSolver& solver, DeformableState& body) {
  if (lost > lost_share * double(tets)) body.lost = true;
  if (lost == 0 && held) body.lost = false;
  for (Law& law : solver.law) law.room = body.lost ? 0.0f : law.limit;
  if (body.lost) std::fill(solver.flowing.begin(), solver.flowing.end(), uint16_t(0xffff));
  return body.lost;
}

// Prepares a car for a sub-step of h seconds: drag, springs, what is awake, and where to start.
void begin_part(NodalPart& part, float h) {
  const auto& [input, contacts, pairs, share, solver, body, lost, stats] = part;
  const Model& model = input.model;
  solver.seeds.placed.clear();
  for (uint32_t i = 0; i < body.node.size(); ++i) {
    if (vec(solver.node[i]) != body.node[i]) solver.seeds.placed.push_back(i);
  }
  stir(model, solver.seeds, solver.active);
  load_stirred(model, body, solver);  // where the placed nodes were
  for (uint32_t i = 0; i < body.node.size(); ++i) {
    const Material& material = input.parameters.region[model.node_region[i]];
    const float drag = material.drag * model.node_mass[i] / model.mass * float(solver.volume) / h;
    solver.before[i] = float4(body.node[i], drag);
    solver.node[i] = float4(body.node[i], 0);
  }
  const float whole = std::max(h, float(substep_seconds(input.parameters)));
  stiffen_anchors(model, input.parameters, anchor_share * float(input.mass.mass) / (whole * whole), contacts, pairs, solver);
  const bool held = !contacts.contact.empty() || pairs;
  choose_active(part, settle_speed * h, held);
  part.lost = update_stiffness(*model.order, solver);
  if (suspend_flow(part.lost, model.tet.size(), held, solver, body)) {
    choose_active(part, settle_speed * h, held);
    part.lost = update_stiffness(*model.order, solver);
  }
  solver.contact_forces.assign(contacts.contact.size(), ContactForce{});
  if (!pairs && !body.pairs.touch.empty()) body.history = {};  // it has pressures of a car that is gone
  aim(part);
}

// Chooses the stiffness of contacts between cars: half as stiff as their nodes are now, yield included. As stiff as they are,
// or stiffer, cars that still move on when the sweeps end are crushed less and bounce less (crumple_pairs).
void stiffen_pairs(std::span<NodalPart> parts, std::span<NodeView> views, std::span<PairContact> contacts) {
  if (contacts.empty()) return;
  for (size_t k = 0; k < parts.size(); ++k) {
    const NodalPart& part = parts[k];
    part.solver.pair_stiffness.resize(part.solver.node.size());
    NodeView view = views[k];
    view.measure = true;
    view.resolve = note_stiffness;
    kernels().relax_nodes(view, 0, uint32_t(part.solver.active.touched.size()));
  }
  for (PairContact& contact : contacts) {
    const auto &first = parts[contact.car[0]].solver.pair_stiffness, &second = parts[contact.car[1]].solver.pair_stiffness;
    float compliance = 1 / first[contact.node];
    for (int k = 0; k < 3; ++k) compliance += contact.weight[k] * contact.weight[k] / second[contact.corner[k]];
    contact.stiffness = pair_softness / compliance;
    contact.start_pressure = contact.pressure;
  }
}

// One sweep over each car, all cars side by side.
void sweep(std::span<const NodalPart> parts, std::span<const NodeView> views, std::span<PairContact> contacts) {
  for (PairContact& contact : contacts) {
    contact.seen_node = vec(parts[contact.car[0]].solver.node[contact.node]);
    contact.seen_point = point_of(contact, parts[contact.car[1]].solver);
  }
  size_t colours = 0;
  for (const NodalPart& part : parts) colours = std::max(colours, part.solver.active.blocks.colour.size() - 1);
  for (size_t c = 0; c < colours; ++c) {
    // The blocks of this colour, of one car after the other.
    const auto visit = [&](uint32_t first, uint32_t last, const auto& work) {
      uint32_t begin = 0;
      for (size_t k = 0; k < parts.size(); ++k) {
        const std::vector<uint32_t>& colour = parts[k].solver.active.blocks.colour;
        const uint32_t size = c + 1 < colour.size() ? colour[c + 1] - colour[c] : 0, end = begin + size;
        if (first < end && last > begin) {
          work(k, colour[c] + std::max(first, begin) - begin, colour[c] + std::min(last, end) - begin);
        }
        begin = end;
      }
      return begin;
    };
    const uint32_t all = visit(0, 0, [](size_t, uint32_t, uint32_t) {});
    parts.front().solver.team->run(0, all, blocks_at_once, [&](uint32_t first, uint32_t last) {
      visit(first, last, [&](size_t k, uint32_t from, uint32_t to) { kernels().relax_nodes(views[k], from, to); });
    });
  }
}

// The w of a node that touches another car is the pressure of its contact as a length, pressure / stiffness. So the
// acceleration mixes pressures with positions, and the residual has both.
float& pressed_depth(std::span<NodalPart> parts, const PairContact& contact) {
  return parts[contact.car[0]].solver.node[contact.node].w;
}

// Before a solver step.
void write_pressures(std::span<NodalPart> parts, std::span<const PairContact> contacts) {
  if (contacts.empty()) return;
  for (NodalPart& part : parts) {
    for (Float4& node : part.solver.node) node.w = 0;
  }
  for (const PairContact& contact : contacts) pressed_depth(parts, contact) = contact.pressure / contact.stiffness;
}

// After the sweeps of a step: moves what they left of the gaps into the pressures. Returns the rms change of the pressures as a
// share of what they are, or were when the sub-step began if that is more.
double press_pairs(std::span<NodalPart> parts, std::span<PairContact> contacts) {
  double change = 0, now = 0, start = 0;  // N^2
  for (PairContact& contact : contacts) {
    const Vec3 node = vec(parts[contact.car[0]].solver.node[contact.node]);
    const PairForce force = pair_force(contact, node, point_of(contact, parts[contact.car[1]].solver));
    pressed_depth(parts, contact) = force.normal / contact.stiffness;
    change += double(force.normal - contact.pressure) * double(force.normal - contact.pressure);
    now += double(force.normal) * double(force.normal);
    start += double(contact.start_pressure) * double(contact.start_pressure);
  }
  return change > 0 ? std::sqrt(change / std::max(now, start)) : 0;
}

// After a step that was not undone: the friction of its pressures before read_pressures().
void rub_pairs(std::span<const NodalPart> parts, std::span<PairContact> contacts) {
  for (PairContact& contact : contacts) {
    const Vec3 node = vec(parts[contact.car[0]].solver.node[contact.node]);
    contact.rub = pair_force(contact, node, point_of(contact, parts[contact.car[1]].solver)).friction;
  }
}

// After the acceleration has undone a step or mixed it with others.
void read_pressures(std::span<NodalPart> parts, std::span<PairContact> contacts) {
  for (PairContact& contact : contacts) contact.pressure = std::max(0.0f, pressed_depth(parts, contact) * contact.stiffness);
}

// After the last sweep, which moved nothing: the forces between cars.
void measure_pairs(std::span<PairContact> contacts) {
  for (PairContact& contact : contacts) {
    const PairForce force = pair_force(contact, contact.seen_node, contact.seen_point);
    contact.pressed = force.normal;
    contact.force = force.normal * contact.normal + force.friction;
    const Vec3 slip = contact.slip(contact.seen_node, contact.seen_point);
    contact.heat = std::max(0.0f, -0.5f * (contact.start_rub + force.friction).dot(slip));
  }
}

// Whether the last solver step moved the car's nodes so little that the sub-step is solved.
bool is_solved(NodalPart& part, float h) {
  const double enough = double(part.input.parameters.tolerance) * double(part.input.parameters.tolerance);
  const AndersonStep& last = part.solver.last_step;
  const double mean = last.residual_size / double(std::max<size_t>(1, part.solver.active.node.size()));
  part.stats.residual = std::sqrt(float(mean));
  if (!last.compared || mean > enough) return false;
  return last.residual_size <= small_share * small_share * way_size(settle_speed * h, part.solver);
}

}  // namespace

void prepare_nodal(const Model& model, const Parameters& parameters, const DeformableState& body, Team& team,
                   NodalSolver& solver) {
  solver.team = &team;
  const SweepOrder& order = *model.order;
  const size_t n = model.node.size(), t = model.tet.size(), padded = lanes * order.group.size();
  static_assert(lanes == 16);
  for (auto* list : {&solver.node, &solver.before, &solver.rest, &solver.direction}) {
    list->assign(padded_nodes(n), Float4{});
  }
  solver.before[n].w = 1;  // unused lanes must not divide by zero
  solver.stiffness.assign(padded + 1, Float4{});
  solver.tets.resize(order.group.size());
  solver.weights.resize(4 * t);
  solver.flowing.resize(order.group.size());
  solver.energy.resize(order.group.size());
  solver.loaded.assign(order.group.size(), 0);
  solver.active.awake.assign(n, 0);
  solver.active.whole = false;
  for (size_t i = 0; i < n; ++i) solver.node[i] = float4(body.node[i], 0);
  solver.volume = 0;
  for (uint32_t i = 0; i < t; ++i) solver.volume += double(model.tet_rest[i]);
  solver.law.resize(region_limit);
  solver.yield.resize(region_limit);
  for (int r = 0; r < region_limit; ++r) {
    const Elastic e = elastic(parameters.region[r]);
    const YieldLaw& y = solver.yield[r] = yield_law(parameters.region[r]);
    solver.law[r] = {e.mu, e.l, e.gamma, y.shear, y.bulk, y.start, y.slope, y.fold, y.dense, y.dense_from, y.limit, y.limit};
  }
  uint8_t same[region_limit];  // the first region with the same law, so that most groups of tets have one law
  for (int r = 0; r < region_limit; ++r) {
    same[r] = uint8_t(std::find(solver.law.begin(), solver.law.begin() + r, solver.law[r]) - solver.law.begin());
  }
  solver.region.assign(padded, same[model.tet_region[t - 1]]);
  for (uint32_t i = 0; i < t; ++i) solver.region[i] = same[model.tet_region[i]];
}

void load_stirred(const Model& model, const DeformableState& body, NodalSolver& solver) {
  const SweepOrder& order = *model.order;
  const uint32_t count = uint32_t(model.tet.size());
  const TetView view = tet_view(order, solver);
  for (uint32_t group = 0; group < solver.loaded.size(); ++group) {
    if (solver.loaded[group] || !solver.active.stirred[group]) continue;
    solver.loaded[group] = 1;
    solver.flowing[group] = 0xffff;
    TetLanes& tet = solver.tets[group] = {};
    for (uint32_t t = lanes * group; t < std::min(count, lanes * (group + 1)); ++t) {
      const uint32_t lane = t % lanes;
      for (int k = 0; k < 9; ++k) tet.gradient[k][lane] = body.gradients[t].corner[k / 3][k % 3];
      tet.kappa[lane] = thin(model.gradients[t]) ? solver.law[model.tet_region[t]].limit : body.hardening[t];
      tet.volume[lane] = model.tet_rest[t];
      const float ratio = volume_ratio(model.tet_rest[t], body.gradients[t]);
      tet.yield[lane] = yield_stress(crushed(solver.yield[model.tet_region[t]], ratio), body.hardening[t]);
      weigh_tet(body, order, t, solver);
    }
    solver.energy[group] = kernels().energy(view, group, group + 1);
  }
}

void solve_nodal(std::span<NodalPart> parts, std::span<PairContact> contacts, float h) {
  std::vector<Touch> touches;
  std::vector<NodeView> views;
  std::vector<AndersonPart> steps;
  touches.reserve(parts.size());  // views point to them
  for (NodalPart& part : parts) {
    begin_part(part, h);
    touches.push_back({part.contacts, part.pairs, contacts, part.solver});
    views.push_back(node_view(part.solver, touches.back()));
    steps.push_back({part.solver.step_start, part.solver.node, part.solver.last_step, part.body.history, *part.solver.team});
  }
  part_surfaces(parts, contacts);
  for (const NodalPart& part : parts) search_line(*part.input.model.order, part.solver);
  begin_substep(steps);
  const auto most = [](const NodalPart& a, const NodalPart& b) {
    return a.input.parameters.iterations < b.input.parameters.iterations;
  };
  const int iterations = std::max_element(parts.begin(), parts.end(), most)->input.parameters.iterations;
  int done = 0;
  while (done < iterations) {
    for (size_t k = 0; k < parts.size(); ++k) {
      NodalSolver& solver = parts[k].solver;
      const Model& model = parts[k].input.model;
      if (done > 0 && widen(model, solver.before, solver.node, settle_speed * h, solver.active)) {
        gather(model, parts[k].body, solver);
        views[k] = node_view(solver, touches[k]);
      }
      update_stiffness(*model.order, solver);
    }
    if (done == 0) stiffen_pairs(parts, views, contacts);
    write_pressures(parts, contacts);
    for (size_t k = 0; k < parts.size(); ++k) {
      parts[k].solver.step_start = parts[k].solver.node;
      steps[k].before = parts[k].solver.step_start;
    }
    const int begin = done;
    for (int k = 0; k < sweeps_a_step && done < iterations; ++k, ++done) sweep(parts, views, contacts);
    for (NodalPart& part : parts) part.stats.work += uint64_t(done - begin) * part.solver.active.corners / 4;
    const bool pressed = press_pairs(parts, contacts) <= pressed_share;
    compare(steps);
    if (parts.front().solver.last_step.compared) rub_pairs(parts, contacts);
    read_pressures(parts, contacts);
    if (pressed && std::all_of(parts.begin(), parts.end(), [&](NodalPart& part) { return is_solved(part, h); })) break;
    if (done < iterations) {
      mix(steps);
      read_pressures(parts, contacts);
      for (const NodalPart& part : parts) keep_still(part.solver);
    }
  }
  for (size_t k = 0; k < parts.size(); ++k) {
    const double lost = update_stiffness(*parts[k].input.model.order, parts[k].solver);
    parts[k].stats.lost = uint32_t(std::max(0.0, lost - parts[k].lost));
    views[k].measure = true;
    views[k].resolve = measure;
  }
  sweep(parts, views, contacts);
  measure_pairs(contacts);
  for (NodalPart& part : parts) {
    for (size_t i = 0; i < part.body.node.size(); ++i) part.body.node[i] = vec(part.solver.node[i]);
    part.stats.sweeps = uint32_t(done);
  }
}

double flow_nodal(const Model& model, NodalSolver& solver, DeformableState& body) {
  const SweepOrder& order = *model.order;
  const TetView view = tet_view(order, solver);
  double work = sum_over_groups<1>(order, solver, [&](uint32_t first, uint32_t last, double* sum) {
    sum[0] = kernels().flow(view, solver.tets.data(), first, last, solver.flowing.data());
    for (uint32_t group = first; group < last; ++group) take_flow(order, group, solver, body);
  })[0];
  for (const uint32_t i : solver.active.node) {
    work += double(solver.before[i].w) * (body.node[i] - vec(solver.before[i])).squaredNorm();
  }
  return work;
}

double stored_nodal(const Model& model, const ContactSet& contacts, const PairIndex* pairs, NodalSolver& solver,
                    DeformableState& body) {
  const SweepOrder& order = *model.order;
  const TetView view = tet_view(order, solver);
  // All tets: their sum. Else only the change, since the others are not even loaded.
  double sum = solver.active.whole ? 0 : body.stored - body.anchors;
  sum += sum_over_groups<1>(order, solver, [&](uint32_t first, uint32_t last, double* sums) {
    for (uint32_t group = first; group < last; ++group) {
      if (!solver.active.stirred[group]) continue;
      const double before = solver.active.whole ? 0 : solver.energy[group];
      solver.energy[group] = kernels().energy(view, group, group + 1);
      sums[0] += solver.energy[group] - before;
    }
  })[0];
  sum = std::max(0.0, sum);  // at rest the sum is rounding noise around zero
  body.anchors = 0;
  for_each_touched(contacts, pairs, [&](uint32_t i) {
    body.anchors += 0.5 * double(solver.rest[i].w) * (body.node[i] - model.node[i]).squaredNorm();
  });
  return sum + body.anchors;
}

}  // namespace crumple

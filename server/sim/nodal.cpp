#include "sim/nodal.h"

#include <Eigen/Dense>
#include <algorithm>
#include <bit>
#include <cmath>

namespace crumple {
namespace {

Vec3 vec(const Quad& q) { return {q.x, q.y, q.z}; }
Quad quad(const Vec3& v, float w) { return {v.x(), v.y(), v.z(), w}; }

// The quadratic in one node: energy = gradient . d + d^T hessian d / 2.
struct Block {
  Vec3 gradient;
  Mat3 hessian;
};

// Planes push a node no farther than this many times the deepest of them: two that meet at a sharp angle would send it to where
// they meet, far from the car.
constexpr float farthest_push = 5;

// The lowest point of the block on the planes `active` of this node's contacts, or nothing where a multiplier is negative,
// another plane is violated or that point is too far.
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
  if (size > 1 && (out - free).squaredNorm() > farthest_push * farthest_push * gap.cwiseAbs2().maxCoeff()) return false;
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

Block block_of(const float gradient[3], const float h[6]) {
  Block block;
  block.gradient = {gradient[0], gradient[1], gradient[2]};
  block.hessian << h[0], h[3], h[4], h[3], h[1], h[5], h[4], h[5], h[2];
  return block;
}

// A node that an obstacle may hold: the lowest point of its quadratic outside the obstacles.
void resolve(void* context, uint32_t node, const float gradient[3], const float hessian[6]) {
  Scratch& scratch = *static_cast<Scratch*>(context);
  const Block block = block_of(gradient, hessian);
  const Mat3 inverse = block.hessian.inverse();
  const Vec3 position = vec(scratch.node[node]);
  const auto move_to = [&](const Vec3& target) { scratch.node[node] = quad(target, 0); };
  const uint32_t first = scratch.contact_first[node] - 1;
  const Contact* contacts = &scratch.contacts[first];
  int count = 1;
  while (first + count < scratch.contacts.size() && contacts[count].node == node) ++count;
  Held* held = &scratch.held[first];
  for (int i = 0; i < count; ++i) held[i].active = false;

  const Vec3 free = position - inverse * block.gradient;
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

// Several planes press with the forces that add up to the one their node lacks. Says whether they can: planes that are not
// nearly parallel, none of which would have to pull.
bool press_together(const Vec3& force, size_t first, size_t last, Scratch& scratch) {
  size_t at[contacts_per_node];
  int count = 0;
  for (size_t k = first; k < last && count < int(contacts_per_node); ++k) {
    if (scratch.held[k].active) at[count++] = k;
  }
  Mat3 products = Mat3::Identity();
  Vec3 normal_force = Vec3::Zero();
  for (int i = 0; i < count; ++i) {
    const Vec3& normal = scratch.contacts[at[i]].normal;
    normal_force[i] = normal.dot(force);
    for (int k = 0; k < count; ++k) products(i, k) = normal.dot(scratch.contacts[at[k]].normal);
  }
  if (!(products.determinant() > 1e-4f)) return false;
  const Vec3 multiplier = products.inverse() * normal_force;
  if ((multiplier.array() < 0).any()) return false;
  for (int i = 0; i < count; ++i) scratch.held[at[i]].force = multiplier[i] * scratch.contacts[at[i]].normal;
  return true;
}

// The gradient left on a node that contacts hold is their force; friction no more than the cone allows.
void measure(void* context, uint32_t node, const float gradient[3], const float[6]) {
  Scratch& scratch = *static_cast<Scratch*>(context);
  const Vec3 force(gradient[0], gradient[1], gradient[2]);
  const size_t first = scratch.contact_first[node] - 1;
  size_t last = first;
  int planes = 0;
  Vec3 shares = Vec3::Zero();  // of all planes, each what lies along its normal
  for (; last < scratch.contacts.size() && scratch.contacts[last].node == node; ++last) {
    if (!scratch.held[last].active) continue;
    const Vec3& normal = scratch.contacts[last].normal;
    shares += std::max(0.0f, normal.dot(force)) * normal;
    ++planes;
  }
  if (planes > 1 && press_together(force, first, last, scratch)) return;
  for (size_t k = first; k < last; ++k) {
    const Contact& contact = scratch.contacts[k];
    Held& held = scratch.held[k];
    held.force.setZero();
    if (!held.active) continue;
    const float normal_force = std::max(0.0f, contact.normal.dot(force));
    if (planes > 1) {  // so scaled that together they give the force, however the planes lie to each other
      held.force = normal_force * force.dot(shares) / std::max(shares.squaredNorm(), 1e-20f) * contact.normal;
      continue;
    }
    Vec3 tangential = force - contact.normal.dot(force) * contact.normal;
    const float size = tangential.norm(), most = contact.friction * normal_force;
    if (size > most) tangential *= most / size;
    held.force = normal_force * contact.normal + tangential;
  }
}

NodeView node_view(const Blocks& blocks, float quiet, Scratch& scratch) {
  return {scratch.node.data(),
          scratch.before.data(),
          scratch.rest.data(),
          scratch.stiffness.data(),
          blocks.node.data(),
          blocks.row.data(),
          blocks.anchored.data(),
          blocks.rows.data(),
          scratch.weights.data(),
          scratch.still.data(),
          scratch.touched.data(),
          scratch.awake.data(),
          scratch.stirred.data(),
          blocks.near_first.data(),
          blocks.near.data(),
          blocks.over_first.data(),
          blocks.over.data(),
          quiet,
          relaxation,
          false,
          resolve,
          &scratch};
}

TetView tet_view(const Blocks& blocks, const Scratch& scratch) {
  return {scratch.node.data(),   blocks.group.data(), scratch.tets.data(),
          scratch.region.data(), scratch.law.data(),  scratch.stirred.data()};
}

// Pieces of work: a microsecond or two.
constexpr uint32_t blocks_at_once = 2, groups_at_once = 64;

// work(first, last, sums) on all groups of tets, piece by piece; what the pieces sum up is added in their order, so that it
// does not matter who did them.
template <class Work>
std::array<double, 6> sum_over_groups(const Blocks& blocks, Scratch& scratch, const Work& work) {
  const uint32_t groups = uint32_t(blocks.group.size());
  scratch.sums.assign((groups + groups_at_once - 1) / groups_at_once, {});
  scratch.team.run(0, groups, groups_at_once, [&](uint32_t first, uint32_t last) {
    for (; first < last; first += groups_at_once) {  // without helpers the whole range comes at once
      work(first, std::min(last, first + groups_at_once), scratch.sums[first / groups_at_once].data());
    }
  });
  std::array<double, 6> total = {};
  for (const auto& sum : scratch.sums) {
    for (int k = 0; k < 6; ++k) total[k] += sum[k];
  }
  return total;
}

// Returns how many tets have lost their shape.
double renew_stiffness(const Blocks& blocks, Scratch& scratch) {
  const TetView view = tet_view(blocks, scratch);
  return sum_over_groups(blocks, scratch, [&](uint32_t first, uint32_t last, double* sum) {
    sum[0] = kernels().renew(view, first, last, scratch.stiffness.data(), scratch.flowing.data());
  })[0];
}

// A body that has lost its shape (a state from elsewhere, a shape no crash makes) first springs back to the last one it had:
// nothing flows until it has come to rest, or is sound again and an obstacle holds it. Flow would keep what was never there.
void suspend_flow(const Blocks& blocks, double lost, size_t tets, Scratch& scratch, Body& body) {
  if (lost > lost_share * double(tets)) body.lost = true;
  if (lost == 0 && !scratch.contacts.empty()) body.lost = false;
  for (Law& law : scratch.law) law.room = body.lost ? 0.0f : law.limit;
  if (!body.lost) return;
  std::fill(scratch.flowing.begin(), scratch.flowing.end(), uint16_t(0xffff));
  std::fill(scratch.stirred.begin(), scratch.stirred.end(), uint8_t(1));
  renew_stiffness(blocks, scratch);
}

void sweep(const Blocks& blocks, const NodeView& view, Team& team) {
  for (size_t c = 0; c + 1 < blocks.colour.size(); ++c) {
    team.run(blocks.colour[c], blocks.colour[c + 1], blocks_at_once,
             [&](uint32_t first, uint32_t last) { kernels().visit(view, first, last); });
  }
}

// Moves all nodes along scratch.direction by the factor in [0, 1] that lowers the energy most. Along the line the energy is
// a polynomial of degree six, so its minimum needs one pass over the tets.
void search_line(const Blocks& blocks, Scratch& scratch) {
  double derivative[6] = {};  // of the energy along the line: sum derivative[k] a^k
  for (size_t i = 0; i < scratch.node.size(); ++i) {
    const Vec3 direction = vec(scratch.direction[i]), position = vec(scratch.node[i]);
    const float drag = scratch.before[i].w, anchor = scratch.rest[i].w;
    const Vec3 pull = drag * (position - vec(scratch.before[i])) + anchor * (position - vec(scratch.rest[i]));
    derivative[1] += double((drag + anchor) * direction.squaredNorm());
    derivative[0] += double(direction.dot(pull));
  }
  const TetView view = tet_view(blocks, scratch);
  const auto elastic = sum_over_groups(blocks, scratch, [&](uint32_t first, uint32_t last, double* sum) {
    kernels().slope(view, first, last, scratch.stiffness.data(), scratch.direction.data(), sum);
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
  for (size_t i = 0; i < scratch.node.size(); ++i) {
    scratch.node[i] = quad(vec(scratch.node[i]) + float(low) * vec(scratch.direction[i]), 0);
  }
}

// Sub-steps of a crash resemble one another: start from the last displacement, as much of it as lowers the energy.
// Nodes in contact go where the obstacle takes them first.
void predict(const Blocks& blocks, float share, Scratch& scratch, Body& body) {
  for (size_t i = 0; i < body.step.size(); ++i) {
    const bool awake = scratch.awake[blocks.place[i] / lanes];
    scratch.direction[i] = awake ? quad(share * body.step[i], 0) : Quad{};
  }
  std::fill(scratch.direction.begin() + ptrdiff_t(body.step.size()), scratch.direction.end(), Quad{});
  for (const Contact& contact : scratch.contacts) {
    const Vec3 position = vec(scratch.node[contact.node]);
    const float depth = std::max(0.0f, contact.offset - contact.normal.dot(position));
    scratch.node[contact.node] = quad(position + depth * contact.normal, 0);
    scratch.direction[contact.node] = {};
  }
  search_line(blocks, scratch);
}

// Mixing also moves what has come to rest since, and anchored nodes that an obstacle has let go: they stay where they were.
void keep_still(const Blocks& blocks, Scratch& scratch) {
  for (size_t block = 0; block < scratch.awake.size(); ++block) {
    unsigned keep = scratch.awake[block] ? unsigned(scratch.still[block] & ~scratch.touched[block]) : 0xffffu;
    for (; keep != 0; keep &= keep - 1) {
      const uint32_t node = blocks.node[lanes * block + uint32_t(std::countr_zero(keep))];
      scratch.node[node] = scratch.from[node];
    }
  }
}

// Springs for the anchored nodes that obstacles reach; together at most `most` N/m.
void stiffen_anchors(const Model& model, const Parameters& parameters, float most, Scratch& scratch) {
  for (size_t i = 0; i < model.node.size(); ++i) scratch.rest[i] = quad(model.node[i], 0);
  float sum = 0;
  for (const Contact& contact : scratch.contacts) {
    const uint32_t node = contact.node;
    float& spring = scratch.rest[node].w;
    if (!model.node_anchored[node] || spring > 0) continue;
    for (uint32_t k = model.node_first[node]; k < model.node_first[node + 1]; ++k) {
      const uint32_t tet = model.corner[k] / 4, corner = model.corner[k] % 4;
      const auto& g = model.gradients[tet].corner;
      const float squared = corner > 0 ? g[corner - 1].squaredNorm() : (g[0] + g[1] + g[2]).squaredNorm();
      spring += anchor_ratio * parameters.region[model.tet_region[tet]].young_modulus * model.tet_rest[tet] * squared;
    }
    sum += spring;
  }
  if (!(sum > most)) return;
  for (const Contact& contact : scratch.contacts) {
    if (scratch.contact_first[contact.node] != uint32_t(&contact - scratch.contacts.data()) + 1) continue;  // once a node
    scratch.rest[contact.node].w *= most / sum;
  }
}

// Which lanes the sweeps move, and which they leave to `resolve`.
void mark_lanes(const Blocks& blocks, Scratch& scratch) {
  for (size_t block = 0; block < blocks.anchored.size(); ++block) {
    scratch.still[block] = blocks.anchored[block] ? uint16_t(0xffff) : blocks.unused[block];
    scratch.touched[block] = 0;
    scratch.awake[block] = 0;
  }
  for (const Contact& contact : scratch.contacts) {
    const uint32_t place = blocks.place[contact.node];
    const uint16_t bit = uint16_t(1u << (place % lanes));
    scratch.still[place / lanes] |= bit;
    scratch.touched[place / lanes] |= bit;
    scratch.awake[place / lanes] = 1;
  }
}

// Who takes part in this sub-step from its start: what an obstacle may hold, and what moved in the last one. All of it where
// that says too little: a lost shape, a body from elsewhere or partly repaired, one that an obstacle has just let go.
void rouse(const Blocks& blocks, float quiet, Scratch& scratch, const Body& body) {
  bool moved = false;
  for (size_t i = 0; i < body.step.size(); ++i) {
    if (body.step[i].squaredNorm() <= quiet * quiet) continue;
    moved = true;
    scratch.awake[blocks.place[i] / lanes] = 1;
  }
  const bool all = body.lost || (!moved && (scratch.contacts.empty() || !body.settled));
  std::fill(scratch.stirred.begin(), scratch.stirred.end(), uint8_t(0));
  for (size_t block = 0; block < scratch.awake.size(); ++block) {
    if (all) scratch.awake[block] = 1;
    if (blocks.anchored[block] && scratch.touched[block] == 0) scratch.awake[block] = 0;
    if (!scratch.awake[block]) continue;
    for (uint32_t k = blocks.over_first[block]; k < blocks.over_first[block + 1]; ++k) scratch.stirred[blocks.over[k]] = 1;
  }
}

// What the rows of a tet's four nodes need of its gradients.
void weigh_tet(const Body& body, const Blocks& blocks, uint32_t t, Scratch& scratch) {
  const auto& g = body.gradients[t].corner;
  const Vec3 first = -g[0] - g[1] - g[2];
  const float d01 = first.dot(g[0]), d02 = first.dot(g[1]), d03 = first.dot(g[2]);
  const float d12 = g[0].dot(g[1]), d13 = g[0].dot(g[2]), d23 = g[1].dot(g[2]);
  const float weight[4][3] = {{d01, d02, d03}, {d01, d13, d12}, {d23, d02, d12}, {d23, d13, d03}};  // in the order of Row
  for (int corner = 0; corner < 4; ++corner) {
    const uint32_t slot = blocks.slot[4 * t + corner];
    for (int o = 0; o < 3; ++o) scratch.weights[slot / lanes].other[o][slot % lanes] = weight[corner][o];
  }
}

// What flowed in a group of tets, into the body and the rows.
void take_flow(const Blocks& blocks, uint32_t group, Scratch& scratch, Body& body) {
  if (!scratch.stirred[group]) return;
  const TetLanes& tet = scratch.tets[group];
  for (unsigned left = scratch.flowing[group]; left != 0; left &= left - 1) {
    const uint32_t lane = uint32_t(std::countr_zero(left)), t = lanes * group + lane;
    for (int k = 0; k < 9; ++k) body.gradients[t].corner[k / 3][k % 3] = tet.gradient[k][lane];
    body.hardening[t] = tet.kappa[lane];
    weigh_tet(body, blocks, t, scratch);
  }
}

size_t awake_nodes(const Scratch& scratch) {
  return lanes * size_t(std::count_if(scratch.awake.begin(), scratch.awake.end(), [](uint8_t awake) { return awake != 0; }));
}

// A gradient is as long as one over the height above the face opposite.
bool thin(const Gradients& gradients) {
  const auto& g = gradients.corner;
  const float steepest =
      std::max({g[0].squaredNorm(), g[1].squaredNorm(), g[2].squaredNorm(), (g[0] + g[1] + g[2]).squaredNorm()});
  return steepest * thinnest * thinnest > 1;
}

// The squared way of all nodes in this sub-step, m^2; an awake node's is no shorter than at the speed at which it is at rest.
double way_size(float quiet, const Scratch& scratch) {
  double sum = double(awake_nodes(scratch)) * double(quiet * quiet);
  for (size_t i = 0; i < scratch.node.size(); ++i) {
    sum += double((vec(scratch.node[i]) - vec(scratch.before[i])).squaredNorm());
  }
  return sum;
}

}  // namespace

void prepare_nodal(const Model& model, const Parameters& parameters, const Body& body, Scratch& scratch) {
  const Blocks& blocks = *model.blocks;
  const size_t n = model.node.size(), t = model.tet.size(), padded = lanes * blocks.group.size();
  static_assert(lanes == 16);
  for (auto* list : {&scratch.node, &scratch.before, &scratch.rest, &scratch.direction}) {
    list->assign(quads_of_nodes(n), Quad{});
  }
  scratch.before[n].w = 1;  // what stands in unused lanes must not divide by zero
  scratch.stiffness.assign(padded + 1, Quad{});
  scratch.tets.assign(blocks.group.size(), TetLanes{});
  scratch.weights.assign(blocks.rows.size(), Weights{});
  scratch.flowing.assign(blocks.group.size(), 0xffff);
  scratch.stirred.assign(blocks.group.size(), 1);  // all, once
  scratch.awake.resize(blocks.anchored.size());
  scratch.still.resize(blocks.anchored.size());
  scratch.touched.resize(blocks.anchored.size());
  scratch.volume = 0;
  for (uint32_t i = 0; i < t; ++i) {
    TetLanes& tet = scratch.tets[i / lanes];
    const uint32_t lane = i % lanes;
    for (int k = 0; k < 9; ++k) tet.gradient[k][lane] = body.gradients[i].corner[k / 3][k % 3];
    tet.kappa[lane] = body.hardening[i];
    tet.volume[lane] = model.tet_rest[i];
    scratch.volume += double(model.tet_rest[i]);
    weigh_tet(body, blocks, i, scratch);
  }
  scratch.law.resize(region_limit);
  for (int r = 0; r < region_limit; ++r) {
    const Elastic e = elastic(parameters.region[r]);
    const YieldLaw y = yield_law(parameters.region[r]);
    scratch.law[r] = {e.mu, e.l, e.gamma, y.shear, y.bulk, y.start, y.slope, y.limit, y.limit};
  }
  uint8_t same[region_limit];  // the first region with the same law, so that most groups of tets have one law
  for (int r = 0; r < region_limit; ++r) {
    same[r] = uint8_t(std::find(scratch.law.begin(), scratch.law.begin() + r, scratch.law[r]) - scratch.law.begin());
  }
  scratch.region.assign(padded, same[model.tet_region[t - 1]]);
  for (uint32_t i = 0; i < t; ++i) scratch.region[i] = same[model.tet_region[i]];
  for (uint32_t i = 0; i < t; ++i) {
    if (thin(model.gradients[i])) scratch.tets[i / lanes].kappa[i % lanes] = scratch.law[model.tet_region[i]].limit;
  }
}

Effort solve_nodal(const Model& model, const Parameters& parameters, double mass, float h, float share, Scratch& scratch,
                   Body& body) {
  const Blocks& blocks = *model.blocks;
  const uint32_t count = uint32_t(body.node.size());
  for (uint32_t i = 0; i < count; ++i) {
    const Material& material = parameters.region[model.node_region[i]];
    const float drag = material.viscosity * model.node_mass[i] / model.mass * float(scratch.volume) / h;
    scratch.before[i] = quad(body.node[i], drag);
    scratch.node[i] = quad(body.node[i], 0);
  }
  stiffen_anchors(model, parameters, anchor_share * float(mass) / (h * h), scratch);
  const float quiet = settle_speed * h;
  suspend_flow(blocks, renew_stiffness(blocks, scratch), model.tet.size(), scratch, body);
  mark_lanes(blocks, scratch);
  rouse(blocks, quiet, scratch, body);
  NodeView view = node_view(blocks, quiet, scratch);
  predict(blocks, share, scratch, body);
  begin_mixing(scratch);
  const double enough = double(parameters.tolerance) * double(parameters.tolerance);
  double mean = 0;  // square of the residual, m^2
  int done = 0;
  while (done < parameters.iterations) {
    scratch.from = scratch.node;
    renew_stiffness(blocks, scratch);
    for (int k = 0; k < sweeps_a_step && done < parameters.iterations; ++k, ++done) sweep(blocks, view, scratch.team);
    compare_step(scratch, body.history);
    mean = scratch.residual_size / double(std::max<size_t>(1, awake_nodes(scratch)));
    if (scratch.compared && mean <= enough && scratch.residual_size <= small_share * small_share * way_size(quiet, scratch))
      break;
    if (done < parameters.iterations) {
      mix(scratch, body.history);
      keep_still(blocks, scratch);
    }
  }
  renew_stiffness(blocks, scratch);
  view.measure = true;
  view.resolve = measure;
  sweep(blocks, view, scratch.team);
  for (uint32_t i = 0; i < count; ++i) body.node[i] = vec(scratch.node[i]);
  const auto stirred = uint64_t(std::count(scratch.stirred.begin(), scratch.stirred.end(), uint8_t(1)));
  return {uint32_t(done), lanes * stirred * uint64_t(done), std::sqrt(float(mean))};
}

double flow_nodal(const Model& model, Scratch& scratch, Body& body) {
  const Blocks& blocks = *model.blocks;
  const TetView view = tet_view(blocks, scratch);
  double work = sum_over_groups(blocks, scratch, [&](uint32_t first, uint32_t last, double* sum) {
    sum[0] = kernels().flow(view, scratch.tets.data(), first, last, scratch.flowing.data());
    for (uint32_t group = first; group < last; ++group) take_flow(blocks, group, scratch, body);
  })[0];
  for (size_t i = 0; i < body.node.size(); ++i) {
    work += double(scratch.before[i].w) * (body.node[i] - vec(scratch.before[i])).squaredNorm();
  }
  return work;
}

double stored_nodal(const Model& model, Scratch& scratch, const Body& body) {
  const TetView view = tet_view(*model.blocks, scratch);
  double sum = sum_over_groups(*model.blocks, scratch, [&](uint32_t first, uint32_t last, double* sums) {
    sums[0] = kernels().energy(view, first, last);
  })[0];
  for (const Contact& contact : scratch.contacts) {
    const size_t i = contact.node;
    if (scratch.contact_first[i] - 1 != size_t(&contact - scratch.contacts.data())) continue;  // once a node
    sum += 0.5 * double(scratch.rest[i].w) * (body.node[i] - model.node[i]).squaredNorm();
  }
  return std::max(0.0, sum);  // at rest it is noise around nothing
}

}  // namespace crumple

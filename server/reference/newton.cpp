// All bodies of a sub-step are one system: their nodes and tets stand behind one another. Each node has a basis Z of the
// directions in which it may move: three columns if it is free, none if it is anchored or sticks. The Newton system is Z^T K Z.
// Names: g gradient of the potential, N; gap = normal . x - offset, m.
#include "reference/newton.h"

#include <Eigen/Sparse>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "sim/deform.h"
#include "sim/flow.h"
#include "sim/nodal.h"

namespace crumple {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Positions = std::vector<Vector3d>;
using Basis = Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, 3>;

constexpr double touching_gap = 1e-10;  // m
constexpr double noise_strain = 1e-4;   // round-off: residuals are measured relative to at least the force of this strain
// Stiffness of a contact between bodies, relative to that of its nodes. With 100 friction does not always converge.
constexpr double pair_grip = 10;

// One obstacle's plane on one node in double precision.
struct Plane3 {
  Vector3d normal;
  double offset;
  Vector3d stuck;  // where the node would stick to the obstacle, on the plane
  double friction;
  double gap(const Vector3d& x) const { return normal.dot(x) - offset; }
};

Vector3d corner_of(const Matrix3d& rows, int corner) {
  return corner > 0 ? Vector3d(rows.row(corner - 1)) : Vector3d(-rows.colwise().sum());
}

// One contact between bodies in double precision, as an augmented Lagrangian: it presses with max(0, pressure - stiffness gap).
// Newton minimises with `pressure`, `rub` and the cone's size fixed; press() then takes the force over.
struct Pair {
  size_t node[4];    // of the problem: the node, and the triangle's corners
  Matrix3d turn[4];  // way = sum turn x
  Vector3d normal, offset;
  double constant, friction, stiffness;
  double pressure = 0;
  Vector3d rub = Vector3d::Zero();

  struct Force {
    double pressed = 0;                 // N
    Vector3d rub = Vector3d::Zero();    // N
    Matrix3d stiff = Matrix3d::Zero();  // N/m
    Vector3d slip = Vector3d::Zero();   // m
  };
  Force force(std::span<const Vector3d> x) const {
    Vector3d way = Vector3d::Zero();
    for (int k = 0; k < 4; ++k) way += turn[k] * x[node[k]];
    Force out;
    out.pressed = std::max(0.0, pressure - stiffness * (normal.dot(way) + constant));
    if (!(out.pressed > 0)) return out;
    out.stiff = stiffness * normal * normal.transpose();
    if (friction == 0) return out;
    const Matrix3d within = Matrix3d::Identity() - normal * normal.transpose();
    out.slip = within * (way + offset);
    out.rub = rub - stiffness * out.slip;
    const double size = out.rub.norm(), cone = friction * pressure;
    if (size <= cone) {
      out.stiff += stiffness * within;
      return out;
    }
    out.stiff += stiffness * cone / size * (within - out.rub * out.rub.transpose() / (size * size));
    out.rub *= cone / size;
    return out;
  }
  // Returns how far the force is from the one that Newton began with, N.
  double wrong(const Force& now) const { return std::hypot(now.pressed - pressure, (now.rub - rub).norm()); }
  void press(const Force& now) {
    pressure = now.pressed;
    rub = now.rub;
  }
};

struct Problem {
  ReferenceOptions options;
  Positions rest, before;                    // per node, m
  std::vector<double> drag, anchor;          // per node, N/m
  std::vector<double> grip;                  // per node: about its stiffness, N/m
  std::vector<char> fixed, touched;          // per node
  std::vector<std::vector<Plane3>> contact;  // per node
  std::vector<std::array<size_t, 4>> tet;
  std::vector<ReferenceMaterial> material;  // per tet
  std::vector<Matrix3d> rows;               // per tet: as in ReferenceState
  std::vector<double> hardening, volume;    // per tet
  std::vector<Pair> pair;
  std::vector<size_t> first;  // node of each body, and the end

  void add(const Model& m, const Parameters& parameters, double h, const ReferenceState& start) {
    double all = 0;
    for (float each : m.tet_rest) all += double(each);
    if (first.empty()) first.push_back(0);
    const size_t begin = first.back();
    for (size_t i = 0; i < m.node.size(); ++i) {
      rest.push_back(m.node[i].cast<double>());
      before.push_back(start.node[i]);
      drag.push_back(double(parameters.region[m.node_region[i]].drag) * double(m.node_mass[i]) / double(m.mass) * all / h);
      fixed.push_back(m.node_anchored[i] != 0);
    }
    first.push_back(rest.size());
    touched.resize(rest.size());
    anchor.resize(rest.size());
    grip.resize(rest.size());
    contact.resize(rest.size());
    for (size_t t = 0; t < m.tet.size(); ++t) {
      std::array<size_t, 4>& corners = tet.emplace_back();
      const double unloaded = 1 / (6 * double(m.tet_rest[t]) * start.gradients[t].determinant());
      material.push_back(reference_material(parameters.region[m.tet_region[t]], unloaded));
      rows.push_back(start.gradients[t]);
      hardening.push_back(start.hardening[t]);
      volume.push_back(double(m.tet_rest[t]));
      for (size_t k = 0; k < 4; ++k) {
        corners[k] = begin + m.tet[t].node[k];
        grip[corners[k]] += material.back().mu * volume.back() * corner_of(rows.back(), int(k)).squaredNorm();
      }
    }
  }

  void touch(const PairContact& met) {
    Pair& out = pair.emplace_back();
    double compliance = 0;
    for (int k = 0; k < 4; ++k) {
      const double weight = k == 0 ? 1 : -double(met.weight[k - 1]);
      out.node[k] = k == 0 ? first[met.car[0]] + met.node : first[met.car[1]] + met.corner[k - 1];
      out.turn[k] = k == 0 ? Matrix3d(met.rotation.cast<double>()) : Matrix3d(weight * Matrix3d::Identity());
      compliance += weight * weight / grip[out.node[k]];
      touched[out.node[k]] = true;
    }
    out.normal = met.normal.cast<double>().normalized();
    out.offset = met.offset.cast<double>();
    out.constant = double(met.constant);
    out.friction = double(met.friction);
    out.stiffness = pair_grip / compliance;
  }
};

Matrix3d rows_of(const Gradients& gradients) {
  Matrix3d rows;
  for (int k = 0; k < 3; ++k) rows.row(k) = gradients.corner[k].transpose().cast<double>();
  return rows;
}

Matrix3d deformation_of(const Problem& problem, size_t t, const Matrix3d& rows, std::span<const Vector3d> x) {
  const std::array<size_t, 4>& node = problem.tet[t];
  Matrix3d edges;
  for (size_t k = 0; k < 3; ++k) edges.col(int(k)) = x[node[k + 1]] - x[node[0]];
  return edges * rows;
}

// Attaches springs to the anchored nodes of a body that contacts reach, like stiffen_anchors in nodal.cpp. first: its first
// node.
void stiffen_anchors(const Model& model, const Parameters& parameters, double most, size_t first, Problem& problem) {
  double sum = 0;
  for (size_t i = 0; i < model.node.size(); ++i) {
    if (!model.node_anchored[i] || !problem.touched[first + i]) continue;
    problem.fixed[first + i] = false;
    double& spring = problem.anchor[first + i];
    for (uint32_t k = model.node_first[i]; k < model.node_first[i + 1]; ++k) {
      const uint32_t tet = model.corner[k] / 4;
      const Vector3d g = corner_of(rows_of(model.gradients[tet]), int(model.corner[k] % 4));
      spring += double(anchor_ratio) * double(parameters.region[model.tet_region[tet]].young_modulus) *
                double(model.tet_rest[tet]) * g.squaredNorm();
    }
    sum += spring;
  }
  if (!(sum > most)) return;
  for (size_t i = 0; i < model.node.size(); ++i) problem.anchor[first + i] *= most / sum;
}

struct Forces {
  Positions gradient;  // per node, N
  double largest = 0;  // largest force of a tet on a corner, N: residuals are relative to it
  double energy = 0;   // J
};

Forces forces(const Problem& problem, std::span<const Vector3d> x) {
  Forces out;
  out.gradient.resize(x.size());
  for (size_t i = 0; i < x.size(); ++i) {
    const Vector3d moved = x[i] - problem.before[i], sprung = x[i] - problem.rest[i];
    out.gradient[i] = problem.drag[i] * moved + problem.anchor[i] * sprung;
    out.energy += 0.5 * (problem.drag[i] * moved.squaredNorm() + problem.anchor[i] * sprung.squaredNorm());
  }
  for (size_t t = 0; t < problem.tet.size(); ++t) {
    const Matrix3d& rows = problem.rows[t];
    const double volume = problem.volume[t];
    const TetLaw law = tet_law(problem.options.law, problem.material[t], deformation_of(problem, t, rows, x),
                               problem.hardening[t], false, false);
    out.energy += volume * law.energy;
    for (int k = 0; k < 4; ++k) {
      const Vector3d force = volume * law.stress * corner_of(rows, k);
      out.gradient[problem.tet[t][size_t(k)]] += force;
      const double noise = noise_strain * volume * problem.material[t].mu * corner_of(rows, k).norm();
      out.largest = std::max({out.largest, force.norm(), noise});
    }
  }
  for (const Pair& pair : problem.pair) {
    const Pair::Force force = pair.force(x);
    for (int k = 0; k < 4; ++k) {
      out.gradient[pair.node[k]] -= pair.turn[k].transpose() * (force.pressed * pair.normal + force.rub);
    }
  }
  return out;
}

// ---- contacts ---------------------------------------------------------------------------------------------------------------

// The planes that hold a node: it touches them and its gradient presses on them. Friction is the zero of
//   -g_t - (-g_t + grip slip, cut to the cone)        (Alart and Curnier 1991)
// with g_t the tangential gradient, slip the distance from where the node would stick, and grip any stiffness. Within the cone
// the slip must vanish; outside it the force has the cone's length. It is linearised with the size of the cone fixed.
struct Hold {
  unsigned planes = 0;                 // bit k: contact k
  Vector3d force = Vector3d::Zero();   // of the contacts on the node, without friction, N
  bool rubs = false;                   // one plane, with friction, holds it
  bool sticks = false;                 // ... and the force lies within the cone
  double wrong = 0;                    // unbalanced force, N
  Vector3d pull = Vector3d::Zero();    // gradient of the function that the next move minimises, N
  Vector3d driven = Vector3d::Zero();  // prescribed part of the next move, m
  Matrix3d stiff = Matrix3d::Zero();   // stiffness of friction, N/m
  Basis basis;
};

int lone(unsigned planes) { return planes == 1 ? 0 : planes == 2 ? 1 : 2; }
bool single(unsigned planes) { return planes != 0 && (planes & (planes - 1)) == 0; }

// Finds lambda >= 0 on the planes of `set` so that sum lambda normal is nearest to `target`. Returns false if one is negative
// or the planes are nearly parallel.
bool spread(const std::vector<Plane3>& contact, unsigned set, const Vector3d& target, Vector3d& sum) {
  Basis normals(3, 0);
  for (size_t k = 0; k < contact.size(); ++k) {
    if (!(set >> k & 1)) continue;
    normals.conservativeResize(3, normals.cols() + 1);
    normals.rightCols<1>() = contact[k].normal;
  }
  const Eigen::MatrixXd gram = normals.transpose() * normals;
  if (gram.determinant() < 1e-8) return false;
  const Eigen::VectorXd lambda = gram.ldlt().solve(normals.transpose() * target);
  if (lambda.minCoeff() < 0) return false;
  sum = normals * lambda;
  return true;
}

// The nearest point on the free side of the node's planes. If the planes leave no room, the deepest wins.
Vector3d outside(const std::vector<Plane3>& contact, const Vector3d& x) {
  const auto clear = [&](const Vector3d& point) {
    return std::all_of(contact.begin(), contact.end(), [&](const Plane3& p) { return p.gap(point) > -0.5 * touching_gap; });
  };
  if (clear(x)) return x;
  Vector3d best = x;
  double nearest = 1e30;
  for (unsigned set = 1; set < (1u << contact.size()); ++set) {
    Basis normals(3, 0);
    Vector3d gap = Vector3d::Zero();
    for (size_t k = 0; k < contact.size(); ++k) {
      if (!(set >> k & 1)) continue;
      gap[normals.cols()] = contact[k].gap(x);
      normals.conservativeResize(3, normals.cols() + 1);
      normals.rightCols<1>() = contact[k].normal;
    }
    const Eigen::MatrixXd gram = normals.transpose() * normals;
    if (gram.determinant() < 1e-8) continue;
    const Vector3d point = x - normals * gram.ldlt().solve(gap.head(normals.cols()));
    if (!clear(point) || (point - x).norm() >= nearest) continue;
    nearest = (point - x).norm();
    best = point;
  }
  return nearest < 1e30 ? best : Vector3d(x - contact[0].gap(x) * contact[0].normal);
}

void rub(const Plane3& plane, double grip, const Vector3d& x, const Vector3d& g, Hold& hold) {
  const Matrix3d within = hold.basis * hold.basis.transpose();
  const Vector3d tangential = within * g, slip = within * (x - plane.stuck);
  const double cone = plane.friction * hold.force.norm();
  const Vector3d aim = grip * slip - tangential;
  const double size = aim.norm();
  hold.rubs = true;
  hold.sticks = size <= cone;
  if (hold.sticks) {
    hold.wrong = grip * slip.norm();
    hold.driven = -slip;
    hold.basis = Basis(3, 0);
    return;
  }
  const Vector3d way = aim / size;
  const Matrix3d across = within - way * way.transpose();
  hold.wrong = (tangential + cone * way).norm();
  hold.stiff = grip * cone / std::max(size - cone, 1e-9 * size) * across;
  hold.pull = tangential + cone * way + hold.stiff * slip;
}

Hold hold_of(const Problem& problem, size_t node, const Vector3d& x, const Vector3d& g) {
  const std::vector<Plane3>& contact = problem.contact[node];
  Hold hold;
  hold.basis = problem.fixed[node] ? Basis(3, 0) : Basis(Matrix3d::Identity());
  if (problem.fixed[node]) return hold;
  hold.pull = g;
  hold.wrong = g.norm();
  unsigned touched = 0;
  for (size_t k = 0; k < contact.size(); ++k) {
    const Plane3& plane = contact[k];
    touched |= unsigned(plane.gap(x) < touching_gap) << k;
    if (plane.gap(x) > -touching_gap) continue;  // the node is inside: move it at once to where it sticks
    hold.driven = outside(contact, plane.friction > 0 ? plane.stuck : x) - x;
    hold.wrong = problem.grip[node] * hold.driven.norm();
    hold.basis = Basis(3, 0);
    return hold;
  }
  double best = g.norm();
  for (unsigned set = 1; set < 8 && touched; ++set) {
    Vector3d force;
    if ((set & touched) != set || !spread(contact, set, g, force)) continue;
    if (!((g - force).norm() < best)) continue;
    best = (g - force).norm();
    hold.planes = set;
    hold.force = force;
  }
  if (hold.planes == 0) return hold;

  Matrix3d along = Matrix3d::Zero();
  for (size_t k = 0; k < contact.size(); ++k) {
    if (hold.planes >> k & 1) along += contact[k].normal * contact[k].normal.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Matrix3d> axes(along);  // ascending: directions within all planes come first
  int within = 0;
  while (within < 3 && axes.eigenvalues()[within] < 1e-9) ++within;
  hold.basis = axes.eigenvectors().leftCols(within);
  hold.pull = hold.basis * (hold.basis.transpose() * g);
  hold.wrong = hold.pull.norm();
  const Plane3& plane = contact[size_t(lone(hold.planes))];
  if (single(hold.planes) && plane.friction > 0) rub(plane, problem.grip[node], x, g, hold);
  return hold;
}

// ---- Newton -----------------------------------------------------------------------------------------------------------------

using Sparse = Eigen::SparseMatrix<double>;
using Entries = std::vector<Eigen::Triplet<double>>;

void add_block(size_t row, size_t column, const Eigen::Ref<const Eigen::MatrixXd>& block, Entries& entries) {
  for (int i = 0; i < block.rows(); ++i) {
    for (int k = 0; k < block.cols(); ++k) entries.emplace_back(int(row) + i, int(column) + k, block(i, k));
  }
}

// The stiffness matrix of all nodes, three rows each, including friction.
Sparse stiffness(const Problem& problem, std::span<const Vector3d> x, const std::vector<Hold>& hold, bool project) {
  Entries entries;
  entries.reserve(problem.tet.size() * 144 + problem.pair.size() * 144 + x.size() * 9);
  for (size_t i = 0; i < x.size(); ++i) {
    add_block(3 * i, 3 * i, (problem.drag[i] + problem.anchor[i]) * Matrix3d::Identity() + hold[i].stiff, entries);
  }
  for (size_t t = 0; t < problem.tet.size(); ++t) {
    const Matrix3d& rows = problem.rows[t];
    const TetLaw law = tet_law(problem.options.law, problem.material[t], deformation_of(problem, t, rows, x),
                               problem.hardening[t], true, project);
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b) {
        const Vector3d ga = corner_of(rows, a), gb = corner_of(rows, b);
        Matrix3d block = Matrix3d::Zero();
        for (int i = 0; i < 3; ++i) {
          for (int k = 0; k < 3; ++k) block += ga[i] * gb[k] * law.tangent.block<3, 3>(3 * i, 3 * k);
        }
        add_block(3 * problem.tet[t][size_t(a)], 3 * problem.tet[t][size_t(b)], problem.volume[t] * block, entries);
      }
    }
  }
  for (const Pair& pair : problem.pair) {
    const Pair::Force force = pair.force(x);
    if (!(force.pressed > 0)) continue;
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b) {
        add_block(3 * pair.node[a], 3 * pair.node[b], pair.turn[a].transpose() * force.stiff * pair.turn[b], entries);
      }
    }
  }
  Sparse matrix(3 * int(x.size()), 3 * int(x.size()));
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

// The moves of all nodes: the prescribed moves, and how the other nodes then move.
Eigen::VectorXd newton_move(const Problem& problem, std::span<const Vector3d> x, const std::vector<Hold>& hold) {
  const int size = 3 * int(x.size());
  Eigen::VectorXd driven(size), pull(size);
  Entries entries;
  int unknowns = 0;
  for (size_t i = 0; i < x.size(); ++i) {
    driven.segment<3>(3 * int(i)) = hold[i].driven;
    pull.segment<3>(3 * int(i)) = hold[i].pull;
    add_block(3 * i, size_t(unknowns), hold[i].basis, entries);
    unknowns += int(hold[i].basis.cols());
  }
  if (unknowns == 0) return driven;
  Sparse basis(size, unknowns);
  basis.setFromTriplets(entries.begin(), entries.end());
  Eigen::SimplicialLDLT<Sparse> factor;
  Eigen::VectorXd right;
  for (bool project : {false, true}) {
    const Sparse full = stiffness(problem, x, hold, project);
    right = -(basis.transpose() * (pull + full * driven));
    factor.setShift(project ? 1e-12 * full.diagonal().maxCoeff() : 0);
    factor.compute(basis.transpose() * full * basis);
    if (factor.info() == Eigen::Success && factor.vectorD().minCoeff() > 0) break;
  }
  return driven + basis * factor.solve(right);
}

// Slope of the minimised function at `at` along the move that led there, with this pass's friction linear.
double slope_along(const Forces& there, std::span<const Vector3d> from, std::span<const Vector3d> at,
                   const std::vector<Hold>& hold, const Positions& gradient) {
  double sum = 0;
  for (size_t i = 0; i < from.size(); ++i) {
    if (hold[i].basis.cols() == 0) continue;
    const Vector3d move = at[i] - from[i];
    Vector3d g = there.gradient[i];
    if (hold[i].rubs) g += hold[i].pull - hold[i].basis * (hold[i].basis.transpose() * gradient[i]) + hold[i].stiff * move;
    sum += g.dot(move);
  }
  return sum;
}

struct Solution {
  Forces forces;
  std::vector<Hold> hold;
};

Solution solve(Problem& problem, Positions& x, ReferenceStep& step) {
  Solution now{forces(problem, x), std::vector<Hold>(x.size())};
  for (int pass = 0; pass <= problem.options.most_passes; ++pass) {
    double worst = 0;
    bool driven = false;
    for (size_t i = 0; i < x.size(); ++i) {
      now.hold[i] = hold_of(problem, i, x[i], now.forces.gradient[i]);
      worst = std::max(worst, now.hold[i].wrong);
      driven = driven || now.hold[i].driven.norm() > touching_gap;
    }
    double open = 0;
    for (const Pair& pair : problem.pair) open = std::max(open, pair.wrong(pair.force(x)));
    step.residual.push_back(std::max(worst, open) / now.forces.largest);
    step.converged = step.residual.back() <= problem.options.tolerance;
    if (step.converged) break;
    if (worst < open) {
      for (Pair& pair : problem.pair) pair.press(pair.force(x));
      now.forces = forces(problem, x);
      for (size_t i = 0; i < x.size(); ++i) now.hold[i] = hold_of(problem, i, x[i], now.forces.gradient[i]);
    }
    const Eigen::VectorXd move = newton_move(problem, x, now.hold);
    double start = 0;
    for (size_t i = 0; i < x.size(); ++i) start += now.hold[i].pull.dot(move.segment<3>(3 * int(i)));
    // Along the move the function must not rise again much: halve the move until it does not. A prescribed move is taken whole.
    for (double share = 1;; share *= 0.5) {
      Positions next = x;
      for (size_t i = 0; i < x.size(); ++i) next[i] = outside(problem.contact[i], x[i] + share * move.segment<3>(3 * int(i)));
      Forces there = forces(problem, next);
      const double slope = slope_along(there, x, next, now.hold, now.forces.gradient);
      if (!driven && slope > 0.5 * share * std::fabs(start) && share > 1e-6) continue;
      x = std::move(next);
      now.forces = std::move(there);
      break;
    }
  }
  return now;
}

// first: of the body's tets in the problem.
void flow_all(const Problem& problem, const Positions& x, size_t first, ReferenceState& state, ReferenceStep& step) {
  for (size_t k = 0; k < state.gradients.size(); ++k) {
    const size_t t = first + k;
    const Matrix3d f = deformation_of(problem, t, problem.rows[t], x);
    step.inverted += f.determinant() <= smallest_flowing_ratio;
    const Flowed flowed = flow_reference(problem.options.law, problem.material[t], f, problem.hardening[t]);
    state.hardening[k] += flowed.growth;
    step.plastic_work += problem.volume[t] * flowed.work;
    state.gradients[k] = state.gradients[k] * flowed.factor;  // rows: b^T factor, and factor is symmetric
  }
}

}  // namespace

ReferenceState make_reference(const Model& model) {
  ReferenceState state;
  for (const Vec3& node : model.node) state.node.push_back(node.cast<double>());
  for (const Gradients& gradients : model.gradients) state.gradients.push_back(rows_of(gradients));
  state.hardening.assign(model.tet.size(), 0.0);
  return state;
}

std::vector<ReferenceStep> step_reference(std::span<const ReferenceBody> bodies, std::span<PairContact> pairs, double h,
                                          const ReferenceOptions& options) {
  Problem problem;
  problem.options = options;
  for (const ReferenceBody& body : bodies) problem.add(body.model, body.parameters, h, body.state);
  for (const PairContact& contact : pairs) problem.touch(contact);
  Positions x = problem.before;
  for (size_t b = 0; b < bodies.size(); ++b) {
    const auto& [model, parameters, contacts, state] = bodies[b];
    for (const Contact& contact : contacts) {
      const Vector3d normal = contact.normal.cast<double>().normalized(), carried = contact.carried.cast<double>();
      const double offset = double(contact.offset);
      const size_t node = problem.first[b] + contact.node;
      problem.touched[node] = true;
      problem.contact[node].push_back(
          {normal, offset, carried + (offset - normal.dot(carried)) * normal, double(contact.friction)});
    }
    stiffen_anchors(model, parameters, double(anchor_share) * options.mass / (h * h), problem.first[b], problem);
  }
  for (size_t i = 0; i < x.size(); ++i) {
    if (problem.fixed[i]) x[i] = problem.before[i] = problem.rest[i];
  }
  ReferenceStep solved;
  const Solution solution = solve(problem, x, solved);
  std::vector<ReferenceStep> out(bodies.size(), solved);
  size_t tets = 0;
  for (size_t b = 0; b < bodies.size(); ++b) {
    ReferenceStep& step = out[b];
    Positions& node = bodies[b].state.node;
    step.contact_force.assign(node.size(), Vector3d::Zero());
    for (size_t k = 0; k < node.size(); ++k) {
      const size_t i = problem.first[b] + k;
      const Hold& hold = solution.hold[i];
      step.drag_work += problem.drag[i] * (x[i] - problem.before[i]).squaredNorm();
      node[k] = x[i];
      if (hold.planes == 0) continue;
      ++step.held;
      step.sliding += hold.rubs && !hold.sticks;
      step.contact_force[k] = hold.rubs ? solution.forces.gradient[i] : hold.force;
      step.force += step.contact_force[k];
    }
    flow_all(problem, x, tets, bodies[b].state, step);
    tets += bodies[b].model.tet.size();
  }
  for (size_t k = 0; k < pairs.size(); ++k) {
    const Pair::Force force = problem.pair[k].force(x);
    pairs[k].pressed = float(force.pressed);
    pairs[k].force = (force.pressed * problem.pair[k].normal + force.rub).cast<float>();
    pairs[k].heat = float(-force.rub.dot(force.slip));
  }
  return out;
}

ReferenceStep step_reference(const Model& model, const Parameters& parameters, std::span<const Contact> contacts, double h,
                             const ReferenceOptions& options, ReferenceState& state) {
  const ReferenceBody body{model, parameters, contacts, state};
  return step_reference({&body, 1}, {}, h, options).front();
}

void follow_reference(std::span<const ReferenceCar> cars, std::span<const Obstacle> obstacles, double h,
                      const ReferenceOptions& options, const ReferencePairWatch& watch) {
  Mass fixed;
  fixed.mass = std::numeric_limits<double>::infinity();
  fixed.inertia.setConstant(fixed.mass);
  std::vector<DeformableState> bodies;
  std::vector<Motion> motions(cars.size());
  std::vector<ScratchHandle> scratch;
  std::vector<ContactSet> contacts(cars.size());  // with candidates: any node may meet any obstacle
  std::vector<PairCandidates> near;               // ... and any triangle of another car
  std::vector<Member> members;
  bodies.reserve(cars.size());  // members point to them
  for (uint32_t c = 0; c < cars.size(); ++c) {
    const Model& model = cars[c].model;
    for (uint32_t k = 0; k < obstacles.size(); ++k) {
      contacts[c].candidate.push_back({k, {}});
      for (uint32_t i = 0; i < model.node.size(); ++i) contacts[c].candidate[k].node.push_back(i);
    }
    for (uint32_t other = 0; other < cars.size(); ++other) {
      if (other == c) continue;
      PairCandidates& pair = near.emplace_back(PairCandidates{{c, other}, model.boundary->node, {}});
      for (uint32_t k = 0; k < cars[other].model.boundary->triangle.size(); ++k) pair.triangle.push_back(k);
    }
    bodies.push_back(make_body(model));
    scratch.push_back(make_scratch());
    members.push_back({{model, cars[c].parameters, fixed, obstacles, h}, c + 1, *scratch[c], {bodies[c], motions[c]}});
  }
  const std::vector<float> share(cars.size(), 1.0f);
  for (size_t k = 0; k + 1 < cars.front().path.size(); ++k) {
    std::vector<Pose> from, to;
    for (size_t c = 0; c < cars.size(); ++c) {
      from.push_back(cars[c].path[k]);
      to.push_back(cars[c].path[k + 1]);
      for (size_t i = 0; i < bodies[c].node.size(); ++i) bodies[c].node[i] = cars[c].state.node[i].cast<float>();
      measure_reach(cars[c].model, bodies[c]);
      find_contacts(bodies[c], obstacles, {from[c], to[c], double(k) * h, h}, contacts[c]);
    }
    std::vector<ReferenceStep> steps(cars.size());
    std::vector<PairContact> met;
    for (PairGroup& group : find_pairs(members, near, from, to, share, h)) {
      std::vector<ReferenceBody> part;
      for (uint32_t c : group.member) part.push_back({cars[c].model, cars[c].parameters, contacts[c].contact, cars[c].state});
      const std::vector<ReferenceStep> solved = step_reference(part, group.contact, h, options);
      for (size_t p = 0; p < part.size(); ++p) steps[group.member[p]] = solved[p];
      remember_pairs(members, group);
      for (PairContact& contact : group.contact) {
        for (uint32_t& car : contact.car) car = group.member[car];
        met.push_back(contact);
      }
    }
    for (size_t c = 0; c < cars.size(); ++c) {
      for (size_t i = 0; i < bodies[c].node.size(); ++i) {
        bodies[c].step[i] = cars[c].state.node[i].cast<float>() - bodies[c].node[i];
      }
    }
    if (watch) watch(k, steps, met);
  }
}

void follow_reference(const Model& model, const Parameters& parameters, std::span<const Obstacle> obstacles,
                      std::span<const Pose> path, double h, const ReferenceOptions& options, const ReferenceWatch& watch,
                      ReferenceState& state) {
  const ReferenceCar car{model, parameters, path, state};
  follow_reference({&car, 1}, obstacles, h, options, [&](size_t k, std::span<const ReferenceStep> steps, const auto&) {
    if (watch) watch(k, steps.front());
  });
}

double reference_potential(const Model& model, const Parameters& parameters, const ReferenceState& before, double h,
                           std::span<const Vector3d> node, std::vector<Vector3d>* gradient) {
  Problem problem;
  problem.add(model, parameters, h, before);
  Forces all = forces(problem, node);
  if (gradient) *gradient = std::move(all.gradient);
  return all.energy;
}

}  // namespace crumple

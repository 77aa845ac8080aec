// Each node has a basis Z of the directions in which it may move: three columns if it is free, none if it is anchored or
// sticks. The Newton system is Z^T K Z. Names: g gradient of the potential, N; gap = normal . x - offset, m.
#include "reference/newton.h"

#include <Eigen/Sparse>
#include <algorithm>
#include <cmath>

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

struct Problem {
  const Model& model;
  const ReferenceState& start;
  ReferenceOptions options;
  std::vector<ReferenceMaterial> material;   // per region
  std::vector<double> drag, anchor;          // per node, N/m
  std::vector<double> grip;                  // per node: about its stiffness, N/m
  std::vector<char> fixed;                   // per node
  std::vector<std::vector<Plane3>> contact;  // per node

  Problem(const Model& m, const Parameters& parameters, double h, const ReferenceOptions& o, const ReferenceState& s)
      : model(m),
        start(s),
        options(o),
        drag(m.node.size()),
        anchor(m.node.size(), 0.0),
        grip(m.node.size(), 0.0),
        fixed(m.node.size()),
        contact(m.node.size()) {
    for (const Material& each : parameters.region) material.push_back(reference_material(each));
    double volume = 0;
    for (float each : m.tet_rest) volume += double(each);
    for (size_t i = 0; i < m.node.size(); ++i) {
      drag[i] = double(parameters.region[m.node_region[i]].drag) * double(m.node_mass[i]) / double(m.mass) * volume / h;
      fixed[i] = m.node_anchored[i] != 0;
    }
    for (size_t t = 0; t < m.tet.size(); ++t) {
      for (int k = 0; k < 4; ++k) {
        grip[m.tet[t].node[k]] +=
            material[m.tet_region[t]].mu * double(m.tet_rest[t]) * corner_of(s.gradients[t], k).squaredNorm();
      }
    }
  }
};

Matrix3d rows_of(const Gradients& gradients) {
  Matrix3d rows;
  for (int k = 0; k < 3; ++k) rows.row(k) = gradients.corner[k].transpose().cast<double>();
  return rows;
}

Matrix3d deformation_of(const Tet& tet, const Matrix3d& rows, std::span<const Vector3d> x) {
  Matrix3d edges;
  for (int k = 0; k < 3; ++k) edges.col(k) = x[tet.node[k + 1]] - x[tet.node[0]];
  return edges * rows;
}

// Attaches springs to the anchored nodes that contacts reach, like stiffen_anchors in nodal.cpp.
void stiffen_anchors(const Parameters& parameters, double most, Problem& problem) {
  const Model& model = problem.model;
  double sum = 0;
  for (size_t i = 0; i < model.node.size(); ++i) {
    if (!model.node_anchored[i] || problem.contact[i].empty()) continue;
    problem.fixed[i] = false;
    for (uint32_t k = model.node_first[i]; k < model.node_first[i + 1]; ++k) {
      const uint32_t tet = model.corner[k] / 4;
      const Vector3d g = corner_of(rows_of(model.gradients[tet]), int(model.corner[k] % 4));
      problem.anchor[i] += double(anchor_ratio) * double(parameters.region[model.tet_region[tet]].young_modulus) *
                           double(model.tet_rest[tet]) * g.squaredNorm();
    }
    sum += problem.anchor[i];
  }
  if (!(sum > most)) return;
  for (double& each : problem.anchor) each *= most / sum;
}

struct Forces {
  Positions gradient;  // per node, N
  double largest = 0;  // largest force of a tet on a corner, N: residuals are relative to it
  double energy = 0;   // J
};

Forces forces(const Problem& problem, std::span<const Vector3d> x) {
  const Model& model = problem.model;
  Forces out;
  out.gradient.resize(x.size());
  for (size_t i = 0; i < x.size(); ++i) {
    const Vector3d moved = x[i] - problem.start.node[i], sprung = x[i] - model.node[i].cast<double>();
    out.gradient[i] = problem.drag[i] * moved + problem.anchor[i] * sprung;
    out.energy += 0.5 * (problem.drag[i] * moved.squaredNorm() + problem.anchor[i] * sprung.squaredNorm());
  }
  for (size_t t = 0; t < model.tet.size(); ++t) {
    const Matrix3d& rows = problem.start.gradients[t];
    const double volume = double(model.tet_rest[t]);
    const TetLaw law = tet_law(problem.options.law, problem.material[model.tet_region[t]],
                               deformation_of(model.tet[t], rows, x), problem.start.hardening[t], false, false);
    out.energy += volume * law.energy;
    for (int k = 0; k < 4; ++k) {
      const Vector3d force = volume * law.stress * corner_of(rows, k);
      out.gradient[model.tet[t].node[k]] += force;
      const double noise = noise_strain * volume * problem.material[model.tet_region[t]].mu * corner_of(rows, k).norm();
      out.largest = std::max({out.largest, force.norm(), noise});
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
  const Model& model = problem.model;
  Entries entries;
  entries.reserve(model.tet.size() * 144 + x.size() * 9);
  for (size_t i = 0; i < x.size(); ++i) {
    add_block(3 * i, 3 * i, (problem.drag[i] + problem.anchor[i]) * Matrix3d::Identity() + hold[i].stiff, entries);
  }
  for (size_t t = 0; t < model.tet.size(); ++t) {
    const Matrix3d& rows = problem.start.gradients[t];
    const TetLaw law = tet_law(problem.options.law, problem.material[model.tet_region[t]],
                               deformation_of(model.tet[t], rows, x), problem.start.hardening[t], true, project);
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b) {
        const Vector3d ga = corner_of(rows, a), gb = corner_of(rows, b);
        Matrix3d block = Matrix3d::Zero();
        for (int i = 0; i < 3; ++i) {
          for (int k = 0; k < 3; ++k) block += ga[i] * gb[k] * law.tangent.block<3, 3>(3 * i, 3 * k);
        }
        add_block(3 * model.tet[t].node[a], 3 * model.tet[t].node[b], double(model.tet_rest[t]) * block, entries);
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

Solution solve(const Problem& problem, Positions& x, ReferenceStep& step) {
  Solution now{forces(problem, x), std::vector<Hold>(x.size())};
  for (int pass = 0; pass <= problem.options.most_passes; ++pass) {
    double worst = 0;
    bool driven = false;
    for (size_t i = 0; i < x.size(); ++i) {
      now.hold[i] = hold_of(problem, i, x[i], now.forces.gradient[i]);
      worst = std::max(worst, now.hold[i].wrong);
      driven = driven || now.hold[i].driven.norm() > touching_gap;
    }
    step.residual.push_back(worst / now.forces.largest);
    step.converged = step.residual.back() <= problem.options.tolerance;
    if (step.converged) break;
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

void flow_all(const Problem& problem, const Positions& x, ReferenceState& state, ReferenceStep& step) {
  const Model& model = problem.model;
  for (size_t t = 0; t < model.tet.size(); ++t) {
    const Matrix3d f = deformation_of(model.tet[t], state.gradients[t], x);
    step.inverted += f.determinant() <= smallest_flowing_ratio;
    const Flowed flowed = flow_reference(problem.options.law, problem.material[model.tet_region[t]], f, state.hardening[t]);
    state.hardening[t] += flowed.growth;
    step.plastic_work += double(model.tet_rest[t]) * flowed.work;
    state.gradients[t] = state.gradients[t] * flowed.factor;  // rows: b^T factor, and factor is symmetric
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

ReferenceStep step_reference(const Model& model, const Parameters& parameters, std::span<const Contact> contacts, double h,
                             const ReferenceOptions& options, ReferenceState& state) {
  Problem problem(model, parameters, h, options, state);
  for (const Contact& contact : contacts) {
    const Vector3d normal = contact.normal.cast<double>().normalized(), carried = contact.carried.cast<double>();
    const double offset = double(contact.offset);
    problem.contact[contact.node].push_back(
        {normal, offset, carried + (offset - normal.dot(carried)) * normal, double(contact.friction)});
  }
  stiffen_anchors(parameters, double(anchor_share) * options.mass / (h * h), problem);
  for (size_t i = 0; i < state.node.size(); ++i) {
    if (problem.fixed[i]) state.node[i] = model.node[i].cast<double>();
  }
  ReferenceStep step;
  Positions x = state.node;
  const Solution solution = solve(problem, x, step);
  step.contact_force.assign(x.size(), Vector3d::Zero());
  for (size_t i = 0; i < x.size(); ++i) {
    const Hold& hold = solution.hold[i];
    step.drag_work += problem.drag[i] * (x[i] - state.node[i]).squaredNorm();
    if (hold.planes == 0) continue;
    ++step.held;
    step.sliding += hold.rubs && !hold.sticks;
    step.contact_force[i] = hold.rubs ? solution.forces.gradient[i] : hold.force;
    step.force += step.contact_force[i];
  }
  flow_all(problem, x, state, step);
  state.node = std::move(x);
  return step;
}

void follow_reference(const Model& model, const Parameters& parameters, std::span<const Obstacle> obstacles,
                      std::span<const Pose> path, double h, const ReferenceOptions& options, const ReferenceWatch& watch,
                      ReferenceState& state) {
  ContactSet contacts;  // with candidates: any node may meet any obstacle
  for (uint32_t k = 0; k < obstacles.size(); ++k) {
    contacts.candidate.push_back({k, {}});
    for (uint32_t i = 0; i < model.node.size(); ++i) contacts.candidate[k].node.push_back(i);
  }
  DeformableState body;
  body.node.resize(model.node.size());
  for (size_t k = 0; k + 1 < path.size(); ++k) {
    for (size_t i = 0; i < body.node.size(); ++i) body.node[i] = state.node[i].cast<float>();
    find_contacts(body, obstacles, {path[k], path[k + 1], double(k) * h, h}, contacts);
    const ReferenceStep step = step_reference(model, parameters, contacts.contact, h, options, state);
    if (watch) watch(k, step);
  }
}

double reference_potential(const Model& model, const Parameters& parameters, const ReferenceState& before, double h,
                           std::span<const Vector3d> node, std::vector<Vector3d>* gradient) {
  const Problem problem(model, parameters, h, {}, before);
  Forces all = forces(problem, node);
  if (gradient) *gradient = std::move(all.gradient);
  return all.energy;
}

}  // namespace crumple

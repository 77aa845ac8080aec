#include "bake/finish_tets.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "bake/choose_solid_nodes.h"
#include "bake/near_triangles.h"

namespace crumple {
namespace {

using Eigen::Vector3d;

// Qualities are cubes of the mean ratio of a tet (1 regular, 0 flat, below 0 turned over): no root, no rounding of a library.
constexpr double cube(double x) { return x * x * x; }
constexpr double goal = cube(0.6);            // where climbing stops
constexpr double floor_quality = cube(0.42);  // which no pull may fall below: dihedral angles of 16 to 150 degrees
constexpr double floor_to_climb = cube(0.47);
constexpr double cosine_of_18_degrees = 0.951;
constexpr double smallest_tet = 0.08;  // of a lattice's; smaller ones count for less: they would set the solver's pace

// ---- tets whose nodes move -----------------------------------------------------------------------------------------------

struct Moving {
  std::vector<Vector3d>& node;
  const std::vector<Tet>& tet;
  std::vector<Triangle> outside;
  Mask on_outside;                        // a node
  std::vector<uint32_t> first, incident;  // tets of node v: incident[first[v]] .. incident[first[v + 1]]
  double spacing, least_volume;
};

Moving moving(FineTets& tets, double spacing) {
  Moving out{tets.node, tets.tet, boundary({{}, tets.tet}), {}, {}, {}, spacing, 0};
  out.least_volume = smallest_tet * spacing * spacing * spacing / 12;
  out.on_outside.assign(tets.node.size(), 0);
  for (const Triangle& triangle : out.outside)
    for (uint32_t v : triangle) out.on_outside[v] = 1;
  out.first.assign(tets.node.size() + 1, 0);
  for (const Tet& tet : tets.tet)
    for (uint32_t v : tet.node) ++out.first[v + 1];
  std::partial_sum(out.first.begin(), out.first.end(), out.first.begin());
  out.incident.resize(4 * tets.tet.size());
  std::vector<uint32_t> next(out.first.begin(), out.first.end() - 1);
  for (uint32_t t = 0; t < tets.tet.size(); ++t)
    for (uint32_t v : tets.tet[t].node) out.incident[next[v]++] = t;
  return out;
}

// The mean ratio is 12 (3 V)^(2/3) over the sum of the squared edges.
double quality(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d, double least_volume) {
  const Vector3d u = b - a, v = c - a, w = d - a;
  const double six = u.cross(v).dot(w);
  const double edges = u.squaredNorm() + v.squaredNorm() + w.squaredNorm() + (v - u).squaredNorm() + (w - u).squaredNorm() +
                       (w - v).squaredNorm();
  const double small = std::min(1.0, std::abs(six) / (6 * least_volume));
  return 432 * six * std::abs(six) / cube(edges) * cube(small);
}

// The largest cosine of a dihedral angle, with its sign turned: more is better.
double smallest_angle(const Vector3d& a, const Vector3d& b, const Vector3d& c, const Vector3d& d, double) {
  const Vector3d u = b - a, v = c - a, w = d - a;
  if (u.cross(v).dot(w) <= 0) return -2;
  const Vector3d normal[4] = {(v - u).cross(w - u), w.cross(v), u.cross(w), v.cross(u)};
  double length[4], cosine = -1;
  for (int i = 0; i < 4; ++i) {
    length[i] = std::sqrt(normal[i].squaredNorm());
    for (int j = 0; j < i; ++j) cosine = std::max(cosine, -normal[i].dot(normal[j]) / (length[i] * length[j]));
  }
  return -cosine;
}

// The worst tet around a node if it were at `place`; any number below `enough` once one is.
template <auto measure = quality>
double worst_around(const Moving& mesh, uint32_t node, const Vector3d& place, double enough = -HUGE_VAL) {
  double worst = HUGE_VAL;
  for (uint32_t i = mesh.first[node]; i < mesh.first[node + 1] && worst >= enough; ++i) {
    const uint32_t* v = mesh.tet[mesh.incident[i]].node;
    const auto at = [&](int k) -> const Vector3d& { return v[k] == node ? place : mesh.node[v[k]]; };
    worst = std::min(worst, measure(at(0), at(1), at(2), at(3), mesh.least_volume));
  }
  return worst;
}

// What no move but one for the quality itself may fall below.
double least_quality(const Moving& mesh, uint32_t node) {
  return std::min(floor_quality, worst_around(mesh, node, mesh.node[node]));
}

std::vector<Vector3d> outside_normals(const Moving& mesh) {
  std::vector<Vector3d> out(mesh.node.size(), Vector3d::Zero());
  for (const auto& [a, b, c] : mesh.outside) {
    const Vector3d normal = (mesh.node[b] - mesh.node[a]).cross(mesh.node[c] - mesh.node[a]);
    out[a] += normal, out[b] += normal, out[c] += normal;
  }
  for (Vector3d& normal : out) normal /= std::max(std::sqrt(normal.squaredNorm()), 1e-12);
  return out;
}

// The same numbers everywhere: Knuth's MMIX.
struct Draw {
  uint64_t state = 1;
  double operator()() {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return double(state >> 11) / double(uint64_t{1} << 52) - 1;  // -1 to 1
  }
};

Vector3d mean_around(const Moving& mesh, uint32_t node) {
  Vector3d sum = Vector3d::Zero();
  for (uint32_t i = mesh.first[node]; i < mesh.first[node + 1]; ++i)
    for (uint32_t v : mesh.tet[mesh.incident[i]].node) sum += mesh.node[v];
  return sum / (4.0 * (mesh.first[node + 1] - mesh.first[node]));
}

// Hill-climbing on the worst tet around each node: towards the mean of its neighbours, then at random, ever closer. Nodes of
// the outside slide along it, mostly.
template <auto measure = quality>
void climb(Moving& mesh, int sweeps, double until, double step) {
  constexpr int trials = 16;
  constexpr double off_the_surface = 0.1;
  const std::vector<Vector3d> normal = outside_normals(mesh);
  Draw draw;
  for (int sweep = 0; sweep < sweeps; ++sweep) {
    size_t moved = 0;
    for (uint32_t v = 0; v < mesh.node.size(); ++v) {
      const double before = worst_around<measure>(mesh, v, mesh.node[v]);
      if (before > until) continue;
      const Vector3d start = mesh.node[v], to_mean = mean_around(mesh, v) - start;
      Vector3d best = start;
      const double least = measure == quality ? -HUGE_VAL : least_quality(mesh, v);
      double best_quality = before, reach = 1.7 * step;
      for (int trial = 0; trial < trials; ++trial) {
        Vector3d way = trial == 0 ? 1.2 * to_mean : 0.6 * to_mean;
        if (trial >= 2) {
          const double x = draw(), y = draw(), z = draw();
          way = Vector3d(x, y, z) * reach;
          if (trial % 5 == 4) reach *= 0.6;
        }
        if (mesh.on_outside[v]) way -= (1 - off_the_surface) * normal[v].dot(way) * normal[v];
        const Vector3d place = (trial < 2 ? start : best) + way;
        const double reached = worst_around<measure>(mesh, v, place, best_quality);
        if (reached > best_quality && worst_around(mesh, v, place, least) >= least) best_quality = reached, best = place;
      }
      moved += best_quality > before;
      mesh.node[v] = best;
    }
    if (moved == 0) return;
  }
}

// As far towards `target` as the tets stay good.
void pull(Moving& mesh, uint32_t node, const Vector3d& target) {
  constexpr int steps = 6;
  const Vector3d start = mesh.node[node];
  const double least = least_quality(mesh, node);
  for (int k = steps; k > 0; --k) {
    const Vector3d place = start + (target - start) * (double(k) / steps);
    if (worst_around(mesh, node, place, least) < least) continue;
    mesh.node[node] = place;
    return;
  }
}

// ---- fitting to what is drawn --------------------------------------------------------------------------------------------

// From the nearest drawn point to this one.
Vector3d offset_from_drawn(const DrawnSurface& drawn, const Vector3d& point) {
  const auto offset = [&](uint32_t t) {
    const auto& [a, b, c] = drawn.triangle[t];
    return offset_from_triangle(point, drawn.vertex[a].cast<double>(), drawn.vertex[b].cast<double>(),
                                drawn.vertex[c].cast<double>());
  };
  return offset(find_nearest(drawn.tree, point, [&](uint32_t t) { return offset(t).squaredNorm(); }).index);
}

// What the voxels rounded.
void snap_to_drawn(const DrawnSurface& drawn, double within, Moving& mesh) {
  for (uint32_t v = 0; v < mesh.node.size(); ++v) {
    if (!mesh.on_outside[v]) continue;
    const Vector3d offset = offset_from_drawn(drawn, mesh.node[v]);
    if (offset.squaredNorm() < within * within) pull(mesh, v, mesh.node[v] - offset);
  }
}

// Nodes that stand in front of all that is drawn, as around thin parts, come closer to it.
void press_in(const DrawnSurface& drawn, const FilledSurface& filled, Moving& mesh) {
  constexpr double in_front = 0.2, worth_it = 0.25, share = 0.7;  // spacings, spacings
  for (uint32_t v = 0; v < mesh.node.size(); ++v) {
    if (!mesh.on_outside[v]) continue;
    if (interpolate(filled.voxels, filled.depth, mesh.node[v]) > -in_front * mesh.spacing) continue;
    const Vector3d offset = offset_from_drawn(drawn, mesh.node[v]);
    const double distance = std::sqrt(offset.squaredNorm());
    if (distance > worth_it * mesh.spacing)
      pull(mesh, v, mesh.node[v] - offset * (share * (1 - in_front * mesh.spacing / distance)));
  }
}

// Of each outside node the farthest drawn point that sticks out beside it pulls it. Returns how many points stick out.
size_t pull_out(const std::vector<Vector3d>& points, Moving& mesh) {
  constexpr double sticks_out = 0.08, reach = 0.7, longest_step = 0.3, at_once = 0.45;  // spacings
  const double a = mesh.spacing;
  const NearTriangles hull(mesh.node, mesh.outside, reach * a);
  struct Wish {
    double squared = 0;
    Vector3d target;
  };
  std::vector<Wish> wish(mesh.node.size());
  size_t count = 0;
  for (const Vector3d& point : points) {
    const auto near = hull.find(point);
    if (!near || !near->in_front) continue;
    const double squared = near->offset.squaredNorm();
    if (squared < sticks_out * sticks_out * a * a) continue;
    ++count;
    const Vector3d foot = point - near->offset;
    const Triangle& corners = mesh.outside[near->triangle];
    const auto to_foot = [&](uint32_t v) { return (mesh.node[v] - foot).squaredNorm(); };
    const uint32_t v =
        *std::min_element(corners.begin(), corners.end(), [&](uint32_t p, uint32_t q) { return to_foot(p) < to_foot(q); });
    if (squared <= wish[v].squared) continue;
    const bool direct = (point - mesh.node[v]).squaredNorm() < at_once * at_once * a * a;
    const double step = std::min(1.0, longest_step * a / std::sqrt(squared));
    wish[v] = {squared, direct ? point : Vector3d(mesh.node[v] + step * near->offset)};
  }
  for (uint32_t v = 0; v < wish.size(); ++v)
    if (wish[v].squared > 0) pull(mesh, v, wish[v].target);
  return count;
}

}  // namespace

DrawnSurface drawn_surface(std::span<const Vec3> vertices, std::span<const Triangle> triangles) {
  std::vector<Box> boxes(triangles.size());
  for (size_t t = 0; t < boxes.size(); ++t)
    for (uint32_t v : triangles[t]) boxes[t].extend(vertices[v].cast<double>());
  return {vertices, triangles, build_tree(boxes)};
}

void finish_tets(const DrawnSurface& drawn, const FilledSurface& filled, double spacing, FineTets& tets) {
  constexpr int rounds = 6;
  Moving mesh = moving(tets, spacing);
  snap_to_drawn(drawn, 1.2 * filled.voxels.size, mesh);
  climb(mesh, 20, goal, 0.12 * spacing);
  std::vector<Vector3d> points;
  for (const Vec3& vertex : drawn.vertex) points.push_back(vertex.cast<double>());
  points.insert(points.end(), filled.sample.begin(), filled.sample.end());
  points = thinned_out(points, 0.1 * spacing);
  for (int round = 0; round < rounds; ++round) {
    press_in(drawn, filled, mesh);
    if (pull_out(points, mesh) == 0) break;
    climb(mesh, 3, floor_to_climb, 0.1 * spacing);
  }
  climb(mesh, 4, goal, 0.06 * spacing);
  climb<smallest_angle>(mesh, 12, -cosine_of_18_degrees, 0.06 * spacing);
}

Outliers find_outliers(const DrawnSurface& drawn, const FineTets& tets, double limit, double spacing) {
  constexpr double reach = 1.5;  // spacings: the nodes nearest to all that is drawn are solid
  const std::vector<Triangle> outside = boundary({{}, tets.tet});
  const NearTriangles hull(tets.node, outside, reach * spacing);
  Outliers out;
  for (const Vec3& vertex : drawn.vertex) {
    const Vector3d point = vertex.cast<double>();
    const auto near = hull.find(point);
    if (!near || !near->in_front) continue;
    const double distance = std::sqrt(near->offset.squaredNorm());
    out.farthest = std::max(out.farthest, distance);
    if (distance > limit) out.point.push_back(point);
  }
  return out;
}

AngleRange dihedral_angles(const TetMesh& mesh) {
  AngleRange out{180, 0};
  constexpr int face[4][3] = {{1, 3, 2}, {0, 2, 3}, {0, 3, 1}, {0, 1, 2}};
  for (const Tet& tet : mesh.tet) {
    Vector3d corner[4], normal[4];
    for (int k = 0; k < 4; ++k) corner[k] = mesh.node[tet.node[k]].cast<double>();
    for (int k = 0; k < 4; ++k)
      normal[k] = (corner[face[k][1]] - corner[face[k][0]]).cross(corner[face[k][2]] - corner[face[k][0]]).normalized();
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < i; ++j) {
        const double angle = std::acos(std::clamp(-normal[i].dot(normal[j]), -1.0, 1.0)) * 180 / 3.14159265358979323846;
        out.least = std::min(out.least, angle);
        out.most = std::max(out.most, angle);
      }
  }
  return out;
}

}  // namespace crumple

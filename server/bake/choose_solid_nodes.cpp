#include "bake/choose_solid_nodes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <queue>

namespace crumple {
namespace {

// All in spacings of the lattice.
constexpr double deep = 0.25;          // below this depth the lattice holds a point for sure
constexpr double covered = 0.3;        // what may stick out of it
constexpr double thickness = 0.45;     // radius of the ball that a point of a thin part gets
constexpr double sticking_out = 0.05;  // of this ball, when it is shifted inwards
constexpr double ball_reach = 1.6;     // no edge that the ball's surface cuts ends beyond
constexpr double held_depth = 0.3;     // of a node that is solid in any case
constexpr double already_solid = 0.02;
constexpr double thin_points_apart = 0.15;
constexpr double least_depth = 1e-9;  // instead of zero

// The mean way from a point to the solid around it, with a length of 1 beside a flat wall: towards it, 0 in the middle of it.
Eigen::Vector3d inward(const FilledSurface& filled, const Eigen::Vector3d& point, double reach) {
  const Voxels& voxels = filled.voxels;
  const Eigen::Vector3d g = (point - voxels.origin) / voxels.size;
  const double radius = reach / voxels.size;
  int low[3], high[3];
  for (int k = 0; k < 3; ++k) {
    low[k] = std::max(0, static_cast<int>(g[k] - radius) + 1);
    high[k] = std::min(voxels.count[k] - 1, static_cast<int>(g[k] + radius));
  }
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int k = low[2]; k <= high[2]; ++k)
    for (int j = low[1]; j <= high[1]; ++j)
      for (int i = low[0]; i <= high[0]; ++i) {
        if (!filled.inside[voxels.index(i, j, k)]) continue;
        const Eigen::Vector3d way = Eigen::Vector3d(i, j, k) - g;
        const double weight = 1 - way.squaredNorm() / (radius * radius);
        if (weight > 0) sum += weight * way;
      }
  constexpr double pi = 3.14159265358979323846;
  return sum / (pi / 12 * radius * radius * radius * radius);  // the integral of weight times height over half a ball
}

// Points of the surface that stick out of what the lattice holds by itself.
std::vector<Eigen::Vector3d> thin_points(const FilledSurface& filled, double spacing) {
  Mask held(filled.depth.size());
  for (size_t v = 0; v < held.size(); ++v) held[v] = double(filled.depth[v]) > deep * spacing;
  std::vector<float> away(held.size());
  {
    const std::vector<int32_t> squared = squared_distances(filled.voxels, held, true);
    for (size_t v = 0; v < away.size(); ++v) away[v] = float(std::sqrt(double(squared[v])) * filled.voxels.size);
  }
  std::vector<Eigen::Vector3d> out;
  for (const Eigen::Vector3d& point : filled.sample)
    if (interpolate(filled.voxels, away, point) > (deep + covered) * spacing) out.push_back(point);
  return thinned_out(out, thin_points_apart * spacing);
}

// A sheet is thickened inwards: its outer face stays where it is drawn.
void shift_inwards(const FilledSurface& filled, double spacing, std::vector<Eigen::Vector3d>& points) {
  for (Eigen::Vector3d& point : points) {
    const Eigen::Vector3d way = inward(filled, point, spacing);
    const double length = way.norm();
    if (length > 1e-9) point += way / length * std::min(1.0, 2 * length) * (thickness - sticking_out) * spacing;
  }
}

uint32_t nearest_node(const Lattice& lattice, const Eigen::Vector3d& point) {
  const Eigen::Vector3d g = (point - lattice.origin) / lattice.spacing;
  const auto of = [&](double value, int k, uint32_t less) {
    return static_cast<uint32_t>(std::clamp(value, 0.0, double(lattice.corners[k] - 1 - less)));
  };
  const uint32_t corner = lattice.corner(of(g.x() + 0.5, 0, 0), of(g.y() + 0.5, 1, 0), of(g.z() + 0.5, 2, 0));
  const uint32_t center = lattice.center(of(g.x(), 0, 1), of(g.y(), 1, 1), of(g.z(), 2, 1));
  const auto squared = [&](uint32_t node) { return (lattice.position(node) - point).squaredNorm(); };
  return squared(corner) <= squared(center) ? corner : center;
}

// depth = max(depth, radius - distance to the point), for nodes within reach.
void add_ball(const Lattice& lattice, const Eigen::Vector3d& point, double radius, double reach, std::vector<double>& depth) {
  for (const uint32_t less : {0u, 1u}) {
    const Eigen::Vector3d g = (point - lattice.origin).array() / lattice.spacing - 0.5 * less;
    uint32_t low[3], high[3];
    for (int k = 0; k < 3; ++k) {
      const double last = lattice.corners[k] - 1 - less;
      low[k] = static_cast<uint32_t>(std::clamp(std::ceil(g[k] - reach / lattice.spacing), 0.0, last));
      high[k] = static_cast<uint32_t>(std::clamp(std::floor(g[k] + reach / lattice.spacing), 0.0, last));
    }
    for (uint32_t i = low[0]; i <= high[0]; ++i)
      for (uint32_t j = low[1]; j <= high[1]; ++j)
        for (uint32_t k = low[2]; k <= high[2]; ++k) {
          const double distance = (Eigen::Vector3d(i, j, k) - g).norm() * lattice.spacing;
          if (distance > reach) continue;
          double& own = depth[less ? lattice.center(i, j, k) : lattice.corner(i, j, k)];
          own = std::max(own, radius - distance);
        }
  }
}

// Of each solid node the lowest solid node that it hangs together with by edges.
std::vector<uint32_t> pieces_of(const Lattice& lattice, const std::vector<double>& depth) {
  std::vector<uint32_t> out(depth.size(), UINT32_MAX), front;
  for (uint32_t seed = 0; seed < depth.size(); ++seed) {
    if (!(depth[seed] > 0) || out[seed] != UINT32_MAX) continue;
    out[seed] = seed;
    front = {seed};
    while (!front.empty()) {
      const uint32_t v = front.back();
      front.pop_back();
      for_each_neighbor(lattice, v, [&](uint32_t w) {
        if (depth[w] > 0 && out[w] == UINT32_MAX) out[w] = seed, front.push_back(w);
      });
    }
  }
  return out;
}

// Dijkstra's shortest ways from one piece to all nodes; ways through the solid cost next to nothing.
struct Ways {
  std::vector<double> cost;      // m
  std::vector<uint32_t> before;  // the next node on the way back
};

Ways ways_from(const Lattice& lattice, const std::vector<double>& depth, const std::vector<uint32_t>& piece, uint32_t main) {
  constexpr double through_solid = 0.01;
  Ways out{std::vector<double>(depth.size(), HUGE_VAL), std::vector<uint32_t>(depth.size(), UINT32_MAX)};
  using Entry = std::pair<double, uint32_t>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
  for (uint32_t v = 0; v < depth.size(); ++v)
    if (piece[v] == main) out.cost[v] = 0, queue.emplace(0, v);
  const double along = lattice.spacing, across = std::sqrt(0.75) * lattice.spacing;
  while (!queue.empty()) {
    const double cost = queue.top().first;
    const uint32_t v = queue.top().second;
    queue.pop();
    if (cost > out.cost[v]) continue;
    for_each_neighbor(lattice, v, [&](uint32_t w) {
      const double length = lattice.is_corner(v) == lattice.is_corner(w) ? along : across;
      const double reached = cost + length * (depth[v] > 0 && depth[w] > 0 ? through_solid : 1);
      if (reached >= out.cost[w]) return;
      out.cost[w] = reached;
      out.before[w] = v;
      queue.emplace(reached, w);
    });
  }
  return out;
}

void hold(LatticeSolid& solid, uint32_t node, double depth) {
  solid.depth[node] = std::max(solid.depth[node], depth);
  solid.held[node] = 1;
}

void join_pieces(const Lattice& lattice, SolidNodes& nodes) {
  LatticeSolid& solid = nodes.solid;
  const std::vector<uint32_t> piece = pieces_of(lattice, solid.depth);
  std::vector<uint32_t> size(piece.size(), 0), nearest(piece.size(), UINT32_MAX);
  for (uint32_t p : piece)
    if (p != UINT32_MAX) ++size[p];
  const auto main = static_cast<uint32_t>(std::max_element(size.begin(), size.end()) - size.begin());
  const auto count = std::count_if(size.begin(), size.end(), [](uint32_t s) { return s > 0; });
  if (count <= 1) return;
  const Ways ways = ways_from(lattice, solid.depth, piece, main);
  for (uint32_t v = 0; v < piece.size(); ++v)
    if (piece[v] != UINT32_MAX && (nearest[piece[v]] == UINT32_MAX || ways.cost[v] < ways.cost[nearest[piece[v]]]))
      nearest[piece[v]] = v;
  for (uint32_t p = 0; p < piece.size(); ++p) {
    if (size[p] == 0 || p == main) continue;
    ++nodes.joined;
    nodes.farthest = std::max(nodes.farthest, ways.cost[nearest[p]]);
    for (uint32_t v = nearest[p]; v != UINT32_MAX && piece[v] != main; v = ways.before[v])
      if (solid.depth[v] < held_depth * lattice.spacing) hold(solid, v, held_depth * lattice.spacing);
  }
}

// Where the solid is but one node thick, a surface that passes near would warp it away.
void hold_single_nodes(const Lattice& lattice, LatticeSolid& solid) {
  const double thick = thickness * lattice.spacing;
  for (uint32_t v = 0; v < solid.depth.size(); ++v) {
    if (!(solid.depth[v] > 0) || solid.depth[v] >= thick) continue;
    bool beside_thick = false;
    for_each_neighbor(lattice, v, [&](uint32_t w) { beside_thick |= solid.depth[w] >= thick; });
    solid.held[v] |= !beside_thick;
  }
}

}  // namespace

std::vector<Eigen::Vector3d> thinned_out(const std::vector<Eigen::Vector3d>& points, double spacing) {
  struct Cell {
    std::array<int64_t, 3> at;
    uint32_t point;
    auto operator<=>(const Cell&) const = default;
  };
  std::vector<Cell> cells;
  for (uint32_t i = 0; i < points.size(); ++i) {
    Cell cell{{}, i};
    for (int k = 0; k < 3; ++k) cell.at[k] = static_cast<int64_t>(std::floor(points[i][k] / spacing));
    cells.push_back(cell);
  }
  std::sort(cells.begin(), cells.end());
  cells.erase(std::unique(cells.begin(), cells.end(), [](const Cell& a, const Cell& b) { return a.at == b.at; }), cells.end());
  std::vector<Eigen::Vector3d> out;
  for (const Cell& cell : cells) out.push_back(points[cell.point]);
  return out;
}

SolidNodes choose_solid_nodes(const FilledSurface& filled, const Lattice& lattice, const std::vector<Eigen::Vector3d>& extra) {
  const double a = lattice.spacing;
  SolidNodes out;
  LatticeSolid& solid = out.solid;
  solid.depth.resize(lattice.node_count());
  solid.held.assign(lattice.node_count(), 0);
  for (uint32_t v = 0; v < solid.depth.size(); ++v)
    solid.depth[v] = interpolate(filled.voxels, filled.depth, lattice.position(v));
  std::vector<Eigen::Vector3d> thin = thin_points(filled, a);
  out.thin = thin.size();
  shift_inwards(filled, a, thin);
  for (const Eigen::Vector3d& point : thin) add_ball(lattice, point, thickness * a, ball_reach * a, solid.depth);
  for (const Eigen::Vector3d& point : thin) {
    const uint32_t v = nearest_node(lattice, point);
    if (solid.depth[v] < already_solid * a) hold(solid, v, held_depth * a);
  }
  for (const Eigen::Vector3d& point : extra) hold(solid, nearest_node(lattice, point), held_depth * a);
  join_pieces(lattice, out);
  for (double& depth : solid.depth)
    if (std::abs(depth) < least_depth * a) depth = least_depth * a;
  hold_single_nodes(lattice, solid);
  return out;
}

}  // namespace crumple

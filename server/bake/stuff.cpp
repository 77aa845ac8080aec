#include "bake/stuff.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace crumple {
namespace {

// Shares of an edge. A node is warped where the surface cuts an edge nearer to it than this: the paper's alphas, which bound
// the dihedral angles best. Long edges run along the axes, short ones to the other kind of node.
constexpr double warp_long = 0.24999, warp_short = 0.41189;
constexpr double held_away = 0.42;  // more than both: what is held needs no warping
constexpr int first_rings = 2, most_attempts = 6;

using Corners = std::array<uint32_t, 4>;

struct CutEdge {
  uint32_t inside, outside;  // nodes
  double at;                 // share of the way from inside to outside
};

uint64_t key(uint32_t a, uint32_t b) { return uint64_t{std::min(a, b)} << 32 | std::max(a, b); }

std::vector<Corners> tets_with_inside(const Lattice& lattice, const std::vector<double>& depth) {
  std::vector<Corners> out;
  for_each_tet(lattice, [&](const Corners& tet) {
    if (std::any_of(tet.begin(), tet.end(), [&](uint32_t node) { return depth[node] > 0; })) out.push_back(tet);
  });
  return out;
}

// Ascending by key, each once.
std::vector<CutEdge> cut_edges(const std::vector<Corners>& tets, const LatticeSolid& solid) {
  std::vector<uint64_t> keys;
  for (const Corners& tet : tets)
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < i; ++j)
        if ((solid.depth[tet[i]] > 0) != (solid.depth[tet[j]] > 0)) keys.push_back(key(tet[i], tet[j]));
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  std::vector<CutEdge> out;
  for (uint64_t k : keys) {
    CutEdge edge{static_cast<uint32_t>(k >> 32), static_cast<uint32_t>(k), 0};
    if (solid.depth[edge.inside] < 0) std::swap(edge.inside, edge.outside);
    edge.at = solid.depth[edge.inside] / (solid.depth[edge.inside] - solid.depth[edge.outside]);
    if (solid.held[edge.inside]) edge.at = std::max(edge.at, held_away);
    out.push_back(edge);
  }
  return out;
}

// Nodes of one value of `group` a list: index lists[first[g]] .. lists[first[g + 1]].
struct Lists {
  std::vector<uint32_t> first, entry;
};

Lists edges_of_nodes(const std::vector<CutEdge>& edges, size_t nodes) {
  Lists out{std::vector<uint32_t>(nodes + 1, 0), std::vector<uint32_t>(2 * edges.size())};
  for (const CutEdge& edge : edges) ++out.first[edge.inside + 1], ++out.first[edge.outside + 1];
  std::partial_sum(out.first.begin(), out.first.end(), out.first.begin());
  std::vector<uint32_t> next(out.first.begin(), out.first.end() - 1);
  for (uint32_t e = 0; e < edges.size(); ++e) out.entry[next[edges[e].inside]++] = out.entry[next[edges[e].outside]++] = e;
  return out;
}

struct Warped {
  std::vector<double> depth;              // 0: on the surface
  std::vector<Eigen::Vector3d> position;  // of the nodes
};

// A node moves to the cut that comes nearest, measured by its limit. Once it is there, its edges are cut no more, so that ends
// of edges that are still cut lie where they lay.
Warped warp(const Lattice& lattice, const LatticeSolid& solid, const std::vector<CutEdge>& edges, const Lists& of_node,
            std::vector<Eigen::Vector3d> position) {
  Warped out{solid.depth, std::move(position)};
  for (uint32_t node = 0; node < out.depth.size(); ++node) {
    if (solid.held[node]) continue;
    double nearest = 1;
    const CutEdge* best = nullptr;
    for (uint32_t i = of_node.first[node]; i < of_node.first[node + 1]; ++i) {
      const CutEdge& edge = edges[of_node.entry[i]];
      if (out.depth[edge.inside] == 0 || out.depth[edge.outside] == 0) continue;
      const double away = node == edge.inside ? edge.at : 1 - edge.at;
      const double share = away / (lattice.is_corner(edge.inside) == lattice.is_corner(edge.outside) ? warp_long : warp_short);
      if (share < nearest) nearest = share, best = &edge;
    }
    if (!best) continue;
    const Eigen::Vector3d a = out.position[best->inside], b = out.position[best->outside];
    out.position[node] = a + best->at * (b - a);
    out.depth[node] = 0;
  }
  return out;
}

// Solid nodes that hang together through tets with the most others stay; held are those that were solid and lie within some
// edges of the rest. Returns false if there is no rest.
bool hold_what_fell_off(const Lattice& lattice, const std::vector<Corners>& tets, const std::vector<double>& warped, int rings,
                        LatticeSolid& solid) {
  std::vector<uint32_t> above(warped.size());
  std::iota(above.begin(), above.end(), 0u);
  const auto root = [&](uint32_t i) {
    while (above[i] != i) i = above[i] = above[above[i]];
    return i;
  };
  for (const Corners& tet : tets)
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < i; ++j) {
        if (!(warped[tet[i]] > 0) || !(warped[tet[j]] > 0)) continue;
        const uint32_t a = root(tet[i]), b = root(tet[j]);
        above[std::max(a, b)] = std::min(a, b);
      }
  std::vector<uint32_t> size(warped.size(), 0);
  for (uint32_t v = 0; v < warped.size(); ++v)
    if (warped[v] > 0) ++size[root(v)];
  const auto main = static_cast<uint32_t>(std::max_element(size.begin(), size.end()) - size.begin());
  std::vector<uint32_t> near;
  Mask seen(warped.size(), 0);
  for (uint32_t v = 0; v < warped.size(); ++v)
    if (warped[v] > 0 && root(v) != main) near.push_back(v), seen[v] = 1;
  if (near.empty()) return false;
  for (size_t begin = 0; rings > 0; --rings) {
    const size_t end = near.size();
    for (; begin < end; ++begin)
      for_each_neighbor(lattice, near[begin], [&](uint32_t v) {
        if (!seen[v]) near.push_back(v), seen[v] = 1;
      });
  }
  for (uint32_t v : near) solid.held[v] |= solid.depth[v] > 0;
  return true;
}

// ---- templates -----------------------------------------------------------------------------------------------------------
// Quadrilaterals are cut from their corner with the lowest number, so that the tets on both sides cut them alike.

struct Cutter {
  const Warped& warped;
  const std::vector<CutEdge>& edges;
  uint32_t first_cut;  // the number of edge 0's cut
  std::vector<Corners> out;

  uint32_t cut(uint32_t a, uint32_t b) const {
    const auto before = [](const CutEdge& edge, uint64_t k) { return key(edge.inside, edge.outside) < k; };
    return first_cut + static_cast<uint32_t>(std::lower_bound(edges.begin(), edges.end(), key(a, b), before) - edges.begin());
  }
  // q: around.
  void pyramid(uint32_t apex, const std::array<uint32_t, 4>& q) {
    const int s = (std::min_element(q.begin(), q.end()) - q.begin()) % 2 == 0 ? 0 : 1;
    out.push_back({apex, q[s], q[s + 1], q[s + 2]});
    out.push_back({apex, q[s], q[s + 2], q[(s + 3) % 4]});
  }
  // Two triangles, a[k] beside b[k]: a tet and a pyramid, both with the lowest number at their top.
  void prism(std::array<uint32_t, 3> a, std::array<uint32_t, 3> b) {
    if (*std::min_element(b.begin(), b.end()) < *std::min_element(a.begin(), a.end())) std::swap(a, b);
    const auto i = static_cast<size_t>(std::min_element(a.begin(), a.end()) - a.begin()), j = (i + 1) % 3, k = (i + 2) % 3;
    out.push_back({a[i], b[i], b[j], b[k]});
    pyramid(a[i], {a[j], a[k], b[k], b[j]});
  }
  void take(Corners tet) {
    const auto sign = [&](uint32_t v) { return warped.depth[v] > 0 ? 1 : warped.depth[v] < 0 ? -1 : 0; };
    std::stable_sort(tet.begin(), tet.end(), [&](uint32_t a, uint32_t b) { return sign(a) > sign(b); });
    const auto inside = std::count_if(tet.begin(), tet.end(), [&](uint32_t v) { return sign(v) > 0; });
    const auto outside = std::count_if(tet.begin(), tet.end(), [&](uint32_t v) { return sign(v) < 0; });
    const auto [p, q, r, s] = tet;
    if (inside == 0) return;
    if (outside == 0) return out.push_back(tet);
    if (inside == 3) return prism({p, q, r}, {cut(p, s), cut(q, s), cut(r, s)});
    if (inside == 2 && outside == 2) return prism({p, cut(p, r), cut(p, s)}, {q, cut(q, r), cut(q, s)});
    if (inside == 2) return pyramid(r, {p, q, cut(q, s), cut(p, s)});
    for (int k = 1; k < 4; ++k)
      if (sign(tet[k]) < 0) tet[k] = cut(p, tet[k]);
    out.push_back(tet);
  }
};

// Only the nodes that tets name, and every tet turned positive.
FineTets compact(const std::vector<Eigen::Vector3d>& node, const std::vector<Corners>& tets) {
  std::vector<uint32_t> place(node.size(), 0);
  for (const Corners& tet : tets)
    for (uint32_t v : tet) place[v] = 1;
  FineTets out;
  for (size_t v = 0; v < node.size(); ++v) {
    if (!place[v]) continue;
    place[v] = static_cast<uint32_t>(out.node.size());
    out.node.push_back(node[v]);
  }
  for (const auto& [a, b, c, d] : tets) {
    const bool turned = (node[b] - node[a]).cross(node[c] - node[a]).dot(node[d] - node[a]) < 0;
    out.tet.push_back({{place[a], place[b], place[turned ? d : c], place[turned ? c : d]}});
  }
  return out;
}

}  // namespace

FineTets stuff(const Lattice& lattice, LatticeSolid solid) {
  const std::vector<Corners> tets = tets_with_inside(lattice, solid.depth);
  std::vector<Eigen::Vector3d> position(solid.depth.size());
  for (uint32_t v = 0; v < position.size(); ++v) position[v] = lattice.position(v);
  for (int attempt = 1;; ++attempt) {
    if (attempt == most_attempts)  // nothing is warped inwards any more, so nothing can fall off
      for (size_t v = 0; v < solid.held.size(); ++v) solid.held[v] |= solid.depth[v] > 0;
    const std::vector<CutEdge> edges = cut_edges(tets, solid);
    const Warped warped = warp(lattice, solid, edges, edges_of_nodes(edges, solid.depth.size()), position);
    if (attempt < most_attempts && hold_what_fell_off(lattice, tets, warped.depth, first_rings + attempt - 1, solid)) continue;
    Cutter cutter{warped, edges, static_cast<uint32_t>(position.size()), {}};
    for (const Corners& tet : tets) cutter.take(tet);
    std::vector<Eigen::Vector3d> node = warped.position;
    for (const CutEdge& edge : edges)
      node.push_back(position[edge.inside] + edge.at * (position[edge.outside] - position[edge.inside]));
    return compact(node, cutter.out);
  }
}

}  // namespace crumple

#include "viewer/mapping.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace crumple::viewer {
namespace {

Point operator+(const Point& a, const Point& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Point operator-(const Point& a, const Point& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Point operator*(float s, const Point& a) { return {s * a[0], s * a[1], s * a[2]}; }
float dot(const Point& a, const Point& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Point cross(const Point& a, const Point& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

// The weights of a triangle's corners at its point nearest to p. Ericson, Real-Time Collision Detection, 5.1.5.
Weights nearest_on(const Point& p, const Point& a, const Point& b, const Point& c) {
  const Point ab = b - a, ac = c - a;
  const float d1 = dot(ab, p - a), d2 = dot(ac, p - a), d3 = dot(ab, p - b), d4 = dot(ac, p - b), d5 = dot(ab, p - c),
              d6 = dot(ac, p - c);
  if (d1 <= 0 && d2 <= 0) return {1, 0, 0};
  if (d3 >= 0 && d4 <= d3) return {0, 1, 0};
  if (d6 >= 0 && d5 <= d6) return {0, 0, 1};
  const float on_c = d1 * d4 - d3 * d2, on_b = d5 * d2 - d1 * d6, on_a = d3 * d6 - d5 * d4;
  const auto edge = [](float from, float to) { return from / (from + to); };
  if (on_c <= 0 && d1 >= 0 && d3 <= 0) return {1 - edge(d1, -d3), edge(d1, -d3), 0};
  if (on_b <= 0 && d2 >= 0 && d6 <= 0) return {1 - edge(d2, -d6), 0, edge(d2, -d6)};
  if (on_a <= 0 && d4 >= d3 && d5 >= d6) return {0, 1 - edge(d4 - d3, d5 - d6), edge(d4 - d3, d5 - d6)};
  const float sum = on_a + on_b + on_c;
  return sum > 0 ? Weights{1 - on_b / sum - on_c / sum, on_b / sum, on_c / sum} : Weights{1, 0, 0};
}

struct Box {
  Point low{std::numeric_limits<float>::max(), std::numeric_limits<float>::max(), std::numeric_limits<float>::max()};
  Point high{-low[0], -low[1], -low[2]};
  void extend(const Point& p) {
    for (size_t k = 0; k < 3; ++k) low[k] = std::min(low[k], p[k]), high[k] = std::max(high[k], p[k]);
  }
  float distance(const Point& p) const {
    Point out{};
    for (size_t k = 0; k < 3; ++k) out[k] = std::max({low[k] - p[k], 0.0f, p[k] - high[k]});
    return std::sqrt(dot(out, out));
  }
};

struct Found {
  uint32_t triangle = 0;
  Weights weight{1, 0, 0};
  float distance = std::numeric_limits<float>::infinity();
  bool on_vertex = false;
  // A vertex in the same place counts before a triangle that passes through it.
  bool better_than(const Found& other) const { return on_vertex != other.on_vertex ? on_vertex : distance < other.distance; }
};

// A binary tree of boxes around the triangles, halved at the median of the longest side.
class Triangles {
 public:
  Triangles(std::span<const Point> vertex, std::span<const Corners> triangle)
      : vertex_(vertex), triangle_(triangle), order_(triangle.size()) {
    std::iota(order_.begin(), order_.end(), 0u);
    boxes_.reserve(4 * triangle.size() / leaf + 2);
    build(0, static_cast<uint32_t>(order_.size()));
  }

  Found nearest(const Point& p) const {
    Found best;
    search(0, 0, static_cast<uint32_t>(order_.size()), p, best);
    return best;
  }

 private:
  static constexpr uint32_t leaf = 4;  // most triangles of a leaf
  struct Node {
    Box box;
    uint32_t second = 0;  // index of the second half's node; the first half's is the next one
  };

  float centre(uint32_t t, size_t axis) const {
    return vertex_[triangle_[t][0]][axis] + vertex_[triangle_[t][1]][axis] + vertex_[triangle_[t][2]][axis];
  }

  void build(uint32_t begin, uint32_t end) {
    const size_t at = boxes_.size();
    boxes_.emplace_back();
    Box box;
    for (uint32_t k = begin; k < end; ++k)
      for (uint32_t corner : triangle_[order_[k]]) box.extend(vertex_[corner]);
    boxes_[at].box = box;
    if (end - begin <= leaf) return;
    const Point size = box.high - box.low;
    const auto axis = static_cast<size_t>(std::max_element(size.begin(), size.end()) - size.begin());
    const uint32_t middle = begin + (end - begin) / 2;
    std::nth_element(order_.begin() + begin, order_.begin() + middle, order_.begin() + end, [&](uint32_t a, uint32_t b) {
      const float first = centre(a, axis), second = centre(b, axis);
      return first != second ? first < second : a < b;
    });
    build(begin, middle);
    boxes_[at].second = static_cast<uint32_t>(boxes_.size());
    build(middle, end);
  }

  void search(uint32_t at, uint32_t begin, uint32_t end, const Point& p, Found& best) const {
    const float distance = boxes_[at].box.distance(p);
    if (distance >= best.distance && (best.on_vertex || distance > same_place)) return;
    if (end - begin <= leaf) {
      for (uint32_t k = begin; k < end; ++k) look(order_[k], p, best);
      return;
    }
    const uint32_t middle = begin + (end - begin) / 2, first = at + 1, second = boxes_[at].second;
    if (boxes_[second].box.distance(p) < boxes_[first].box.distance(p)) {
      search(second, middle, end, p, best);
      search(first, begin, middle, p, best);
    } else {
      search(first, begin, middle, p, best);
      search(second, middle, end, p, best);
    }
  }

  void look(uint32_t t, const Point& p, Found& best) const {
    const Point &a = vertex_[triangle_[t][0]], &b = vertex_[triangle_[t][1]], &c = vertex_[triangle_[t][2]];
    Found found{t, nearest_on(p, a, b, c), 0, false};
    const Point off = p - (found.weight[0] * a + found.weight[1] * b + found.weight[2] * c);
    found.distance = std::sqrt(dot(off, off));
    for (size_t k = 0; k < 3; ++k) {
      const Point to = p - vertex_[triangle_[t][k]];
      const float distance = std::sqrt(dot(to, to));
      if (distance > same_place || (found.on_vertex && distance >= found.distance)) continue;
      found.weight = {};
      found.weight[k] = 1;
      found.distance = distance;
      found.on_vertex = true;
    }
    if (found.better_than(best)) best = found;
  }

  std::span<const Point> vertex_;
  std::span<const Corners> triangle_;
  std::vector<uint32_t> order_;  // the triangles, leaf by leaf
  std::vector<Node> boxes_;
};

// For each vertex the triangles around it, each triangle once.
struct Around {
  std::vector<uint32_t> first, triangle;
  Around(size_t vertices, std::span<const Corners> triangles) : first(vertices + 1, 0), triangle(3 * triangles.size()) {
    for (const Corners& corners : triangles)
      for (uint32_t corner : corners) ++first[corner + 1];
    std::partial_sum(first.begin(), first.end(), first.begin());
    std::vector<uint32_t> next(first.begin(), first.end() - 1);
    for (uint32_t t = 0; t < triangles.size(); ++t)
      for (uint32_t corner : triangles[t]) triangle[next[corner]++] = t;
  }
};

Point mean_normal(const Mapping& mapping, size_t i, std::span<const Point> crosses) {
  Point sum{};
  for (uint32_t k = mapping.first[i]; k < mapping.first[i + 1]; ++k) {
    const uint32_t t = mapping.turning[k];
    sum = t & 1 ? sum - crosses[t / 2] : sum + crosses[t / 2];
  }
  return unit(sum);
}

}  // namespace

Point operator*(const Rows& rows, const Point& v) { return {dot(rows[0], v), dot(rows[1], v), dot(rows[2], v)}; }

Rows transposed(const Rows& m) {
  return {Point{m[0][0], m[1][0], m[2][0]}, Point{m[0][1], m[1][1], m[2][1]}, Point{m[0][2], m[1][2], m[2][2]}};
}

Point unit(const Point& a) {
  const float length = std::sqrt(dot(a, a));
  return length > 0 ? (1 / length) * a : Point{0, 0, 1};
}

void find_crosses(std::span<const Point> vertex, std::span<const Corners> triangle, std::vector<Point>& out) {
  out.resize(triangle.size());
  for (size_t t = 0; t < triangle.size(); ++t) {
    const Point& a = vertex[triangle[t][0]];
    out[t] = cross(vertex[triangle[t][1]] - a, vertex[triangle[t][2]] - a);
  }
}

Mapping map_vertices(std::span<const Point> vertex, std::span<const Corners> triangle, std::span<const Point> position,
                     std::span<const Point> normal) {
  const Triangles tree(vertex, triangle);
  const Around around(vertex.size(), triangle);
  std::vector<Point> crosses;
  find_crosses(vertex, triangle, crosses);
  Mapping out;
  out.first.push_back(0);
  std::vector<uint32_t> near;
  for (size_t i = 0; i < position.size(); ++i) {
    const Found found = tree.nearest(position[i]);
    const Corners& corner = triangle[found.triangle];
    out.corner.push_back(corner);
    out.weight.push_back(found.weight);
    out.on_vertices += found.on_vertex;
    out.distance.push_back(found.distance);

    near.clear();
    for (size_t k = 0; k < 3; ++k) {
      if (found.weight[k] == 0) continue;
      const uint32_t begin = around.first[corner[k]], end = std::min(around.first[corner[k] + 1], begin + around_limit);
      near.insert(near.end(), around.triangle.begin() + begin, around.triangle.begin() + end);
    }
    std::sort(near.begin(), near.end());
    near.erase(std::unique(near.begin(), near.end()), near.end());
    const size_t begin = out.turning.size();
    for (uint32_t t : near) {
      const float side = normal.empty() ? 1 : dot(unit(crosses[t]), normal[i]);
      if (std::abs(side) > same_side) out.turning.push_back(2 * t + (side < 0));
    }
    if (out.turning.size() == begin)  // its normal has nothing to do with the surface's
      for (uint32_t t : near) out.turning.push_back(2 * t);
    out.first.push_back(static_cast<uint32_t>(out.turning.size()));
    out.facing.push_back(mean_normal(out, i, crosses));
  }
  return out;
}

Point displacement_of(const Mapping& mapping, size_t i, std::span<const Point> displacement) {
  Point sum{};
  for (size_t k = 0; k < 3; ++k) sum = sum + mapping.weight[i][k] * displacement[mapping.corner[i][k]];
  return sum;
}

Turn turn_of(const Mapping& mapping, size_t i, std::span<const Point> crosses) {
  const Point now = mean_normal(mapping, i, crosses);
  return {cross(mapping.facing[i], now), dot(mapping.facing[i], now)};
}

// Rodrigues' formula; 1 / (1 + cosine) is (1 - cosine) / sine^2.
Point Turn::operator()(const Point& v) const {
  if (cosine < -0.9999f) return -1.0f * v;  // a half turn about any axis
  return cosine * v + cross(axis, v) + (dot(axis, v) / (1 + cosine)) * axis;
}

}  // namespace crumple::viewer

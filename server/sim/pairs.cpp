#include "sim/pairs.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include "sim/substeps.h"

namespace crumple {
namespace {

constexpr float smallest_cell = 0.08f;   // m, of the grid
constexpr float cells_of_triangle = 4;   // most, along an axis
constexpr int most_cells = 64;           // along an axis
constexpr float smallest_area = 1e-10f;  // m^2: thinner triangles have no normal
constexpr float same_distance = 1e-9f;   // m^2: a point is as near to two triangles where they meet
constexpr float least_way = 1e-3f;       // m: a node that slides less far stays with its triangle
constexpr float same_way = 0.5f;         // cosine between normals of one contact in successive sub-steps
constexpr float born_inside = 0.05f;     // m: no contact lets a node come as deep
constexpr size_t nodes_tested = 64;      // for being inside
constexpr float at_surface = 1e-3f;      // m: nearer than this, the triangle's normal is better than the way to it

struct Nearest {
  Vec3 point, weight;
  float squared = std::numeric_limits<float>::infinity();
};

// The point of a triangle nearest to p. Ericson, Real-Time Collision Detection, 5.1.5.
Nearest nearest_on(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const auto at = [&](float u, float v, float w) {
    const Vec3 q = u * a + v * b + w * c;
    return Nearest{q, {u, v, w}, (p - q).squaredNorm()};
  };
  const Vec3 ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const float d1 = ab.dot(ap), d2 = ac.dot(ap), d3 = ab.dot(bp), d4 = ac.dot(bp), d5 = ab.dot(cp), d6 = ac.dot(cp);
  if (d1 <= 0 && d2 <= 0) return at(1, 0, 0);
  if (d3 >= 0 && d4 <= d3) return at(0, 1, 0);
  if (d6 >= 0 && d5 <= d6) return at(0, 0, 1);
  const float vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return at(1 - d1 / (d1 - d3), d1 / (d1 - d3), 0);
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return at(1 - d2 / (d2 - d6), 0, d2 / (d2 - d6));
  if (va <= 0 && d4 >= d3 && d5 >= d6) {
    const float w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    return at(0, 1 - w, w);
  }
  const float sum = va + vb + vc;
  return at(va / sum, vb / sum, vc / sum);
}

struct Bounds {
  Vec3 low = Vec3::Constant(std::numeric_limits<float>::infinity()), high = -low;
  void add(const Vec3& p) {
    low = low.cwiseMin(p);
    high = high.cwiseMax(p);
  }
  void widen(float by) {
    low.array() -= by;
    high.array() += by;
  }
  bool has(const Vec3& p) const { return (p.array() >= low.array()).all() && (p.array() <= high.array()).all(); }
  bool meets(const Bounds& other) const {
    return (low.array() <= other.high.array()).all() && (high.array() >= other.low.array()).all();
  }
};

Bounds bounds_of(const std::array<uint32_t, 3>& triangle, const std::vector<Vec3>& node) {
  Bounds out;
  for (uint32_t corner : triangle) out.add(node[corner]);
  return out;
}

// Triangles by the cells of a grid.
class Grid {
 public:
  // Each triangle is in all cells within `radius` of its box.
  Grid(const Bounds& box, float radius, const Boundary& boundary, std::span<const uint32_t> triangles,
       const std::vector<Vec3>& node)
      : box_(box), cell_(std::max(smallest_cell, radius)) {
    // A body that was torn apart has triangles as long as a street, which must not fill thousands of cells.
    for (uint32_t triangle : triangles) {
      const Bounds around = bounds_of(boundary.triangle[triangle], node);
      cell_ = std::max(cell_, (around.high - around.low).maxCoeff() / cells_of_triangle);
    }
    for (int k = 0; k < 3; ++k) size_[k] = 1 + whole((box.high[k] - box.low[k]) / cell_, most_cells - 1);
    first_.assign(size_t(size_[0]) * size_t(size_[1]) * size_t(size_[2]) + 2, 0);
    const auto for_each = [&](const auto& visit) {
      for (uint32_t triangle : triangles) {
        Bounds around = bounds_of(boundary.triangle[triangle], node);
        around.widen(radius);
        if (!around.meets(box)) continue;
        int from[3], to[3];
        for (int k = 0; k < 3; ++k) from[k] = along(around.low[k], k), to[k] = along(around.high[k], k);
        for (int z = from[2]; z <= to[2]; ++z) {
          for (int y = from[1]; y <= to[1]; ++y) {
            for (int x = from[0]; x <= to[0]; ++x) visit(index(x, y, z), triangle);
          }
        }
      }
    };
    for_each([&](size_t cell, uint32_t) { ++first_[cell + 2]; });
    for (size_t k = 2; k < first_.size(); ++k) first_[k] += first_[k - 1];
    triangle_.resize(first_.back());
    for_each([&](size_t cell, uint32_t triangle) { triangle_[first_[cell + 1]++] = triangle; });
  }
  // All triangles within the radius of p, in ascending order, and others.
  std::span<const uint32_t> near(const Vec3& p) const {
    const size_t cell = index(along(p.x(), 0), along(p.y(), 1), along(p.z(), 2));
    return std::span(triangle_).subspan(first_[cell], first_[cell + 1] - first_[cell]);
  }

 private:
  int along(float x, int axis) const { return whole((x - box_.low[axis]) / cell_, size_[axis] - 1); }
  // Rounded down, at least 0, at most `most`. A body that has just burst has nodes at infinity until its tick is undone: then
  // the ratio may be no number.
  static int whole(float ratio, int most) { return ratio > 0 ? int(std::min(ratio, float(most))) : 0; }
  size_t index(int x, int y, int z) const { return size_t((z * size_[1] + y) * size_[0] + x); }

  Bounds box_;
  float cell_;
  int size_[3];
  std::vector<uint32_t> first_, triangle_;
};

// How one car moves in the frame of another, in a sub-step or a tick.
struct RelativePath {
  Relative from, to;
};

Vec3 at(const Relative& frame, const Vec3& p) { return frame.rotation * p + frame.translation; }

// The farthest that a point of the car moves in the other's frame, m.
float travel_of(const RelativePath& path, const StepInput& input, const DeformableState& body) {
  const Mat3 turn = path.to.rotation - path.from.rotation;
  return (turn * input.model.center_of_mass + path.to.translation - path.from.translation).norm() + turn.norm() * body.reach;
}

// A triangle under a point: the nearest that is found.
struct Found {
  uint32_t triangle = UINT32_MAX;
  Nearest nearest;
  Vec3 normal = Vec3::Zero();  // of the triangle
  float side = 0;              // cosine between the normal and the way from the triangle to the point
  explicit operator bool() const { return triangle != UINT32_MAX; }

  // Unit, from the triangle to the point; where the point is inside or near, out of the car.
  Vec3 way_out(const Vec3& p) const {
    const float distance = std::sqrt(nearest.squared);
    return side >= 0 && distance > at_surface ? Vec3((p - nearest.point) / distance) : normal;
  }
};

// Searches the triangles of one car for those near points of another.
struct Search {
  const Grid& grid;
  const Boundary& boundary;
  const std::vector<Vec3>& node;

  // towards: only triangles that face this way; zero: all. beside: only triangles that share a node with this one.
  Found find(const Vec3& p, float radius, const Vec3& towards, std::optional<uint32_t> beside) const {
    Found best;
    best.nearest.squared = radius * radius;
    for (uint32_t triangle : grid.near(p)) {
      const auto& corner = boundary.triangle[triangle];
      if (beside && !shares_node(corner, boundary.triangle[*beside])) continue;
      const Vec3 &a = node[corner[0]], &b = node[corner[1]], &c = node[corner[2]];
      Vec3 normal = (b - a).cross(c - a);
      const float area = normal.norm();
      if (!(area > smallest_area)) continue;
      normal /= area;
      if (!towards.isZero(0) && normal.dot(towards) <= 0) continue;
      const Nearest nearest = nearest_on(p, a, b, c);
      if (nearest.squared > best.nearest.squared + same_distance) continue;
      const float distance = std::sqrt(nearest.squared);
      const float side = distance > 1e-6f ? normal.dot(p - nearest.point) / distance : 0;
      // At an edge or a corner, that triangle which the point is most above or below says on which side it is.
      if (nearest.squared > best.nearest.squared - same_distance && std::fabs(side) <= std::fabs(best.side)) continue;
      best = {triangle, nearest, normal, side};
    }
    return best;
  }

 private:
  static bool shares_node(const std::array<uint32_t, 3>& a, const std::array<uint32_t, 3>& b) {
    return std::any_of(a.begin(), a.end(), [&](uint32_t node) { return std::find(b.begin(), b.end(), node) != b.end(); });
  }
};

// What the car remembers of a node that pressed against the other car; null: nothing.
const PairMemory::Touch* memory_of(const PairMemory& memory, uint32_t node, uint64_t partner) {
  const auto found = std::lower_bound(memory.touch.begin(), memory.touch.end(), node,
                                      [](const PairMemory::Touch& touch, uint32_t wanted) { return touch.node < wanted; });
  return found != memory.touch.end() && found->node == node && found->partner == partner ? &*found : nullptr;
}

// Two cars in a sub-step; [0] has the nodes, [1] the triangles.
struct PairStep {
  const Member& a;
  const Member& b;
  RelativePath path;
  float share[2];
  double seconds;
};

// Of the materials at the node and at the triangle's nearest corner.
float friction_of(const PairStep& step, const PairContact& contact) {
  const auto of = [](const Member& car, uint32_t node) {
    return car.input.parameters.region[car.input.model.node_region[node]].friction;
  };
  int nearest = 0;
  contact.weight.maxCoeff(&nearest);
  return std::sqrt(of(step.a, contact.node) * of(step.b, contact.corner[nearest]));
}

std::optional<PairContact> contact_of(const PairStep& step, const Search& search, uint32_t node, const Vec3& start,
                                      float radius) {
  const DeformableState &body = step.a.state.body, &other = step.b.state.body;
  const PairMemory::Touch* known = memory_of(body.pairs, node, step.b.key);
  Found found = search.find(start, radius, known ? known->normal : Vec3::Zero(), {});
  if (!found) return std::nullopt;
  Vec3 normal = found.way_out(start), slid = start;
  const float before = normal.dot(start - found.nearest.point);
  const Vec3 own = body.node[node], end = at(step.path.to, own);
  const auto& corner = search.boundary.triangle[found.triangle];
  if (known) {
    // Where both go along the surface if they go on as in the last sub-step.
    Vec3 way = at(step.path.to, own + step.share[0] * body.step[node]) - start;
    for (int k = 0; k < 3; ++k) way -= step.share[1] * found.nearest.weight[k] * other.step[corner[size_t(k)]];
    way -= normal.dot(way) * normal;
    if (way.squaredNorm() > least_way * least_way) {
      const Found next = search.find(start + way, 2 * radius, normal, found.triangle);
      if (next) {
        found = next;
        slid = start + way;
        normal = found.way_out(slid);
      }
    }
  }
  const float after = normal.dot(end - found.nearest.point);
  // Bodies that press spring back, maybe as far as the cars part.
  const bool presses = known && known->pressure > 0 && before < contact_margin && normal.dot(known->normal) > same_way;
  if (after > contact_margin && !presses) return std::nullopt;
  PairContact contact{};
  contact.node = node;
  const auto& under = search.boundary.triangle[found.triangle];
  std::copy(under.begin(), under.end(), contact.corner);
  contact.weight = found.nearest.weight;
  contact.normal = normal;
  contact.rotation = step.path.to.rotation;
  contact.own_normal = contact.rotation.transpose() * normal;
  contact.constant = normal.dot(step.path.to.translation);
  if (before < 0) contact.constant += std::max(0.0f, -before - push_out_speed * float(step.seconds));
  contact.offset = step.path.to.translation - start + found.nearest.point;
  contact.friction = friction_of(step, contact);
  contact.before = before;
  contact.after = after;
  contact.motion = (end - start).norm();
  if (known) {
    contact.pressure = known->pressure;
    contact.start_rub = contact.rub = known->friction - normal.dot(known->friction) * normal;
  }
  return contact;
}

// The nearest contact of each of the candidates.
void find_contacts_of(const PairStep& step, const PairCandidates& near, std::vector<PairContact>& out) {
  const DeformableState &body = step.a.state.body, &other = step.b.state.body;
  const Boundary& boundary = *step.b.input.model.boundary;
  const float radius = contact_margin + travel_of(step.path, step.a.input, body);
  Bounds around;
  for (uint32_t triangle : near.triangle) {
    for (uint32_t corner : boundary.triangle[triangle]) around.add(other.node[corner]);
  }
  around.widen(radius);
  std::vector<std::pair<uint32_t, Vec3>> inside;
  Bounds box;
  for (uint32_t node : near.node) {
    const Vec3 p = at(step.path.from, body.node[node]);
    if (!around.has(p)) continue;
    inside.emplace_back(node, p);
    box.add(p);
  }
  if (inside.empty()) return;
  const Grid grid(box, 2 * radius, boundary, near.triangle, other.node);
  const Search search{grid, boundary, other.node};
  for (const auto& [node, start] : inside) {
    if (auto contact = contact_of(step, search, node, start, radius)) {
      std::copy_n(near.car, 2, contact->car);
      out.push_back(*contact);
    }
  }
}

void index_pairs(size_t cars, std::span<const Member> island, PairGroup& group) {
  group.index.resize(cars);
  for (size_t k = 0; k < cars; ++k) group.index[k].first.assign(island[group.member[k]].input.model.node.size() + 1, 0);
  const auto for_each = [&](const auto& visit) {
    for (uint32_t c = 0; c < group.contact.size(); ++c) {
      const PairContact& contact = group.contact[c];
      visit(group.index[contact.car[0]], contact.node, PairIndex::Entry{c, PairIndex::own});
      for (uint32_t k = 0; k < 3; ++k) visit(group.index[contact.car[1]], contact.corner[k], PairIndex::Entry{c, k});
    }
  };
  for_each([](PairIndex& index, uint32_t node, PairIndex::Entry) { ++index.first[node + 1]; });
  for (PairIndex& index : group.index) {
    for (uint32_t i = 0; i + 1 < index.first.size(); ++i) {
      if (index.first[i + 1] > 0) index.node.push_back(i);
      index.first[i + 1] += index.first[i];
    }
    index.entry.resize(index.first.back());
  }
  for_each([](PairIndex& index, uint32_t node, PairIndex::Entry entry) { index.entry[index.first[node]++] = entry; });
  for (PairIndex& index : group.index) {
    for (size_t i = index.first.size() - 1; i > 0; --i) index.first[i] = index.first[i - 1];
    index.first[0] = 0;
  }
}

// Divides the cars into groups that touch each other now or did in the last sub-step, in the order of their lowest cars. Half
// of the last sub-step's forces still acts, and on both sides alike.
std::vector<PairGroup> group_cars(std::span<const Member> island, const std::vector<PairContact>& contacts) {
  std::vector<uint32_t> lowest(island.size());
  std::iota(lowest.begin(), lowest.end(), 0u);
  const auto root = [&](uint32_t i) {
    while (lowest[i] != i) i = lowest[i];
    return i;
  };
  const auto connect = [&](uint32_t i, uint32_t k) {
    const uint32_t a = root(i), b = root(k);
    lowest[std::max(a, b)] = std::min(a, b);
  };
  for (const PairContact& contact : contacts) connect(contact.car[0], contact.car[1]);
  for (uint32_t i = 0; i < island.size(); ++i) {
    uint64_t last = island[i].key;  // most nodes touch the same car as the node before
    for (const PairMemory::Touch& touch : island[i].state.body.pairs.touch) {
      if (touch.partner == last || !(touch.pressure > 0)) continue;
      last = touch.partner;
      for (uint32_t k = 0; k < island.size(); ++k) {
        if (island[k].key == last) connect(i, k);
      }
    }
  }
  std::vector<PairGroup> out;
  std::vector<uint32_t> group(island.size()), place(island.size());
  for (uint32_t k = 0; k < island.size(); ++k) {
    if (root(k) == k) {
      group[k] = uint32_t(out.size());
      out.emplace_back();
    }
    group[k] = group[root(k)];
    place[k] = uint32_t(out[group[k]].member.size());
    out[group[k]].member.push_back(k);
  }
  for (const PairContact& contact : contacts) {
    PairContact& own = out[group[contact.car[0]]].contact.emplace_back(contact);
    for (uint32_t& car : own.car) car = place[car];
  }
  for (PairGroup& each : out) index_pairs(each.member.size(), island, each);
  return out;
}

// How one car moves in the frame of another within the tick, if both move on steadily.
RelativePath path_of(const Member& car, const Member& other) {
  const Motion &motion = car.state.motion, &frame = other.state.motion;
  const double seconds = car.input.seconds;
  return {relative(motion.pose, frame.pose),
          relative(advance(motion, car.input.mass, seconds), advance(frame, other.input.mass, seconds))};
}

float travel_of(const RelativePath& path, const Member& car) { return travel_of(path, car.input, car.state.body); }

// By the spheres around both.
bool far_apart(const Member& a, const Member& b, float near) {
  const auto center = [](const Member& car) {
    const Pose& pose = car.state.motion.pose;
    return Eigen::Vector3d(pose.position + pose.orientation * car.input.model.center_of_mass.cast<double>());
  };
  const double most = double(a.state.body.reach) + double(b.state.body.reach) + double(near);
  return !a.input.model.boundary || !b.input.model.boundary || (center(a) - center(b)).squaredNorm() > most * most;
}

// The nodes of one car that are in the box of another, and the triangles of that car in the box of these nodes.
PairCandidates candidates_of(const Member& car, const Member& other, const Relative& frame, float near) {
  const std::vector<Vec3>&node = car.state.body.node, &corner = other.state.body.node;
  PairCandidates out{};
  Bounds box{other.state.body.low, other.state.body.high}, nodes;
  box.widen(near);
  for (uint32_t each : car.input.model.boundary->node) {
    const Vec3 p = at(frame, node[each]);
    if (!box.has(p)) continue;
    out.node.push_back(each);
    nodes.add(p);
  }
  if (out.node.empty()) return out;
  nodes.widen(near);
  const Boundary& boundary = *other.input.model.boundary;
  for (uint32_t k = 0; k < boundary.triangle.size(); ++k) {
    if (bounds_of(boundary.triangle[k], corner).meets(nodes)) out.triangle.push_back(k);
  }
  return out;
}

// The triangles of a car by where they lie along x and y. So a point meets only those above it, below it and beside it.
class Columns {
 public:
  Columns(const Boundary& boundary, const DeformableState& body)
      : flat_(flattened(body.node)),
        all_(boundary.triangle.size()),
        grid_(box_of(body), born_inside + at_surface, boundary, number(all_), flat_) {}
  // All triangles within born_inside of the vertical line through p, and others.
  std::span<const uint32_t> around(const Vec3& p) const { return grid_.near(p); }

 private:
  static std::vector<Vec3> flattened(std::vector<Vec3> node) {
    for (Vec3& each : node) each.z() = 0;
    return node;
  }
  static Bounds box_of(const DeformableState& body) {
    return {{body.low.x(), body.low.y(), 0}, {body.high.x(), body.high.y(), 0}};
  }
  static std::span<const uint32_t> number(std::vector<uint32_t>& all) {
    std::iota(all.begin(), all.end(), 0u);
    return all;
  }
  std::vector<Vec3> flat_;
  std::vector<uint32_t> all_;
  Grid grid_;
};

// Whether p is inside a closed surface: a ray upwards leaves it once more than it enters it.
bool is_inside(const Vec3& p, const Boundary& boundary, const Columns& columns, const std::vector<Vec3>& node) {
  bool inside = false;
  for (const uint32_t each : columns.around(p)) {
    const auto& triangle = boundary.triangle[each];
    const Vec3* corner[3] = {&node[triangle[0]], &node[triangle[1]], &node[triangle[2]]};
    bool under = false;  // p lies below or above the triangle: a line along x crosses one edge on either side
    for (int k = 0; k < 3; ++k) {
      const Vec3 *a = corner[k], *b = corner[(k + 1) % 3];
      if (triangle[size_t(k)] > triangle[size_t((k + 1) % 3)]) std::swap(a, b);  // both triangles of an edge find the same
      if ((a->y() <= p.y()) == (b->y() <= p.y())) continue;
      const float x = a->x() + (p.y() - a->y()) / (b->y() - a->y()) * (b->x() - a->x());
      if (x > p.x()) under = !under;
    }
    if (!under) continue;
    const Vec3 normal = (*corner[1] - *corner[0]).cross(*corner[2] - *corner[0]);
    if (normal.z() == 0) continue;
    const Vec3 way = *corner[0] - p;
    if (way.dot(normal) / normal.z() > 0) inside = !inside;
  }
  return inside;
}

// Whether a point is deeper inside than any contact lets it come.
bool is_deep(const Vec3& p, const Boundary& boundary, const Columns& columns, const std::vector<Vec3>& node) {
  if (!is_inside(p, boundary, columns, node)) return false;
  const std::span<const uint32_t> around = columns.around(p);
  return std::none_of(around.begin(), around.end(), [&](uint32_t each) {
    const auto& t = boundary.triangle[each];
    return nearest_on(p, node[t[0]], node[t[1]], node[t[2]]).squared < born_inside * born_inside;
  });
}

// Whether a car stands inside another although no contact let it in: it was spawned, put or loaded there. Such cars pass
// through each other until they have parted. Tests some nodes of a car that has just come near, and of one that is passing
// already. columns: of the other car; made when a test needs them.
bool begins_inside(const Member& car, const Member& other, const Relative& frame, std::optional<Columns>& columns) {
  const PairMemory& memory = car.state.body.pairs;
  const auto has = [&](const std::vector<uint64_t>& keys) { return std::binary_search(keys.begin(), keys.end(), other.key); };
  const bool passes = has(memory.passing);
  if (has(memory.near) && !passes) return false;
  const Bounds box{other.state.body.low, other.state.body.high};
  const std::vector<Vec3>& nodes = car.state.body.node;  // inner ones too: a twin's boundary lies on the other's
  const size_t step = std::max<size_t>(1, nodes.size() / nodes_tested);
  for (size_t k = 0; k < nodes.size(); k += step) {
    const Vec3 p = at(frame, nodes[k]);
    if (!box.has(p)) continue;
    const Boundary& boundary = *other.input.model.boundary;
    if (!columns) columns.emplace(boundary, other.state.body);
    const auto within = passes ? is_inside : is_deep;  // once they pass, until they have parted
    if (within(p, boundary, *columns, other.state.body.node)) return true;
  }
  return false;
}

}  // namespace

std::vector<float> find_pair_candidates(std::span<Member> island, std::vector<PairCandidates>& out) {
  out.clear();
  std::vector<float> travel(island.size(), 0.0f);
  std::vector<PairMemory> memory(island.size());
  std::vector<std::optional<Columns>> columns(island.size());
  for (uint32_t a = 0; a < island.size(); ++a) {
    const std::vector<uint32_t>* near_a = island[a].near;
    const uint32_t count = near_a ? uint32_t(near_a->size()) : uint32_t(island.size());
    for (uint32_t each = 0; each < count; ++each) {
      const uint32_t b = near_a ? (*near_a)[each] : each;
      if (b <= a) continue;
      const Member &first = island[a], &second = island[b];
      const RelativePath there = path_of(first, second), back = path_of(second, first);
      const float way = std::max(travel_of(there, first), travel_of(back, second)), near = 2 * way + contact_margin;
      if (far_apart(first, second, near)) continue;
      const auto meet = [&](bool passing) {
        for (const auto& [car, other] : {std::pair(a, b), std::pair(b, a)}) {
          memory[car].near.push_back(island[other].key);
          if (passing) memory[car].passing.push_back(island[other].key);
        }
      };
      if (begins_inside(first, second, there.from, columns[b]) || begins_inside(second, first, back.from, columns[a])) {
        meet(true);
        continue;
      }
      PairCandidates found[2] = {candidates_of(first, second, there.from, near), candidates_of(second, first, back.from, near)};
      if (found[0].node.empty() && found[1].node.empty()) continue;
      meet(false);
      travel[a] = std::max(travel[a], way);
      travel[b] = std::max(travel[b], way);
      for (int k = 0; k < 2; ++k) {
        if (found[k].node.empty() || found[k].triangle.empty()) continue;
        found[k].car[0] = k == 0 ? a : b;
        found[k].car[1] = k == 0 ? b : a;
        out.push_back(std::move(found[k]));
      }
    }
  }
  for (size_t k = 0; k < island.size(); ++k) {
    PairMemory& own = island[k].state.body.pairs;
    for (auto* keys : {&memory[k].near, &memory[k].passing}) std::sort(keys->begin(), keys->end());
    own.near = std::move(memory[k].near);
    own.passing = std::move(memory[k].passing);
  }
  return travel;
}

std::vector<PairGroup> find_pairs(std::span<const Member> island, std::span<const PairCandidates> candidates,
                                  std::span<const Pose> from, std::span<const Pose> to, std::span<const float> share,
                                  double seconds) {
  std::vector<PairContact> contacts;
  for (const PairCandidates& near : candidates) {
    const auto& [a, b] = near.car;
    const RelativePath path{relative(from[a], from[b]), relative(to[a], to[b])};
    find_contacts_of({island[a], island[b], path, {share[a], share[b]}, seconds}, near, contacts);
  }
  // A node presses against one car at a time: the one that it is deepest in.
  const auto before = [](const PairContact& x, const PairContact& y) {
    return std::tuple(x.car[0], x.node, x.after, x.car[1]) < std::tuple(y.car[0], y.node, y.after, y.car[1]);
  };
  std::sort(contacts.begin(), contacts.end(), before);
  const auto same = [](const PairContact& x, const PairContact& y) { return x.car[0] == y.car[0] && x.node == y.node; };
  contacts.erase(std::unique(contacts.begin(), contacts.end(), same), contacts.end());
  return group_cars(island, contacts);
}

PairForce pair_force(const PairContact& contact, const Vec3& node, const Vec3& point) {
  PairForce out{std::max(0.0f, contact.pressure - contact.stiffness * contact.gap(node, point)), Vec3::Zero(), 0};
  if (!(out.normal > 0) || contact.friction == 0) return out;
  out.friction = contact.rub - contact.stiffness * contact.slip(node, point);
  out.stick = contact.stiffness;
  const float size = out.friction.norm(), most = contact.friction * out.normal;
  if (size > most) {
    out.friction *= most / size;
    out.stick *= most / size;
  }
  return out;
}

void remember_pairs(std::span<Member> island, const PairGroup& group) {
  for (uint32_t k : group.member) island[k].state.body.pairs.touch.clear();
  for (const PairContact& contact : group.contact) {
    const uint64_t partner = island[group.member[contact.car[1]]].key;
    const Vec3 rub = contact.force - contact.pressed * contact.normal;
    island[group.member[contact.car[0]]].state.body.pairs.touch.push_back(
        {partner, contact.node, contact.normal, contact.pressed, rub});
  }
}

}  // namespace crumple

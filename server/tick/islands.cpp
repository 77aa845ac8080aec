#include "tick/islands.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "sim/contacts.h"
#include "tick/levels.h"

namespace crumple {
namespace {

using Eigen::Vector3d;

// A box along the world's axes that holds a car for some time.
struct Reach {
  uint32_t car;
  Vector3d low, high;
  bool meets(const Reach& other) const {
    return (low.array() <= other.high.array()).all() && (high.array() >= other.low.array()).all();
  }
};

Vector3d center_of(const Instance& car) {
  return car.motion.pose.position + car.motion.pose.orientation * car.car->model.center_of_mass.cast<double>();
}

// How far a point of the car moves in `seconds`, at most; m. The centre of mass that the host gave may be another than the
// model's.
double travel_of(const Instance& car, double seconds) {
  const double arm = double(car.body.reach) + (car.mass.center - car.car->model.center_of_mass.cast<double>()).norm();
  return (car.motion.velocity.norm() + car.motion.angular_velocity.norm() * arm) * seconds;
}

Reach reach_of(const Instance& car, uint32_t index, double seconds) {
  const Vector3d center = center_of(car), end = center + seconds * car.motion.velocity;
  const double turning =
      car.motion.angular_velocity.norm() * (car.mass.center - car.car->model.center_of_mass.cast<double>()).norm() * seconds;
  const double radius = double(car.body.reach) + turning + double(contact_margin);
  return {index, center.cwiseMin(end).array() - radius, center.cwiseMax(end).array() + radius};
}

bool stands(const Instance& car) {
  return car.motion.velocity.isZero(0) && car.motion.angular_velocity.isZero(0) && !car.body.touching;
}

bool may_touch(const Instance& car) { return car.parameters.solver == Solver::nodal; }

// Whether one of the faces of a's box has the whole box of b farther than `near` outside.
bool beyond(const Instance& a, const Instance& b, double near) {
  const Relative path = relative(b.motion.pose, a.motion.pose);
  const Vec3 half = 0.5f * (b.body.high - b.body.low), center = path.rotation * (b.body.low + half) + path.translation;
  const Vec3 extent = path.rotation.cwiseAbs() * half;
  return ((center - extent - a.body.high).array() > float(near)).any() ||
         ((a.body.low - center - extent).array() > float(near)).any();
}

// Whether one pressed against the other at the end of the last tick.
bool pressed(const Instance& car, const Instance& other) {
  const std::vector<PairMemory::Push>& push = car.body.pairs.push;
  return std::any_of(push.begin(), push.end(), [&](const PairMemory::Push& each) { return each.partner == other.key; });
}

// How near the spheres around two cars come to each other within this tick, m; below 0: they overlap.
double gap_of(const World& world, const Instance& a, const Instance& b) {
  const Vector3d way = center_of(b) - center_of(a), change = (b.motion.velocity - a.motion.velocity) / world.rate;
  const double squared = change.squaredNorm();
  const double share = squared > 0 ? std::clamp(-way.dot(change) / squared, 0.0, 1.0) : 0;
  return (way + share * change).norm() - double(a.body.reach) - double(b.body.reach);
}

// The cars that come nearest to one car, nearest first; of equally near ones the lower ids.
class Nearest {
 public:
  void add(double gap, uint32_t car) {
    const std::pair<double, uint32_t> one(gap, car);
    if (cars_.size() == neighbour_limit) {
      if (cars_.back() < one) return;
      cars_.pop_back();
    }
    cars_.insert(std::lower_bound(cars_.begin(), cars_.end(), one), one);
  }
  bool has(uint32_t car) const {
    return std::any_of(cars_.begin(), cars_.end(), [&](const auto& one) { return one.second == car; });
  }
  const std::vector<std::pair<double, uint32_t>>& cars() const { return cars_; }

 private:
  std::vector<std::pair<double, uint32_t>> cars_;
};

}  // namespace

void forget_placed(const std::vector<Instance*>& cars) {
  std::vector<uint64_t> placed;
  for (const Instance* car : cars) {
    if (car->placed) placed.push_back(car->key);
  }
  if (placed.empty()) return;
  std::sort(placed.begin(), placed.end());
  for (Instance* car : cars) {
    PairMemory& memory = car->body.pairs;
    const auto is_forgotten = [&](uint64_t key) {
      return car->placed || std::binary_search(placed.begin(), placed.end(), key);
    };
    const auto passes = [&](uint64_t key) { return std::binary_search(memory.passing.begin(), memory.passing.end(), key); };
    const size_t pushes = std::erase_if(memory.push, [&](const PairMemory::Push& push) { return is_forgotten(push.partner); });
    const size_t touches =
        std::erase_if(memory.touch, [&](const PairMemory::Touch& touch) { return is_forgotten(touch.partner); });
    if (touches > 0) car->body.history = {};  // it has pressures of the other car
    const size_t neighbours = std::erase_if(memory.near, [&](uint64_t key) { return is_forgotten(key) && !passes(key); });
    if (pushes + touches + neighbours > 0) car->hashes.body = hash(car->body);
  }
  for (Instance* car : cars) car->placed = false;
}

uint64_t key_of(const std::string& id) { return XXH64(id.data(), id.size(), 0); }

void find_neighbours(const World& world, const std::vector<Instance*>& cars) {
  for (Instance* car : cars) car->near.clear();
  const auto moves = [](const Instance* car) { return may_touch(*car) && !stands(*car); };
  if (std::none_of(cars.begin(), cars.end(), moves)) return;
  const double seconds = std::max(notice, 1 / world.rate);
  std::vector<Reach> reach;
  for (uint32_t k = 0; k < cars.size(); ++k) {
    if (may_touch(*cars[k])) reach.push_back(reach_of(*cars[k], k, seconds));
  }
  std::sort(reach.begin(), reach.end(),
            [](const Reach& a, const Reach& b) { return a.low.x() != b.low.x() ? a.low.x() < b.low.x() : a.car < b.car; });
  std::vector<Nearest> nearest(cars.size());
  for (size_t i = 0; i < reach.size(); ++i) {
    const Instance& a = *cars[reach[i].car];
    for (size_t k = i + 1; k < reach.size() && reach[k].low.x() <= reach[i].high.x(); ++k) {
      const Instance& b = *cars[reach[k].car];
      if ((stands(a) && stands(b)) || !reach[i].meets(reach[k])) continue;
      const double gap = pressed(a, b) ? -std::numeric_limits<double>::infinity() : gap_of(world, a, b);
      nearest[reach[i].car].add(gap, reach[k].car);
      nearest[reach[k].car].add(gap, reach[i].car);
    }
  }
  for (uint32_t k = 0; k < cars.size(); ++k) {
    for (const auto& [gap, other] : nearest[k].cars()) {
      if (nearest[other].has(k)) cars[k]->near.push_back(other);
    }
    if (cars[k]->near.empty()) continue;
    std::sort(cars[k]->near.begin(), cars[k]->near.end());
    cars[k]->idle = false;
  }
}

void add_boxes(const std::vector<Instance*>& cars, const Instance& car, std::vector<Obstacle>& out) {
  for (uint32_t k : car.near) {
    const Instance& other = *cars[k];
    const bool still = other.motion.velocity == car.motion.velocity && other.motion.angular_velocity.isZero(0) &&
                       car.motion.angular_velocity.isZero(0);
    if (still) continue;
    const Vec3 half = 0.5f * (other.body.high - other.body.low), center = other.body.low + half;
    Obstacle& box = out.emplace_back();
    make_box(half, box);
    box.pose = {other.motion.pose.position + other.motion.pose.orientation * center.cast<double>(),
                other.motion.pose.orientation};
    box.velocity = other.motion.velocity;
    box.angular_velocity = other.motion.angular_velocity;
  }
}

std::vector<std::vector<uint32_t>> near_in(std::span<Instance* const> island) {
  std::vector<std::vector<uint32_t>> out(island.size());
  if (island.size() == 1) return out;
  for (size_t k = 0; k < island.size(); ++k) {
    for (const uint32_t order : island[k]->near) {
      const auto found = std::lower_bound(island.begin(), island.end(), order,
                                          [](const Instance* car, uint32_t wanted) { return car->order < wanted; });
      if (found != island.end() && (*found)->order == order) out[k].push_back(uint32_t(found - island.begin()));
    }
  }
  return out;
}

std::vector<Island> find_islands(const World& world, const std::vector<Instance*>& cars) {
  std::vector<uint32_t> lowest(cars.size());
  std::iota(lowest.begin(), lowest.end(), 0u);
  const auto root = [&](uint32_t i) {
    while (lowest[i] != i) i = lowest[i] = lowest[lowest[i]];
    return i;
  };
  std::vector<std::pair<uint32_t, uint32_t>> pairs;
  for (uint32_t k = 0; k < cars.size(); ++k) {
    for (uint32_t other : cars[k]->near) {
      if (other < k) continue;
      const Instance &a = *cars[k], &b = *cars[other];
      // A contact may turn the whole way of one into that of the other.
      const double near = 2 * (travel_of(a, 1 / world.rate) + travel_of(b, 1 / world.rate)) + double(contact_margin);
      if (beyond(a, b, near) || beyond(b, a, near)) continue;
      pairs.emplace_back(k, other);
    }
  }
  std::stable_partition(pairs.begin(), pairs.end(),
                        [&](const auto& pair) { return pressed(*cars[pair.first], *cars[pair.second]); });
  std::vector<size_t> size(cars.size(), 1);
  for (const auto& [k, other] : pairs) {
    const auto [first, second] = std::minmax({root(k), root(other)});
    if (first == second || size[first] + size[second] > island_limit) continue;
    lowest[second] = first;
    size[first] += size[second];
  }
  std::vector<Island> out;
  std::vector<uint32_t> island(cars.size());
  for (uint32_t k = 0; k < cars.size(); ++k) {
    if (root(k) == k) {
      island[k] = uint32_t(out.size());
      out.emplace_back();
    }
    out[island[root(k)]].push_back(cars[k]);
  }
  return out;
}

}  // namespace crumple

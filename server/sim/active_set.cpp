#include "sim/active_set.h"

#include <algorithm>

namespace crumple {
namespace {

enum : uint8_t { asleep, awake, spread };

// Wakes the free neighbours of a node; adds them to `woken`.
void wake_around(const SweepOrder& order, uint32_t node, ActiveSet& set, std::vector<uint32_t>& woken) {
  for (uint32_t k = order.near_first[node]; k < order.near_first[node + 1]; ++k) {
    const uint32_t near = order.near[k];
    if (set.awake[near] != asleep) continue;
    set.awake[near] = awake;
    woken.push_back(near);
  }
}

// Wakes what lies within two tets of the nodes. Returns whether anything was asleep.
bool spread_from(const Model& model, std::span<const uint32_t> nodes, ActiveSet& set) {
  std::vector<uint32_t> near, far;
  for (const uint32_t node : nodes) {
    if (set.awake[node] != asleep) set.awake[node] = spread;
    wake_around(*model.order, node, set, near);
  }
  for (const uint32_t node : near) wake_around(*model.order, node, set, far);
  return !near.empty();
}

float square(const Float4& a, const Float4& b) {
  const float x = a.x - b.x, y = a.y - b.y, z = a.z - b.z;
  return x * x + y * y + z * z;
}

// The squared way beyond which a node wakes its neighbours, m^2.
float limit(float largest_square, float quiet) { return wake_share * wake_share * std::max(quiet * quiet, largest_square); }

}  // namespace

void wake(const Model& model, const ActiveSeeds& seeds, std::span<const Vec3> step, float quiet, ActiveSet& set) {
  set.whole = false;
  set.awake.assign(model.node.size(), asleep);
  float largest = 0;
  for (const Vec3& way : step) largest = std::max(largest, way.squaredNorm());
  const float most = limit(largest, quiet);
  std::vector<uint32_t> from = seeds.touched;
  for (const uint32_t node : seeds.touched) set.awake[node] = awake;
  for (uint32_t i = 0; i < step.size(); ++i) {
    if (model.node_anchored[i] || set.awake[i] != asleep || !(step[i].squaredNorm() > most)) continue;
    set.awake[i] = awake;
    from.push_back(i);
  }
  from.insert(from.end(), seeds.placed.begin(), seeds.placed.end());
  spread_from(model, from, set);
}

void wake_all(const Model& model, const ActiveSeeds& seeds, ActiveSet& set) {
  set.whole = true;
  set.awake.resize(model.node.size());
  for (size_t i = 0; i < set.awake.size(); ++i) set.awake[i] = model.node_anchored[i] ? asleep : spread;
  for (const uint32_t node : seeds.touched) set.awake[node] = spread;
}

bool widen(const Model& model, std::span<const Float4> before, std::span<const Float4> node, float quiet, ActiveSet& set) {
  if (set.whole) return false;
  float largest = 0;
  for (const uint32_t i : set.node) largest = std::max(largest, square(node[i], before[i]));
  const float most = limit(largest, quiet);
  std::vector<uint32_t> moved;
  for (const uint32_t i : set.node) {
    if (set.awake[i] == awake && square(node[i], before[i]) > most) moved.push_back(i);
  }
  return spread_from(model, moved, set);
}

void stir(const Model& model, const ActiveSeeds& seeds, ActiveSet& set) {
  const SweepOrder& order = *model.order;
  set.node.clear();
  set.corners = 0;
  set.stirred.assign(order.group.size(), set.whole);
  const auto stir = [&](uint32_t node) {
    for (uint32_t k = order.over_first[node]; k < order.over_first[node + 1]; ++k) set.stirred[order.over[k]] = 1;
  };
  for (uint32_t i = 0; i < set.awake.size(); ++i) {
    if (set.awake[i] == asleep) continue;
    set.node.push_back(i);
    set.corners += model.node_first[i + 1] - model.node_first[i];
    stir(i);
  }
  for (const uint32_t node : seeds.placed) stir(node);
}

void pack(const Model& model, const ActiveSeeds& seeds, std::span<const CornerWeights> weights, ActiveSet& set) {
  pack(model, set.awake, weights, set.blocks);
  const Blocks& blocks = set.blocks;
  set.touched.assign(blocks.anchored.size(), 0);
  set.still = blocks.unused;
  for (const uint32_t node : seeds.touched) {
    const uint32_t place = blocks.place[node];
    const uint16_t bit = uint16_t(1u << (place % lanes));
    set.still[place / lanes] |= bit;
    set.touched[place / lanes] |= bit;
  }
}

}  // namespace crumple

#include "car/make_sweep_order.h"

#include <algorithm>
#include <bit>

namespace crumple {
namespace {

constexpr int most_colours = 255;

// Number of nodes of one colour that are sorted by their number of tets, so that blocks have few empty lanes. Sorting more
// would put distant nodes into one block. Lanes in use at 5,000 nodes: 60 % unsorted, 87 % with 128, 93 % with all.
constexpr size_t sorted_together = 128;

// Greedy, in the model's spatial order: the first colour that no neighbour has. Empty if the colours do not suffice.
std::vector<uint8_t> colour_of(const Model& model) {
  std::vector<uint8_t> colour(model.node.size());
  for (uint32_t i = 0; i < model.node.size(); ++i) {
    uint64_t taken[4] = {};
    for (uint32_t k = model.node_first[i]; k < model.node_first[i + 1]; ++k) {
      for (uint32_t other : model.tet[model.corner[k] / 4].node) {
        if (other < i) taken[colour[other] / 64] |= uint64_t(1) << (colour[other] % 64);
      }
    }
    int word = 0;
    while (word < 3 && taken[word] == ~uint64_t(0)) ++word;
    const int first = 64 * word + std::countr_one(taken[word]);
    if (first >= most_colours) return {};
    colour[i] = uint8_t(first);
  }
  return colour;
}

// The other corners of a tet, seen from each corner: even permutations, which keep the orientation.
constexpr int others[4][3] = {{1, 2, 3}, {0, 3, 2}, {3, 0, 1}, {2, 1, 0}};

// Fills near and over.
void find_neighbours(const Model& model, SweepOrder& out) {
  const uint32_t n = uint32_t(model.node.size());
  std::vector<uint32_t> met_node(n, n), met_group(out.group.size(), n);
  out.near_first = out.over_first = {0};
  for (uint32_t i = 0; i < n; ++i) {
    met_node[i] = i;
    for (uint32_t k = model.node_first[i]; k < model.node_first[i + 1]; ++k) {
      for (const uint32_t other : out.corner[k].other) {
        if (met_node[other] == i || model.node_anchored[other]) continue;
        met_node[other] = i;
        out.near.push_back(other);
      }
      const uint32_t group = out.corner[k].tet / lanes;
      if (met_group[group] == i) continue;
      met_group[group] = i;
      out.over.push_back(group);
    }
    out.near_first.push_back(uint32_t(out.near.size()));
    out.over_first.push_back(uint32_t(out.over.size()));
  }
}

}  // namespace

SweepOrder make_sweep_order(const Model& model) {
  SweepOrder out;
  out.colour = {0};
  const std::vector<uint8_t> colour = colour_of(model);
  if (colour.empty()) return {};
  std::vector<std::vector<uint32_t>> nodes(512);  // by colour; of each colour free nodes come before anchored ones
  for (uint32_t i = 0; i < colour.size(); ++i) nodes[2 * colour[i] + model.node_anchored[i]].push_back(i);
  for (size_t list = 0; list < nodes.size(); ++list) {
    std::vector<uint32_t>& all = nodes[list];
    for (size_t begin = 0; begin < all.size(); begin += sorted_together) {
      const auto tets_of = [&](uint32_t node) { return model.node_first[node + 1] - model.node_first[node]; };
      std::stable_sort(all.begin() + begin, all.begin() + std::min(all.size(), begin + sorted_together),
                       [&](uint32_t a, uint32_t b) { return tets_of(a) > tets_of(b); });
    }
    out.node.insert(out.node.end(), all.begin(), all.end());
    const bool last_of_colour = list % 2 == 1;
    if (last_of_colour && out.node.size() > out.colour.back()) out.colour.push_back(uint32_t(out.node.size()));
  }
  out.group.resize((model.tet.size() + lanes - 1) / lanes);
  for (size_t t = 0; t < lanes * out.group.size(); ++t) {
    for (int k = 0; k < 4; ++k) {
      out.group[t / lanes].node[k][t % lanes] = t < model.tet.size() ? model.tet[t].node[k] : uint32_t(model.node.size());
    }
  }
  out.corner.resize(4 * model.tet.size());
  out.slot.resize(4 * model.tet.size());
  for (uint32_t k = 0; k < model.corner.size(); ++k) {
    const uint32_t which = model.corner[k] % 4, tet = model.corner[k] / 4;
    for (int o = 0; o < 3; ++o) out.corner[k].other[o] = model.tet[tet].node[others[which][o]];
    out.corner[k].tet = tet;
    out.slot[model.corner[k]] = k;
  }
  find_neighbours(model, out);
  return out;
}

}  // namespace crumple

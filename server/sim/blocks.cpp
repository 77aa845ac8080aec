#include "sim/blocks.h"

#include <algorithm>
#include <bit>

#include "sim/model.h"

namespace crumple {
namespace {

// Greedy, in the model's spatial order: the first colour that no neighbour has.
std::vector<uint8_t> colour_of(const Model& model) {
  std::vector<uint8_t> colour(model.node.size(), 255);
  for (uint32_t i = 0; i < model.node.size(); ++i) {
    uint64_t taken[4] = {};
    for (uint32_t k = model.node_first[i]; k < model.node_first[i + 1]; ++k) {
      for (uint32_t other : model.tet[model.corner[k] / 4].node) {
        if (other < i) taken[colour[other] / 64] |= uint64_t(1) << (colour[other] % 64);
      }
    }
    int word = 0;
    while (word < 3 && taken[word] == ~uint64_t(0)) ++word;
    colour[i] = uint8_t(std::min(255, 64 * word + std::countr_one(taken[word])));
  }
  return colour;
}

// The corners of a tet seen from each: even permutations, so that the sense stays.
constexpr int others[4][3] = {{1, 2, 3}, {0, 3, 2}, {3, 0, 1}, {2, 1, 0}};

void add_block(const Model& model, const uint32_t* node, size_t count, Blocks& out) {
  const uint32_t nowhere = uint32_t(model.node.size()), nothing = uint32_t(model.tet.size());
  const size_t block = out.anchored.size(), first = out.rows.size();
  out.anchored.push_back(model.node_anchored[node[0]]);
  out.unused.push_back(uint16_t(0xffffu << count));
  size_t rows = 0;
  for (size_t lane = 0; lane < count; ++lane) {
    rows = std::max<size_t>(rows, model.node_first[node[lane] + 1] - model.node_first[node[lane]]);
  }
  Row blank;
  for (auto& other : blank.other) std::fill(other, other + lanes, nowhere);
  std::fill(blank.tet, blank.tet + lanes, nothing);
  out.rows.resize(first + rows, blank);
  for (size_t lane = 0; lane < lanes; ++lane) {
    const uint32_t i = lane < count ? node[lane] : nowhere;
    out.node.push_back(i);
    if (i == nowhere) continue;
    out.place[i] = uint32_t(lanes * block + lane);
    size_t row = first;
    for (uint32_t k = model.node_first[i]; k < model.node_first[i + 1]; ++k, ++row) {
      const uint32_t tet = model.corner[k] / 4, corner = model.corner[k] % 4;
      for (int o = 0; o < 3; ++o) out.rows[row].other[o][lane] = model.tet[tet].node[others[corner][o]];
      out.rows[row].tet[lane] = tet;
      out.slot[model.corner[k]] = uint32_t(lanes * row + lane);
    }
  }
  out.row.push_back(uint32_t(out.rows.size()));
}

void list_neighbours(const Model& model, Blocks& out) {
  const size_t count = out.anchored.size();
  std::vector<uint32_t> block_seen(count, UINT32_MAX), group_seen(out.group.size(), UINT32_MAX);
  out.near_first = out.over_first = {0};
  for (uint32_t block = 0; block < count; ++block) {
    for (size_t lane = 0; lane < lanes; ++lane) {
      const uint32_t i = out.node[lanes * block + lane];
      if (i >= model.node.size()) continue;
      for (uint32_t k = model.node_first[i]; k < model.node_first[i + 1]; ++k) {
        const uint32_t tet = model.corner[k] / 4;
        if (group_seen[tet / lanes] != block) out.over.push_back(tet / lanes);
        group_seen[tet / lanes] = block;
        for (uint32_t other : model.tet[tet].node) {
          const uint32_t near = out.place[other] / lanes;
          if (near != block && !out.anchored[near] && block_seen[near] != block) out.near.push_back(near);
          block_seen[near] = block;
        }
      }
    }
    out.near_first.push_back(uint32_t(out.near.size()));
    out.over_first.push_back(uint32_t(out.over.size()));
  }
}

}  // namespace

Blocks make_blocks(const Model& model) {
  Blocks out;
  out.row = {0};
  out.colour = {0};
  out.slot.resize(4 * model.tet.size());
  out.place.resize(model.node.size());
  const std::vector<uint8_t> colour = colour_of(model);
  std::vector<std::vector<uint32_t>> nodes(512);  // by colour, free ones before anchored ones
  for (uint32_t i = 0; i < colour.size(); ++i) nodes[2 * colour[i] + model.node_anchored[i]].push_back(i);
  out.rows.reserve(model.corner.size() / lanes * 5 / 4);
  for (size_t list = 0; list < nodes.size(); ++list) {
    std::vector<uint32_t>& all = nodes[list];
    for (size_t begin = 0; begin < all.size(); begin += lanes) {
      add_block(model, &all[begin], std::min<size_t>(lanes, all.size() - begin), out);
    }
    const bool last_of_colour = list % 2 == 1;
    if (last_of_colour && out.anchored.size() > out.colour.back()) out.colour.push_back(uint32_t(out.anchored.size()));
  }
  out.group.resize((model.tet.size() + lanes - 1) / lanes);
  for (size_t t = 0; t < lanes * out.group.size(); ++t) {
    for (int k = 0; k < 4; ++k) {
      out.group[t / lanes].node[k][t % lanes] = t < model.tet.size() ? model.tet[t].node[k] : uint32_t(model.node.size());
    }
  }
  list_neighbours(model, out);
  return out;
}

}  // namespace crumple

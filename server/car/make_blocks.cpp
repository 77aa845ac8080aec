#include "car/make_blocks.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <bit>

namespace crumple {
namespace {

constexpr uint32_t blocks_a_part = 256;  // blocks in one part of the parallel work

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

// Adds a block before its rows exist: its nodes, and the place of each node.
void place_block(const Model& model, const uint32_t* node, size_t count, Blocks& out) {
  const uint32_t block = uint32_t(out.anchored.size());
  out.anchored.push_back(model.node_anchored[node[0]]);
  out.unused.push_back(uint16_t(0xffffu << count));
  uint32_t rows = 0;
  for (uint32_t lane = 0; lane < lanes; ++lane) {
    out.node.push_back(lane < count ? node[lane] : uint32_t(model.node.size()));
    if (lane >= count) continue;
    out.place[node[lane]] = lanes * block + lane;
    rows = std::max(rows, model.node_first[node[lane] + 1] - model.node_first[node[lane]]);
  }
  out.row.push_back(out.row.back() + rows);
}

// The neighbours of some blocks (near and over, as in Blocks), and marks for what the current block has met already.
struct Around {
  std::vector<uint32_t> near, over, near_end, over_end;
  std::vector<uint32_t> met_blocks, met_groups;
};

// Fills in the rows of a block and finds its neighbours.
void fill_block(const Model& model, uint32_t block, Around& around, Blocks& out) {
  around.met_blocks[block] = block;
  for (uint32_t lane = 0; lane < lanes; ++lane) {
    const uint32_t i = out.node[lanes * block + lane];
    uint32_t row = out.row[block];
    const uint32_t end = i < model.node.size() ? model.node_first[i + 1] : 0;
    for (uint32_t k = i < model.node.size() ? model.node_first[i] : 0; k < end; ++k, ++row) {
      const uint32_t corner = model.corner[k] % 4, tet = model.corner[k] / 4, group = tet / lanes;
      Row& to = out.rows[row];
      to.tet[lane] = tet;
      out.slot[model.corner[k]] = lanes * row + lane;
      for (int o = 0; o < 3; ++o) {
        const uint32_t other = model.tet[tet].node[others[corner][o]], near = out.place[other] / lanes;
        to.other[o][lane] = other;
        if (around.met_blocks[near] == block) continue;
        around.met_blocks[near] = block;
        if (!out.anchored[near]) around.near.push_back(near);
      }
      if (around.met_groups[group] == block) continue;
      around.met_groups[group] = block;
      around.over.push_back(group);
    }
    for (; row < out.row[block + 1]; ++row) {
      for (auto& other : out.rows[row].other) other[lane] = uint32_t(model.node.size());
      out.rows[row].tet[lane] = uint32_t(model.tet.size());
    }
  }
  around.near_end.push_back(uint32_t(around.near.size()));
  around.over_end.push_back(uint32_t(around.over.size()));
}

void append(const std::vector<uint32_t>& list, const std::vector<uint32_t>& ends, std::vector<uint32_t>& all,
            std::vector<uint32_t>& first) {
  const uint32_t start = uint32_t(all.size());
  all.insert(all.end(), list.begin(), list.end());
  for (uint32_t end : ends) first.push_back(start + end);
}

}  // namespace

Blocks make_blocks(const Model& model) {
  Blocks out;
  out.row = {0};
  out.colour = {0};
  out.place.resize(model.node.size());
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
    for (size_t begin = 0; begin < all.size(); begin += lanes) {
      place_block(model, &all[begin], std::min<size_t>(lanes, all.size() - begin), out);
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
  out.rows.resize(out.row.back());
  out.slot.resize(4 * model.tet.size());
  const uint32_t blocks = uint32_t(out.anchored.size());
  std::vector<Around> parts((blocks + blocks_a_part - 1) / blocks_a_part);
  tbb::parallel_for(size_t(0), parts.size(), [&](size_t part) {
    parts[part].met_blocks.assign(blocks, UINT32_MAX);
    parts[part].met_groups.assign(out.group.size(), UINT32_MAX);
    const uint32_t begin = uint32_t(part) * blocks_a_part;
    for (uint32_t block = begin; block < std::min(blocks, begin + blocks_a_part); ++block) {
      fill_block(model, block, parts[part], out);
    }
  });
  out.near_first = out.over_first = {0};
  for (const Around& part : parts) {
    append(part.near, part.near_end, out.near, out.near_first);
    append(part.over, part.over_end, out.over, out.over_first);
  }
  return out;
}

}  // namespace crumple

#include "sim/blocks.h"

#include <algorithm>
#include <cstring>

#include "sim/model.h"

namespace crumple {
namespace {

using Words = uint32_t __attribute__((vector_size(16)));
static_assert(sizeof(Corner) == sizeof(Words) && sizeof(CornerWeights) == sizeof(Words) && sizeof(float) == sizeof(uint32_t));

// Writes word w of the four 16-byte records to w-th list: to[w][0..4).
template <int Count, class Word>
void transpose(const void* const from[4], Word* const (&to)[Count]) {
  Words row[4];
  for (int k = 0; k < 4; ++k) std::memcpy(&row[k], from[k], sizeof(Words));
  const Words low01 = __builtin_shufflevector(row[0], row[1], 0, 4, 1, 5),
              high01 = __builtin_shufflevector(row[0], row[1], 2, 6, 3, 7);
  const Words low23 = __builtin_shufflevector(row[2], row[3], 0, 4, 1, 5),
              high23 = __builtin_shufflevector(row[2], row[3], 2, 6, 3, 7);
  const Words word[4] = {__builtin_shufflevector(low01, low23, 0, 1, 4, 5), __builtin_shufflevector(low01, low23, 2, 3, 6, 7),
                         __builtin_shufflevector(high01, high23, 0, 1, 4, 5),
                         __builtin_shufflevector(high01, high23, 2, 3, 6, 7)};
  for (int w = 0; w < Count; ++w) std::memcpy(to[w], &word[w], sizeof(Words));
}

// Fills in the rows of a block with `count` nodes from `node` on.
void fill_rows(const Model& model, std::span<const CornerWeights> weights, const uint32_t* node, size_t count, Blocks& out) {
  const SweepOrder& order = *model.order;
  const uint32_t n = uint32_t(model.node.size());
  const Corner no_corner = {{n, n, n}, uint32_t(model.tet.size())};
  const CornerWeights no_weights;
  uint32_t degree[lanes] = {}, first_corner[lanes] = {}, most = 0;
  for (size_t lane = 0; lane < count; ++lane) {
    first_corner[lane] = model.node_first[node[lane]];
    degree[lane] = model.node_first[node[lane] + 1] - first_corner[lane];
    most = std::max(most, degree[lane]);
  }
  const uint32_t first = out.row.back();
  out.row.push_back(first + most);
  if (out.rows.size() < first + most) {
    out.rows.resize(2 * (first + most));
    out.weights.resize(2 * (first + most));
  }
  for (uint32_t k = 0; k < most; ++k) {
    Row& row = out.rows[first + k];
    Weights& weight = out.weights[first + k];
    for (int lane = 0; lane < lanes; lane += 4) {
      const void *corner[4], *dots[4];
      for (int l = 0; l < 4; ++l) {
        const bool used = k < degree[lane + l];
        const uint32_t at = first_corner[lane + l] + k;
        corner[l] = used ? &order.corner[at] : &no_corner;
        dots[l] = used ? &weights[at] : &no_weights;
      }
      transpose<4, uint32_t>(corner, {row.other[0] + lane, row.other[1] + lane, row.other[2] + lane, row.tet + lane});
      transpose<3, float>(dots, {weight.other[0] + lane, weight.other[1] + lane, weight.other[2] + lane});
    }
  }
}

void add_block(const Model& model, std::span<const CornerWeights> weights, const uint32_t* node, size_t count, Blocks& out) {
  const uint32_t block = uint32_t(out.anchored.size());
  out.anchored.push_back(model.node_anchored[node[0]]);
  out.unused.push_back(uint16_t(0xffffu << count));
  for (uint32_t lane = 0; lane < lanes; ++lane) {
    out.node.push_back(lane < count ? node[lane] : uint32_t(model.node.size()));
    if (lane < count) out.place[node[lane]] = lanes * block + lane;
  }
  fill_rows(model, weights, node, count, out);
}

}  // namespace

void pack(const Model& model, std::span<const uint8_t> awake, std::span<const CornerWeights> weights, Blocks& out) {
  const SweepOrder& order = *model.order;
  for (auto* list : {&out.node, &out.row, &out.colour}) list->clear();
  out.unused.clear();
  out.anchored.clear();
  out.place.resize(model.node.size());
  out.row.push_back(0);
  out.colour.push_back(0);
  uint32_t waiting[lanes];
  size_t count = 0;
  const auto flush = [&] {
    if (count > 0) add_block(model, weights, waiting, count, out);
    count = 0;
  };
  for (size_t c = 0; c + 1 < order.colour.size(); ++c) {
    for (uint32_t k = order.colour[c]; k < order.colour[c + 1]; ++k) {
      const uint32_t node = order.node[k];
      if (!awake[node]) continue;
      if (count > 0 && model.node_anchored[waiting[0]] != model.node_anchored[node]) flush();
      waiting[count++] = node;
      if (count == lanes) flush();
    }
    flush();
    out.colour.push_back(uint32_t(out.anchored.size()));
  }
}

}  // namespace crumple

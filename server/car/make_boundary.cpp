#include "car/make_boundary.h"

#include <tbb/parallel_for.h>

#include <algorithm>

namespace crumple {
namespace {

constexpr uint32_t nodes_a_part = 1024;

// The corners of the face opposite to each corner, outward if the tet is positively oriented.
constexpr int opposite[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

// A face at its lowest node: its two other nodes in ascending order, and 4 * tet + the corner opposite to it.
struct Face {
  uint32_t middle, high, corner;
};

bool same_nodes(const Face& a, const Face& b) { return a.middle == b.middle && a.high == b.high; }

// Calls visit(lowest node, face) for every face of every tet.
template <class Visit>
void for_each_face(const Model& model, const Visit& visit) {
  for (uint32_t t = 0; t < model.tet.size(); ++t) {
    for (uint32_t corner = 0; corner < 4; ++corner) {
      uint32_t node[3];
      for (int k = 0; k < 3; ++k) node[k] = model.tet[t].node[opposite[corner][k]];
      std::sort(node, node + 3);
      visit(node[0], Face{node[1], node[2], 4 * t + corner});
    }
  }
}

}  // namespace

Boundary make_boundary(const Model& model) {
  const size_t nodes = model.node.size();
  std::vector<uint32_t> first(nodes + 2, 0);  // faces of lowest node i: first[i] .. first[i + 1), once they are all placed
  for_each_face(model, [&](uint32_t lowest, const Face&) { ++first[lowest + 2]; });
  for (size_t i = 2; i < first.size(); ++i) first[i] += first[i - 1];
  std::vector<Face> face(4 * model.tet.size());
  for_each_face(model, [&](uint32_t lowest, const Face& each) { face[first[lowest + 1]++] = each; });
  std::vector<uint8_t> single(face.size(), 0);  // per 4 * tet + corner: no other tet has the face
  tbb::parallel_for(tbb::blocked_range<size_t>(0, nodes, nodes_a_part), [&](const tbb::blocked_range<size_t>& part) {
    for (size_t i = part.begin(); i < part.end(); ++i) {
      const auto begin = face.begin() + first[i], end = face.begin() + first[i + 1];
      std::sort(begin, end, [](const Face& a, const Face& b) {
        return a.middle != b.middle ? a.middle < b.middle : a.high != b.high ? a.high < b.high : a.corner < b.corner;
      });
      for (auto each = begin; each != end; ++each) {
        const bool before = each != begin && same_nodes(each[-1], *each), after = each + 1 != end && same_nodes(each[1], *each);
        single[each->corner] = !before && !after;
      }
    }
  });
  Boundary out;
  std::vector<uint8_t> outside(nodes, 0);
  for (uint32_t corner = 0; corner < single.size(); ++corner) {
    if (!single[corner]) continue;
    const auto& [a, b, c] = opposite[corner % 4];
    const uint32_t* node = model.tet[corner / 4].node;
    out.triangle.push_back({node[a], node[b], node[c]});
    for (uint32_t each : out.triangle.back()) outside[each] = 1;
  }
  for (uint32_t i = 0; i < nodes; ++i) {
    if (outside[i]) out.node.push_back(i);
  }
  return out;
}

}  // namespace crumple

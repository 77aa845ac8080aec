#include "sim/anderson.h"

#include <Eigen/Dense>
#include <algorithm>

#include "sim/kernels.h"

namespace crumple {
namespace {

constexpr double growth = 4;             // of the squared residual: more than this, and the mix has failed
constexpr double regularisation = 1e-6;  // relative; sums are in single precision

constexpr uint32_t nodes_at_once = 1024;  // a piece of work; a multiple of what the kernels sum together
using Products = std::array<double, anderson_depth>;

// Dot products of `first` with each of `others`.
Products products(const std::vector<Float4>& first, std::span<const std::vector<Float4>> others, Team& team) {
  return team.sum<anderson_depth>(uint32_t(first.size()), nodes_at_once, [&](uint32_t begin, uint32_t end, double* sums) {
    const Float4* each[anderson_depth];
    for (size_t p = 0; p < others.size(); ++p) each[p] = &others[p][begin];
    kernels().anderson.products(&first[begin], each, int(others.size()), end - begin, sums);
  });
}

// The weights with which the changes of f cancel most of f.
using Weighting = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, anderson_depth, 1>;
Weighting combine(const AndersonHistory& history, const Products& right) {
  const int m = history.count;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, anderson_depth, anderson_depth> products(m, m);
  for (int p = 0; p < m; ++p) {
    for (int q = 0; q < m; ++q) products(p, q) = history.products[p][q];
  }
  products.diagonal() *= 1 + regularisation;
  products.diagonal().array() += 1e-30;
  return products.ldlt().solve(Eigen::Map<const Weighting>(right.data(), m));
}

}  // namespace

bool is_sound(const AndersonHistory& history, size_t nodes) {
  const int count = history.count, next = history.next;
  bool good = count >= 0 && count <= anderson_depth && next >= 0 && next < anderson_depth;
  good = good && (count == anderson_depth || next == count);  // the oldest change is the one that is overwritten next
  const size_t size = padded_nodes(nodes);
  for (size_t k = 0; good && k < size_t(count); ++k)
    good = history.residual[k].size() == size && history.result[k].size() == size;
  return good;
}

void Anderson::begin() {
  compared_ = false;
  mixed_ = false;
}

void Anderson::compare(std::span<const Float4> before, std::span<Float4> node, Team& team, AndersonHistory& history) {
  const size_t n = node.size();
  for (auto* list : {&residual_, &result_, &unmixed_}) list->resize(n);
  const int slot = history.next;
  // Without a previous step there is no change. The kernel then writes to unmixed_, which mix() overwrites before it is read.
  std::vector<Float4>& residual_change = compared_ ? history.residual[slot] : unmixed_;
  std::vector<Float4>& result_change = compared_ ? history.result[slot] : unmixed_;
  residual_change.resize(n);
  result_change.resize(n);
  const double size = team.sum<1>(uint32_t(n), nodes_at_once, [&](uint32_t k, uint32_t end, double* sum) {
    kernels().anderson.compare(&node[k], &before[k], end - k, &residual_[k], &result_[k], &residual_change[k],
                               &result_change[k], sum);
  })[0];
  if (mixed_ && !(size <= growth * residual_size_)) {
    std::copy(unmixed_.begin(), unmixed_.end(), node.begin());
    history.count = history.next = 0;
    return begin();
  }
  if (compared_) {
    history.count = std::max(history.count, slot + 1);
    history.next = (slot + 1) % anderson_depth;
    const Products row = products(history.residual[slot], {history.residual.data(), size_t(history.count)}, team);
    for (int p = 0; p < history.count; ++p) history.products[slot][p] = history.products[p][slot] = row[p];
  }
  residual_size_ = size;
  compared_ = true;
  mixed_ = false;
}

void Anderson::mix(std::span<Float4> node, Team& team, const AndersonHistory& history) {
  const int m = history.count;
  if (!compared_ || m == 0) return;
  const Weighting weight = combine(history, products(residual_, {history.residual.data(), size_t(m)}, team));
  if (!weight.allFinite()) return;
  mixed_ = true;
  team.run(0, uint32_t(node.size()), nodes_at_once, [&](uint32_t k, uint32_t end) {
    const Float4* changes[anderson_depth];
    float by[anderson_depth];
    for (int p = 0; p < m; ++p) {
      changes[p] = &history.result[p][k];
      by[p] = -float(weight[p]);
    }
    std::copy_n(&node[k], end - k, &unmixed_[k]);
    kernels().anderson.combine(changes, by, m, end - k, &node[k]);
  });
}

}  // namespace crumple

#include "sim/mixing.h"

#include <Eigen/Dense>
#include <algorithm>
#include <span>

#include "sim/scratch.h"

namespace crumple {
namespace {

constexpr double growth = 4;             // of the squared residual, beyond which a mixing has failed
constexpr double regularisation = 1e-6;  // relative; sums are in single precision

// work(first, last, sums) on all nodes, piece by piece, by all free threads; the pieces' sums are added in their order.
constexpr uint32_t quads_at_once = 1024;  // whole sums of the kernels
using Sums = std::array<double, mixing_depth>;
template <class Work>
Sums over_nodes(Scratch& scratch, const Work& work) {
  const auto n = uint32_t(scratch.node.size());
  scratch.sums.assign((n + quads_at_once - 1) / quads_at_once, {});
  scratch.team.run(0, n, quads_at_once, [&](uint32_t first, uint32_t last) {
    for (; first < last; first += quads_at_once) {  // without helpers the whole range comes at once
      work(first, std::min(last - first, quads_at_once), scratch.sums[first / quads_at_once].data());
    }
  });
  Sums total = {};
  for (const Sums& sum : scratch.sums) {
    for (int k = 0; k < mixing_depth; ++k) total[k] += sum[k];
  }
  return total;
}

// Of `first` with each of `others`.
Sums products(const std::vector<Quad>& first, std::span<const std::vector<Quad>> others, Scratch& scratch) {
  return over_nodes(scratch, [&](uint32_t begin, uint32_t count, double* sums) {
    const Quad* each[mixing_depth];
    for (size_t p = 0; p < others.size(); ++p) each[p] = &others[p][begin];
    kernels().products(&first[begin], each, int(others.size()), count, sums);
  });
}

// Coefficients of the combination of changes that cancels most of f.
using Weighting = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, mixing_depth, 1>;
Weighting combine(const History& history, const double* right) {
  const int m = history.count;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, mixing_depth, mixing_depth> products(m, m);
  for (int p = 0; p < m; ++p) {
    for (int q = 0; q < m; ++q) products(p, q) = history.products[p][q];
  }
  products.diagonal() *= 1 + regularisation;
  products.diagonal().array() += 1e-30;
  return products.ldlt().solve(Eigen::Map<const Weighting>(right, m));
}

}  // namespace

void begin_mixing(Scratch& scratch) {
  scratch.compared = false;
  scratch.mixed = false;
}

void compare_step(Scratch& scratch, History& history) {
  const size_t n = scratch.node.size();
  for (auto* list : {&scratch.residual, &scratch.result, &scratch.unmixed}) list->resize(n);
  const int slot = history.next;
  // Into the history, or nowhere if there was no last step.
  std::vector<Quad>& residual_change = scratch.compared ? history.residual[slot] : scratch.direction;
  std::vector<Quad>& result_change = scratch.compared ? history.result[slot] : scratch.direction;
  residual_change.resize(n);
  result_change.resize(n);
  const double size = over_nodes(scratch, [&](uint32_t k, uint32_t count, double* sum) {
    kernels().compare(&scratch.node[k], &scratch.from[k], count, &scratch.residual[k], &scratch.result[k], &residual_change[k],
                      &result_change[k], sum);
  })[0];
  if (scratch.mixed && !(size <= growth * scratch.residual_size)) {
    scratch.node = scratch.unmixed;
    history.count = history.next = 0;
    return begin_mixing(scratch);
  }
  if (scratch.compared) {
    history.count = std::max(history.count, slot + 1);
    history.next = (slot + 1) % mixing_depth;
    const Sums row = products(history.residual[slot], {history.residual.data(), size_t(history.count)}, scratch);
    for (int p = 0; p < history.count; ++p) history.products[slot][p] = history.products[p][slot] = row[p];
  }
  scratch.residual_size = size;
  scratch.compared = true;
  scratch.mixed = false;
}

void mix(Scratch& scratch, const History& history) {
  const int m = history.count;
  if (!scratch.compared || m == 0) return;
  const Sums right = products(scratch.residual, {history.residual.data(), size_t(m)}, scratch);
  const Weighting weight = combine(history, right.data());
  if (!weight.allFinite()) return;
  scratch.mixed = true;
  over_nodes(scratch, [&](uint32_t k, uint32_t count, double*) {
    const Quad* changes[mixing_depth];
    float by[mixing_depth];
    for (int p = 0; p < m; ++p) {
      changes[p] = &history.result[p][k];
      by[p] = -float(weight[p]);
    }
    std::copy_n(&scratch.node[k], count, &scratch.unmixed[k]);
    kernels().combine(changes, by, m, count, &scratch.node[k]);
  });
}

}  // namespace crumple

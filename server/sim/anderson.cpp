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
Weighting combine(std::span<const AndersonPart> parts) {
  const int m = parts.front().history.count;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, anderson_depth, anderson_depth> all(m, m);
  Weighting right(m);
  all.setZero();
  right.setZero();
  for (const AndersonPart& part : parts) {
    const AndersonHistory& history = part.history;
    const Products own = products(part.last.residual, {history.residual.data(), size_t(m)}, part.team);
    for (int p = 0; p < m; ++p) {
      for (int q = 0; q < m; ++q) all(p, q) += history.products[p][q];
      right[p] += own[p];
    }
  }
  all.diagonal() *= 1 + regularisation;
  all.diagonal().array() += 1e-30;
  return all.ldlt().solve(right);
}

// Writes f and g of the step, and their changes since the previous step. Returns the squared length of f, m^2.
double measure_change(const AndersonPart& part) {
  AndersonStep& last = part.last;
  AndersonHistory& history = part.history;
  const size_t n = part.node.size();
  for (auto* list : {&last.residual, &last.result, &last.unmixed}) list->resize(n);
  // Without a previous step there is no change. The kernel then writes to `unmixed`, which mix() overwrites before it is read.
  std::vector<Float4>& residual_change = last.compared ? history.residual[history.next] : last.unmixed;
  std::vector<Float4>& result_change = last.compared ? history.result[history.next] : last.unmixed;
  residual_change.resize(n);
  result_change.resize(n);
  return part.team.sum<1>(uint32_t(n), nodes_at_once, [&](uint32_t k, uint32_t end, double* sum) {
    kernels().anderson.compare(&part.node[k], &part.before[k], end - k, &last.residual[k], &last.result[k], &residual_change[k],
                               &result_change[k], sum);
  })[0];
}

void add_change(const AndersonPart& part) {
  AndersonHistory& history = part.history;
  const int slot = history.next;
  history.count = std::max(history.count, slot + 1);
  history.next = (slot + 1) % anderson_depth;
  const Products row = products(history.residual[slot], {history.residual.data(), size_t(history.count)}, part.team);
  for (int p = 0; p < history.count; ++p) history.products[slot][p] = history.products[p][slot] = row[p];
}

void clear(AndersonHistory& history) { history.count = history.next = 0; }

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

void begin_substep(std::span<const AndersonPart> parts) {
  const AndersonHistory& first = parts.front().history;
  const bool together = std::all_of(parts.begin(), parts.end(), [&](const AndersonPart& part) {
    return part.history.count == first.count && part.history.next == first.next;
  });
  for (const AndersonPart& part : parts) {
    part.last.compared = part.last.mixed = false;
    if (!together) clear(part.history);
  }
}

void compare(std::span<const AndersonPart> parts) {
  double size = 0, previous = 0;  // of all parts together
  for (const AndersonPart& part : parts) {
    previous += part.last.residual_size;
    size += part.last.new_size = measure_change(part);
  }
  const AndersonStep& last = parts.front().last;
  const bool failed = last.mixed && !(size <= growth * previous), compared = last.compared;
  for (const AndersonPart& part : parts) {
    if (!failed) part.last.residual_size = part.last.new_size;
    if (failed) {
      std::copy(part.last.unmixed.begin(), part.last.unmixed.end(), part.node.begin());
      clear(part.history);
    } else if (compared) {
      add_change(part);
    }
    part.last.compared = !failed;
    part.last.mixed = false;
  }
}

void mix(std::span<const AndersonPart> parts) {
  const int m = parts.front().history.count;
  if (!parts.front().last.compared || m == 0) return;
  const Weighting weight = combine(parts);
  if (!weight.allFinite()) return;
  for (const AndersonPart& part : parts) {
    part.last.mixed = true;
    part.team.run(0, uint32_t(part.node.size()), nodes_at_once, [&](uint32_t k, uint32_t end) {
      const Float4* changes[anderson_depth];
      float by[anderson_depth];
      for (int p = 0; p < m; ++p) {
        changes[p] = &part.history.result[p][k];
        by[p] = -float(weight[p]);
      }
      std::copy_n(&part.node[k], end - k, &part.last.unmixed[k]);
      kernels().anderson.combine(changes, by, m, end - k, &part.node[k]);
    });
  }
}

}  // namespace crumple

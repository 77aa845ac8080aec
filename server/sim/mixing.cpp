#include "sim/mixing.h"

#include <Eigen/Dense>

#include "sim/scratch.h"

namespace crumple {
namespace {

constexpr double growth = 4;             // of the squared residual, beyond which a mixing has failed
constexpr double regularisation = 1e-6;  // relative; sums are in single precision

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

void mix(Scratch& scratch, History& history) {
  const size_t n = scratch.node.size();
  const Kernels& kernel = kernels();
  for (auto* list : {&scratch.residual, &scratch.result, &scratch.unmixed}) list->resize(n);
  const int slot = history.next;
  if (scratch.compared) {
    history.residual[slot].resize(n);
    history.result[slot].resize(n);
  }
  // This step's f and g against the last one's; what changed goes into the history, or nowhere if there was no last one.
  double size = 0;
  kernel.compare(scratch.node.data(), scratch.from.data(), n, scratch.residual.data(), scratch.result.data(),
                 (scratch.compared ? history.residual[slot] : scratch.unmixed).data(),
                 (scratch.compared ? history.result[slot] : scratch.unmixed).data(), &size);
  if (scratch.mixed && !(size <= growth * scratch.residual_size)) {
    scratch.node = scratch.unmixed;
    history.count = history.next = 0;
    return begin_mixing(scratch);
  }
  const Quad* changes[mixing_depth];
  if (scratch.compared) {
    history.count = std::max(history.count, slot + 1);
    history.next = (slot + 1) % mixing_depth;
  }
  const int m = history.count;
  for (int p = 0; p < m; ++p) changes[p] = history.residual[p].data();
  if (scratch.compared) {
    double row[mixing_depth];
    kernel.products(changes[slot], changes, m, n, row);
    for (int p = 0; p < m; ++p) history.products[slot][p] = history.products[p][slot] = row[p];
  }
  scratch.residual_size = size;
  scratch.compared = true;
  scratch.mixed = false;
  if (m == 0) return;
  double right[mixing_depth];
  kernel.products(scratch.residual.data(), changes, m, n, right);
  const Weighting weight = combine(history, right);
  if (!weight.allFinite()) return;
  scratch.unmixed = scratch.node;
  scratch.mixed = true;
  float by[mixing_depth];
  for (int p = 0; p < m; ++p) {
    changes[p] = history.result[p].data();
    by[p] = -float(weight[p]);
  }
  kernel.combine(changes, by, m, n, scratch.node.data());
}

void end_mixing(Scratch& scratch, History& history) {
  if (!scratch.mixed) return;
  double size = 0;
  kernels().compare(scratch.node.data(), scratch.from.data(), scratch.node.size(), scratch.residual.data(),
                    scratch.result.data(), scratch.direction.data(), scratch.direction.data(), &size);
  if (size <= growth * scratch.residual_size) return;
  scratch.node = scratch.unmixed;
  history.count = history.next = 0;
}

}  // namespace crumple

// The loops behind anderson_kernels.h for N lanes at a time; see kernels_of.h.
#pragma once

#include "sim/anderson_kernels.h"
#include "sim/sweep_order.h"

namespace crumple {
namespace {

// Sums of 256 nodes are in single precision, in 16 lanes for every N; these sums are added in double. So all N give the same
// bits.
constexpr size_t floats_together = 1024;

template <int N>
struct Sum {
  Floats<N> part[lanes / N] = {};
  CRUMPLE_INLINE double total() const {
    double sum = 0;
    for (const Floats<N>& each : part) {
      for (int k = 0; k < N; ++k) sum += double(each[k]);
    }
    return sum;
  }
};

// Calls work(i, part) on the floats [begin, end): N at a time, 16 per round.
template <int N, class Work>
CRUMPLE_INLINE void rounds(size_t begin, size_t end, const Work& work) {
  for (size_t i = begin; i < end; i += lanes) {
    for (int part = 0; part < lanes / N; ++part) work(i + part * N, part);
  }
}

template <int N>
void compare(const Float4* after, const Float4* before, size_t n, Float4* residual, Float4* result, Float4* residual_change,
             Float4* result_change, double* size) {
  const float *a = &after->x, *b = &before->x;
  float *f = &residual->x, *g = &result->x, *df = &residual_change->x, *dg = &result_change->x;
  *size = 0;
  for (size_t begin = 0; begin < 4 * n; begin += floats_together) {
    Sum<N> sum;
    rounds<N>(begin, 4 * n < begin + floats_together ? 4 * n : begin + floats_together,
              [&](size_t i, int part) [[gnu::always_inline]] {
                const Floats<N> now = load<N>(a + i), moved = now - load<N>(b + i);
                store<N>(moved - load<N>(f + i), df + i);
                store<N>(now - load<N>(g + i), dg + i);
                store<N>(moved, f + i);
                store<N>(now, g + i);
                sum.part[part] += moved * moved;
              });
    *size += sum.total();
  }
}

template <int N>
void products(const Float4* first, const Float4* const* others, int count, size_t n, double* out) {
  for (int p = 0; p < count; ++p) out[p] = 0;
  const float* a = &first->x;
  for (size_t begin = 0; begin < 4 * n; begin += floats_together) {
    for (int p = 0; p < count; ++p) {
      const float* b = &others[p]->x;
      Sum<N> sum;
      rounds<N>(begin, 4 * n < begin + floats_together ? 4 * n : begin + floats_together,
                [&](size_t i, int part) [[gnu::always_inline]] { sum.part[part] += load<N>(a + i) * load<N>(b + i); });
      out[p] += sum.total();
    }
  }
}

template <int N>
void combine(const Float4* const* others, const float* scale, int count, size_t n, Float4* to) {
  float* a = &to->x;
  for (size_t begin = 0; begin < 4 * n; begin += floats_together) {
    for (int p = 0; p < count; ++p) {
      const float* b = &others[p]->x;
      const Floats<N> by = broadcast<N>(scale[p]);
      rounds<N>(begin, 4 * n < begin + floats_together ? 4 * n : begin + floats_together,
                [&](size_t i, int) [[gnu::always_inline]] { store<N>(load<N>(a + i) + by * load<N>(b + i), a + i); });
    }
  }
}

template <int N>
constexpr AndersonKernels anderson_kernels_of() {
  return {compare<N>, products<N>, combine<N>};
}

}  // namespace
}  // namespace crumple

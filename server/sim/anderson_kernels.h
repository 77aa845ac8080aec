// The inner loops of anderson.h, on n Quads, a multiple of four; compiled and chosen as those of kernels.h are.
#pragma once

#include <cstddef>

#include "sim/vector.h"

namespace crumple {

struct AndersonKernels {
  // Replaces residual by after - before and result by after. By how much they changed goes out, and the square of the new
  // residual's length, m^2.
  void (*compare)(const Quad* after, const Quad* before, size_t n, Quad* residual, Quad* result, Quad* residual_change,
                  Quad* result_change, double* size);
  // out[p] = a . b[p], p < count.
  void (*products)(const Quad* a, const Quad* const* b, int count, size_t n, double* out);
  // to += sum scale[p] a[p], p < count.
  void (*combine)(const Quad* const* a, const float* scale, int count, size_t n, Quad* to);
};

}  // namespace crumple

// The inner loops of anderson.h, on n Float4s, a multiple of four; compiled and chosen as those of kernels.h are.
#pragma once

#include <cstddef>

#include "sim/vector.h"

namespace crumple {

struct AndersonKernels {
  // Replaces residual by after - before and result by after. By how much they changed goes out, and the square of the new
  // residual's length, m^2.
  void (*compare)(const Float4* after, const Float4* before, size_t n, Float4* residual, Float4* result,
                  Float4* residual_change, Float4* result_change, double* size);
  // out[p] = a . b[p], p < count.
  void (*products)(const Float4* a, const Float4* const* b, int count, size_t n, double* out);
  // to += sum scale[p] a[p], p < count.
  void (*combine)(const Float4* const* a, const float* scale, int count, size_t n, Float4* to);
};

}  // namespace crumple

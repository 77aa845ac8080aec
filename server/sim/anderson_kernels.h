// The inner loops of anderson.h on n Float4s, n a multiple of four. Compiled and chosen like the kernels of kernels.h.
#pragma once

#include <cstddef>

#include "sim/vector.h"

namespace crumple {

struct AndersonKernels {
  // Sets residual to after - before, and result to after. Writes how much both changed, and the squared length of the new
  // residual, m^2.
  void (*compare)(const Float4* after, const Float4* before, size_t n, Float4* residual, Float4* result,
                  Float4* residual_change, Float4* result_change, double* size);
  // out[p] = a . b[p], p < count.
  void (*products)(const Float4* a, const Float4* const* b, int count, size_t n, double* out);
  // to += sum scale[p] a[p], p < count.
  void (*combine)(const Float4* const* a, const float* scale, int count, size_t n, Float4* to);
};

}  // namespace crumple

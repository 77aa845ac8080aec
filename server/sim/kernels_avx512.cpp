#ifdef __x86_64__
#include "sim/kernels_of.h"

namespace crumple {

extern const Kernels kernels_avx512;
const Kernels kernels_avx512 = kernels_of<16>("avx512");

}  // namespace crumple
#endif

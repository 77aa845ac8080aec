#ifdef __x86_64__
#include "sim/kernels_of.h"

namespace crumple {

extern const Kernels kernels_avx2;
const Kernels kernels_avx2 = kernels_of<8>("avx2");

}  // namespace crumple
#endif

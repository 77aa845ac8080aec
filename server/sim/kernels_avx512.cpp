#ifdef __x86_64__
#include "sim/kernels_of.h"

namespace crumple {

extern const Kernels kernels_avx512;
const Kernels kernels_avx512 = {"avx512",   visit<16>,   renew<16>,    slope<16>,  flow<16>,
                                energy<16>, compare<16>, products<16>, combine<16>};

}  // namespace crumple
#endif

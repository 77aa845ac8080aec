#ifdef __x86_64__
#include "sim/kernels_of.h"

namespace crumple {

extern const Kernels kernels_avx2;
const Kernels kernels_avx2 = {"avx2", visit<8>, renew<8>, slope<8>, flow<8>, energy<8>, compare<8>, products<8>, combine<8>};

}  // namespace crumple
#endif

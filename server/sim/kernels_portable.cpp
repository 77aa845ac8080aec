#include "sim/kernels_of.h"

namespace crumple {

extern const Kernels kernels_portable;
const Kernels kernels_portable = {"portable", visit<4>,   renew<4>,    slope<4>,  flow<4>,
                                  energy<4>,  compare<4>, products<4>, combine<4>};

}  // namespace crumple

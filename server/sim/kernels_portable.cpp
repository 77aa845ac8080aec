#include "sim/kernels_of.h"

namespace crumple {

extern const Kernels kernels_portable;
const Kernels kernels_portable = kernels_of<4>("portable");

}  // namespace crumple

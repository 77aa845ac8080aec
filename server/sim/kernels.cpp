#include "sim/kernels.h"

#include <cstring>

namespace crumple {

extern const Kernels kernels_portable;
#ifdef __x86_64__
extern const Kernels kernels_avx2, kernels_avx512;
#endif

const Kernels* kernels(const char* name) {
#ifdef __x86_64__
  if (std::strcmp(name, "avx512") == 0) {
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
                   __builtin_cpu_supports("avx512bw")
               ? &kernels_avx512
               : nullptr;
  }
  if (std::strcmp(name, "avx2") == 0) return __builtin_cpu_supports("avx2") ? &kernels_avx2 : nullptr;
#endif
  return std::strcmp(name, "portable") == 0 ? &kernels_portable : nullptr;
}

const Kernels& kernels() {
  static const Kernels& best = *[] {
    for (const char* name : {"avx512", "avx2"}) {
      if (const Kernels* found = kernels(name)) return found;
    }
    return &kernels_portable;
  }();
  return best;
}

}  // namespace crumple

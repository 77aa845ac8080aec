// Whether this build has sanitizers, which make what computes ten to fifteen times slower. There a test may take fewer rounds
// or a smaller mesh, as long as all its code runs and all its checks hold: one pass shows a fault in memory as well as ten.
#pragma once

namespace crumple {

#if defined(CRUMPLE_SANITIZE)
constexpr bool sanitized = true;
#else
constexpr bool sanitized = false;
#endif

}  // namespace crumple

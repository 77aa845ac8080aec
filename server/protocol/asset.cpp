#include "protocol/asset.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <cstdio>

namespace crumple {

std::string hash_of(const void* bytes, size_t size) {
  char digits[17];
  std::snprintf(digits, sizeof digits, "%016llx", static_cast<unsigned long long>(XXH64(bytes, size, 0)));
  return digits;
}

}  // namespace crumple

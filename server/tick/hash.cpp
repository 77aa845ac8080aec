// Hashes everything that the next tick depends on: two runs are equal if their hashes are. Large parts (bodies, surfaces) are
// hashed when they change, by the worker that changed them.
#define XXH_INLINE_ALL
#include "tick/hash.h"

#include <xxhash.h>

#include <cstring>

#include "tick/fields.h"

namespace crumple {
namespace {

// XXH64 of all fields. A field has few bytes and a world of 1,000 cars has 100,000 fields, so bytes are gathered first.
class Sum {
 public:
  static constexpr bool reads = false, sums = true;
  Sum() { XXH64_reset(&state_, 0); }
  void raw(const void* data, size_t size) {
    if (size == 0) return;  // an empty list may have no address
    if (size > sizeof gathered_ - used_) {
      flush();
      if (size > sizeof gathered_) {
        XXH64_update(&state_, data, size);
        return;
      }
    }
    std::memcpy(gathered_ + used_, data, size);
    used_ += size;
  }
  template <class List>
  void resize(const List& list) {
    const uint64_t size = list.size();
    raw(&size, sizeof size);
  }
  uint64_t value() {
    flush();
    return XXH64_digest(&state_);
  }

 private:
  void flush() {
    XXH64_update(&state_, gathered_, used_);
    used_ = 0;
  }

  XXH64_state_t state_;
  std::byte gathered_[4096];
  size_t used_ = 0;
};

}  // namespace

uint64_t hash(const World& world) {
  Sum sum;
  field(sum, world.rate, world.quantum);
  field(sum, world);
  for (const Levels& levels : world.uploaded) {
    field(sum, levels.front()->hash);
  }
  for (const auto& [id, car] : world.cars) {
    field(sum, id, car.levels->front()->hash, car.car->hash);
    field(sum, car);
  }
  return sum.value();
}

}  // namespace crumple

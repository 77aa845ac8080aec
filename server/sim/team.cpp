#include "sim/team.h"

#include <tbb/task_arena.h>

#include <algorithm>
#include <thread>

namespace crumple {
namespace {

constexpr int most_helpers = 7, most_delays = 2, gathers_alone = 60;

// Waits for other threads. Most pieces end within a microsecond or two; a longer wait is for a thread that is not running.
class Wait {
 public:
  void once() {
    if (++times_ > 500) return std::this_thread::yield();
#ifdef __x86_64__
    __builtin_ia32_pause();
#endif
  }
  void again() { times_ = 0; }
  bool long_one() const { return times_ > 2000; }

 private:
  int times_ = 0;
};

}  // namespace

void Team::gather() {
  if (gathered_) return;
  const int helpers = std::min(most_helpers, tbb::this_task_arena::max_concurrency() - 1);
  delays_ = 0;
  if (alone_ > 0) --alone_;
  if (helpers < 1 || alone_ > 0) return;
  gathered_ = true;
  open_.store(true, std::memory_order_release);
  for (int i = 0; i < helpers; ++i) helpers_.run([this] { help(); });
}

void Team::leave() {
  if (!gathered_) return;
  open_.store(false, std::memory_order_release);
  helpers_.wait();
  gathered_ = false;
}

void Team::share(uint64_t pieces) {
  done_.store(0, std::memory_order_relaxed);
  ticket_.store(++phase_ << (2 * bits) | pieces << bits, std::memory_order_release);
  while (take()) {
  }
  Wait wait;
  while (done_.load(std::memory_order_acquire) < pieces) wait.once();
  if (wait.long_one() && ++delays_ == most_delays) {
    alone_ = gathers_alone;
    open_.store(false, std::memory_order_release);
  }
}

bool Team::take() {
  uint64_t ticket = ticket_.load(std::memory_order_acquire);
  if (next(ticket) >= count(ticket)) return false;
  ticket = ticket_.fetch_add(1, std::memory_order_acq_rel);
  if (next(ticket) >= count(ticket)) return false;
  const uint32_t begin = first_ + uint32_t(next(ticket)) * piece_;
  work_(context_, begin, std::min(last_, begin + piece_));
  done_.fetch_add(1, std::memory_order_release);
  return true;
}

void Team::help() {
  Wait wait;
  while (open_.load(std::memory_order_acquire)) {
    if (take()) {
      wait.again();
    } else {
      wait.once();
    }
  }
}

}  // namespace crumple

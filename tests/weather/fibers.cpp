#include "fibers.h"

#include <sys/mman.h>
#include <ucontext.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <queue>
#include <random>
#include <utility>
#include <vector>

namespace crumple::weather {

struct Fiber {
  ucontext_t context;
  void* stack = nullptr;
  std::function<void()> body;
  uint64_t turn = 0;  // counts its waits, so that a wake-up for an earlier wait has no effect
  bool waiting = false, ended = false;
  Time frozen_until = 0;
};

namespace {

constexpr size_t stack_size = size_t{1} << 20;  // bytes: many times as much as a tick needs, because it never recurses

struct Due {
  Time time;
  uint64_t number;  // actions due at the same time run in the order of their requests
  std::function<void()> action;
  bool operator<(const Due& other) const { return std::pair(time, number) > std::pair(other.time, other.number); }
};

Time present = 0;
uint64_t numbers = 0;
std::priority_queue<Due> due;
Fiber* current = nullptr;
ucontext_t schedule;
std::vector<void*> stacks;  // free stacks
std::mt19937_64 machine;

void* take_stack() {
  if (!stacks.empty()) {
    void* stack = stacks.back();
    stacks.pop_back();
    return stack;
  }
  void* stack = mmap(nullptr, stack_size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (stack == MAP_FAILED || mprotect(stack, 4096, PROT_NONE) != 0) std::abort();
  return stack;
}

void enter() {
  current->body();
  current->ended = true;
  swapcontext(&current->context, &schedule);
}

void resume(Fiber* fiber, uint64_t turn) {
  if (fiber->ended || !fiber->waiting || fiber->turn != turn) return;
  if (present < fiber->frozen_until) return at(fiber->frozen_until, [=] { resume(fiber, turn); });
  fiber->waiting = false;
  current = fiber;
  swapcontext(&schedule, &fiber->context);
  current = nullptr;
}

}  // namespace

Time now() { return present; }

void begin(uint64_t seed) {
  present = 0;
  numbers = 0;
  due = {};
  machine.seed(seed);
}

void at(Time time, std::function<void()> action) { due.push({std::max(time, present), ++numbers, std::move(action)}); }

void run_until(Time end) {
  while (!due.empty() && due.top().time <= end) {
    present = due.top().time;
    const auto action = std::move(const_cast<Due&>(due.top()).action);
    due.pop();
    action();
  }
  present = end;
}

Fiber* start(std::function<void()> body) {
  auto* fiber = new Fiber;
  fiber->body = std::move(body);
  fiber->stack = take_stack();
  getcontext(&fiber->context);
  fiber->context.uc_stack.ss_sp = fiber->stack;
  fiber->context.uc_stack.ss_size = stack_size;
  fiber->context.uc_link = nullptr;
  makecontext(&fiber->context, enter, 0);
  fiber->waiting = true;
  at(present, [fiber] { resume(fiber, 0); });
  return fiber;
}

Fiber* running() { return current; }
bool has_ended(const Fiber* fiber) { return fiber->ended; }

void release(Fiber* fiber) {
  stacks.push_back(fiber->stack);
  delete fiber;
}

void wait_until(Time time) {
  Fiber* fiber = current;
  fiber->waiting = true;
  const uint64_t turn = ++fiber->turn;
  at(time, [=] { resume(fiber, turn); });
  swapcontext(&fiber->context, &schedule);
}

void wake(Fiber* fiber) {
  if (fiber && fiber->waiting && !fiber->ended) at(present, [fiber, turn = fiber->turn] { resume(fiber, turn); });
}

void freeze(Fiber* fiber, Time until) { fiber->frozen_until = std::max(fiber->frozen_until, until); }

}  // namespace crumple::weather

// These replace the functions of the C and C++ libraries, because the linker prefers the program's own definitions.

using crumple::weather::now;

namespace std::chrono {
inline namespace _V2 {
constexpr int64_t boot = 1'000 * crumple::weather::second, epoch = 1'800'000'000 * crumple::weather::second;
steady_clock::time_point steady_clock::now() noexcept { return time_point(duration(boot + crumple::weather::now())); }
system_clock::time_point system_clock::now() noexcept { return time_point(duration(epoch + crumple::weather::now())); }
}  // namespace _V2
}  // namespace std::chrono

std::random_device::result_type std::random_device::_M_getval() {
  return static_cast<result_type>(crumple::weather::machine());
}

extern "C" int nanosleep(const timespec* wanted, timespec*) {
  crumple::weather::wait_until(now() + wanted->tv_sec * crumple::weather::second + wanted->tv_nsec);
  return 0;
}

extern "C" int isatty(int) { return 0; }

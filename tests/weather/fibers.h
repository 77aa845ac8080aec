// Simulated time, and actors that take turns on one thread: each runs until it waits, and what comes next follows from the
// times alone. The program's clocks, its sleep and its random numbers of the machine are replaced by these.
#pragma once

#include <cstdint>
#include <functional>

namespace crumple::weather {

using Time = int64_t;  // ns since the schedule began
inline constexpr Time millisecond = 1'000'000, second = 1000 * millisecond;

struct Fiber;

Time now();
// Begins anew at 0; what the machine's random numbers are from now on. No fiber may live.
void begin(uint64_t seed);
void at(Time, std::function<void()>);
// Does what is due until then.
void run_until(Time);

Fiber* start(std::function<void()>);
Fiber* running();  // null: the schedule itself
bool has_ended(const Fiber*);
void release(Fiber*);  // once it has ended
// Of the one that runs: until it is woken, or then.
void wait_until(Time);
void wake(Fiber*);
// It does not run before then.
void freeze(Fiber*, Time until);

}  // namespace crumple::weather

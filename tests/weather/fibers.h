// Simulated time, and actors that take turns on one thread. Each actor runs until it waits; the due times alone determine which
// runs next. These functions replace the program's clocks, its sleep, and its random numbers from the machine.
#pragma once

#include <cstdint>
#include <functional>

namespace crumple::weather {

using Time = int64_t;  // ns since the schedule began
inline constexpr Time millisecond = 1'000'000, second = 1000 * millisecond;

struct Fiber;

Time now();
// Starts again at time 0, with this seed for the machine's random numbers. No fiber may be alive.
void begin(uint64_t seed);
void at(Time, std::function<void()>);
// Runs all actions that are due until this time.
void run_until(Time);

Fiber* start(std::function<void()>);
Fiber* running();  // null: the schedule itself is running
bool has_ended(const Fiber*);
void release(Fiber*);  // only after it has ended
// Blocks the running fiber until another wakes it, or until this time.
void wait_until(Time);
void wake(Fiber*);
// The fiber does not run before this time.
void freeze(Fiber*, Time until);

}  // namespace crumple::weather

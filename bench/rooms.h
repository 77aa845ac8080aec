// Shared by the benchmarks: the measured car, two clocks, and the number of threads. A benchmark has the name ROOM/CAR or
// ROOM/CAR/THREADS; bench/tables.py reads these names. The times exclude the preparation between two runs. Rooms of the loop on
// one thread are measured in processor time of that thread, so that other work on the machine hardly matters; all others in
// wall time.
#pragma once

#include <benchmark/benchmark.h>
#include <tbb/task_arena.h>
#include <time.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <functional>
#include <string>
#include <thread>

#include "car/car.h"

namespace crumple {

// One car file. Its name SURFACE-NODES.car chooses the row of the tables.
struct Bench {
  std::filesystem::path file;
  std::string name;  // the file's name without .car
  std::shared_ptr<const Car> car;
};

// Measured while baking: reading, constraints, skin, the whole assembly, and loading the result.
void register_bake(const std::shared_ptr<const Bench>&);
// Measured in a tick: contacts, solvers, flow, surface, the loop of the thesis, the messages.
void register_loop(const std::shared_ptr<const Bench>&);

// As many cars side by side as the machine has cores, but at most six as in the thesis's table.
inline int all_threads() { return std::clamp(int(std::thread::hardware_concurrency()), 1, 6); }

inline double wall_seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

inline double thread_seconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return double(now.tv_sec) + 1e-9 * double(now.tv_nsec);
}

inline double seconds_of(const std::function<void()>& work, double (*clock)() = wall_seconds) {
  const double start = clock();
  work();
  return clock() - start;
}

// body: measures each iteration itself and reports it by SetIterationTime.
inline benchmark::internal::Benchmark* register_room(const std::string& name,
                                                     const std::function<void(benchmark::State&)>& body) {
  return benchmark::RegisterBenchmark(name.c_str(), body)->UseManualTime()->Unit(benchmark::kMillisecond);
}

}  // namespace crumple

#include <algorithm>
#include <atomic>
#include <chrono>
#include <crumple.hpp>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <stdexcept>

#include "load.h"

namespace crumple::load {
namespace {

std::atomic<bool> ended{false};

constexpr uint64_t nothing = UINT64_MAX;  // no tick

struct Seen {
  uint64_t ns;
  size_t car;
  uint64_t tick;
};

}  // namespace

uint64_t wall_ns() {
  return uint64_t(
      std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::system_clock::now().time_since_epoch()).count());
}

int view(const ViewerTask& task) {
  std::signal(SIGTERM, [](int) { ended = true; });
  const uint64_t begun = wall_ns();
  client::Session session({task.endpoint, scene, "", "", patience});
  if (task.level == 1) session.follow_all(1);
  for (const std::string& car : task.cars) session.follow(car, task.level);

  std::vector<Seen> seen;
  std::vector<std::pair<uint64_t, uint64_t>> bytes;
  std::vector<uint64_t> newest(task.cars.size(), nothing);
  uint64_t whole = 0, next = begun + 1'000'000'000;
  while (!ended) {
    session.poll(std::chrono::milliseconds(100));
    const uint64_t now = wall_ns();
    for (size_t i = 0; i < task.cars.size(); ++i) {
      const auto surface = session.surface(task.cars[i]);
      if (!surface) {
        newest[i] = nothing;
      } else if (surface->tick != newest[i]) {
        newest[i] = surface->tick;
        seen.push_back({now, i, surface->tick});
      }
    }
    if (whole == 0 && std::count(newest.begin(), newest.end(), nothing) == 0) whole = now;
    if (now < next) continue;
    next += 1'000'000'000;
    bytes.emplace_back(now, session.statistics().received_bytes);
  }
  std::FILE* file = std::fopen(task.file.c_str(), "w");
  if (!file) throw std::runtime_error(task.file + ": cannot be written");
  const auto number = [](uint64_t n) { return static_cast<unsigned long long>(n); };
  std::fprintf(file, "open,%llu,%.1f\n", number(begun), whole ? 1e-6 * double(whole - begun) : -1.0);
  for (const auto& [ns, sum] : bytes) std::fprintf(file, "bytes,%llu,%llu\n", number(ns), number(sum));
  for (const Seen& one : seen)
    std::fprintf(file, "held,%llu,%s,%llu\n", number(one.ns), task.cars[one.car].c_str(), number(one.tick));
  for (const std::string& car : task.cars) {
    if (const auto surface = session.surface(car))
      std::fprintf(file, "end,%s,%llu,%016llx\n", car.c_str(), number(surface->tick), number(surface->hash));
  }
  const CrumpleStatistics statistics = session.statistics();
  std::fprintf(file, "counts,%llu,%llu,%llu\n", number(statistics.asked), number(statistics.older), number(statistics.refused));
  return std::fclose(file) == 0 ? 0 : 1;
}

}  // namespace crumple::load

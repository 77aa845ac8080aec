#include "tick/health.h"

#include <algorithm>
#include <cmath>

#include "tick/state.h"
#include "wire/encode.h"

namespace crumple {
namespace {

constexpr double told_seconds = 10;  // s: ten health messages list a change, and any of them shows a viewer that it missed it
constexpr size_t told_most = 500;    // most cars in one health message, the latest ones, so that it fits one batch

uint64_t last(const HealthReport::CarTold& told) { return *std::max_element(told.ticks.begin(), told.ticks.end()); }

// Cars whose viewers received something lately.
std::vector<HealthReport::CarTold> told_lately(const World& world) {
  std::vector<HealthReport::CarTold> out;
  for (const auto& [id, car] : world.cars) {
    HealthReport::CarTold told{id, {}};
    for (const ViewerState& level : car.told) told.ticks.push_back(level.tick);
    if (last(told) > 0 && double(world.tick - last(told)) <= told_seconds * world.rate) out.push_back(std::move(told));
  }
  if (out.size() <= told_most) return out;
  std::stable_sort(out.begin(), out.end(), [](const auto& a, const auto& b) { return last(a) > last(b); });
  out.resize(told_most);
  return out;
}

uint64_t nanometres(double metres) { return uint64_t(std::llround(1e9 * std::min(metres, 1e9))); }

}  // namespace

void count(World& world, const Refusal& refusal, uint64_t times) {
  world.tally.refusals[size_t(refusal.reason)] += times;
  world.tally.last_refusal = refusal.sentence;
}

uint64_t refusal_count(const World& world) {
  uint64_t sum = 0;
  for (uint64_t of_reason : world.tally.refusals) sum += of_reason;
  return sum;
}

const std::string& last_refusal(const World& world) { return world.tally.last_refusal; }

Message health(World& world, uint64_t late, const std::vector<MoreCount>& more_counts) {
  Tally& tally = world.tally;
  const Limits& limits = world.limits;
  HealthReport report;
  report.tick = world.tick;
  report.rate = world.rate;
  report.late = late;
  if (world.clock && tally.ticks > 0) {
    for (size_t i = 0; i < stage_names.size(); ++i) {
      report.rooms.push_back({stage_names[i], tally.sum[i] / double(tally.ticks), tally.worst[i]});
    }
  }
  report.counts = {
      {"cars", world.cars.size(), limits.cars},
      {"hosts", world.hosts.size(), limits.hosts},
      {"obstacles", world.obstacles.size(), uint64_t(limits.hosts) * limits.obstacles_per_host},
      {"messages", tally.messages, 0},
      {"contacts_per_node_overflows", tally.contact_overflows, 0},
      {"recoveries", tally.recoveries, 0},
      {"work_most", tally.most_work, world.budget},
      {"work_shed", tally.work_shed, 0},
      {"islands", tally.most_islands, 0},
      {"largest_island", tally.largest_island, 0},
      {"residual_mean_nm", nanometres(tally.solved > 0 ? tally.residual_sum / double(tally.solved) : 0), 0},
      {"residual_worst_nm", nanometres(tally.residual_worst), 0},
  };
  for (const auto& [name, value, limit] : more_counts) report.counts.push_back({name, value, limit});
  for (size_t i = 0; i < reason_count; ++i) report.refusals.push_back({reason_names[i], tally.refusals[i], 0});
  report.told = told_lately(world);
  tally.ticks = tally.solved = tally.most_work = tally.most_islands = tally.largest_island = 0;
  tally.residual_sum = tally.residual_worst = 0;
  tally.sum = tally.worst = {};
  return {"health", encode_health(report)};
}

}  // namespace crumple

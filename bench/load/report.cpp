// Reports the results of a run. It reads the server's side from the recording, where each message has the time at which its
// tick was done, and the viewers' side from the files that they wrote. Both sides use the clock of one machine.
#include <algorithm>
#include <cstdio>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>

#include "load.h"
#include "machine.h"
#include "recording/recording.h"
#include "schema/message_generated.h"

namespace crumple::load {
namespace {

constexpr uint64_t cut_margin_ns = 3'000'000'000;
constexpr double current = 100;  // ms: a surface counts as current until it has been superseded for this long

// Writes JSON with one field per line.
class Json {
 public:
  explicit Json(const std::string& path) : path_(path), file_(path) { file_ << "{"; }
  void text(const std::string& name, const std::string& value) { raw(name, "\"" + value + "\""); }
  void number(const std::string& name, double value) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%.6g", value);
    raw(name, digits);
  }
  template <class Rows>
  void rows(const std::string& name, const Rows& rows) {  // lists of numbers
    std::ostringstream out;
    out << "[";
    for (size_t i = 0; i < rows.size(); ++i) {
      out << (i ? ",[" : "[");
      for (size_t k = 0; k < rows[i].size(); ++k) out << (k ? "," : "") << rows[i][k];
      out << "]";
    }
    raw(name, out.str() + "]");
  }
  void close() {
    file_ << "\n}\n";
    if (!file_.flush()) throw std::runtime_error(path_ + ": cannot be written");
  }

 private:
  void raw(const std::string& name, const std::string& value) {
    file_ << (first_ ? "\n" : ",\n") << "\"" << name << "\": " << value;
    first_ = false;
  }
  std::string path_;
  std::ofstream file_;
  bool first_ = true;
};

// Quantile of a sorted list; 0 for an empty list.
double quantile(const std::vector<double>& sorted, double share) {
  if (sorted.empty()) return 0;
  return sorted[std::min(sorted.size() - 1, size_t(share * double(sorted.size())))];
}

struct Health {
  uint64_t ns;
  std::map<std::string, std::pair<double, double>> rooms;  // mean, worst, ms
  std::map<std::string, uint64_t> counts;
  uint64_t late, refusals;
};

struct Served {
  std::map<uint64_t, uint64_t> tick_ns;               // tick -> time at which it was done
  std::map<std::string, std::vector<uint64_t>> told;  // car -> ticks in which its near surface was sent
  uint64_t frames[2] = {}, bytes[2] = {};             // surfaces and their bytes by level, during the load
  std::vector<Health> health;                         // during the load
  size_t vertices = 0;
  uint64_t late_before = 0;
  uint64_t reactions = 0, with_partners = 0, of_other_hosts = 0, most_partners = 0;  // during the load
};

void count_partners(const RecordingReader::Item& item, Served& out) {
  const std::string_view host = std::string_view(item.key).substr(5, item.key.find('/', 5) - 5);  // of host/ID/reactions
  for (const auto* reaction : *flatbuffers::GetRoot<schema::Reactions>(item.bytes.data())->cars()) {
    ++out.reactions;
    if (!reaction->partners()) continue;
    ++out.with_partners;
    out.most_partners = std::max<uint64_t>(out.most_partners, reaction->partners()->size());
    const auto is_foreign = [&](const schema::Partner* each) { return each->host()->string_view() != host; };
    out.of_other_hosts += std::any_of(reaction->partners()->begin(), reaction->partners()->end(), is_foreign);
  }
}

Served read_recording(const Run& run) {
  Served out;
  RecordingReader reader(run.recording);
  out.vertices = reader.head().cars.front()->model.vertex.size();
  RecordingReader::Item item;
  std::map<std::string, std::vector<uint64_t>> told[2];
  while (reader.next(item)) {
    const bool during = item.time_ns >= run.begin_ns && item.time_ns < run.end_ns;
    if (during && item.channel == Channel::reactions) count_partners(item, out);
    if (item.channel == Channel::tick_end) out.tick_ns[item.tick] = item.time_ns;
    if (item.channel == Channel::keyframe || item.channel == Channel::delta) {
      const std::string car(item.key.substr(4, item.key.find('/', 4) - 4));
      const size_t level = item.level;
      auto& ticks = told[level][car];
      const bool frame = ticks.empty() || ticks.back() != item.tick;
      if (during && car.front() == 'c') {
        out.frames[level] += frame;
        out.bytes[level] += item.bytes.size();
      }
      if (frame) ticks.push_back(item.tick);
    }
    if (item.channel != Channel::health) continue;
    const auto* message = flatbuffers::GetRoot<schema::Health>(item.bytes.data());
    if (!during) {
      if (out.health.empty()) out.late_before = message->late();
      continue;
    }
    Health& health = out.health.emplace_back();
    health.ns = item.time_ns;
    health.late = message->late();
    for (const auto* room : *message->rooms())
      health.rooms[room->name()->str()] = {double(room->milliseconds()), double(room->worst())};
    for (const auto* count : *message->counts()) health.counts[count->name()->str()] = count->value();
    health.refusals = 0;
    for (const auto* count : *message->refusals()) health.refusals += count->value();
  }
  out.told = std::move(told[0]);
  if (out.health.empty()) throw std::runtime_error(run.recording + ": has no health: the server was too busy to say how it is");
  return out;
}

struct Held {
  uint64_t ns, tick;
};

struct Seen {
  double open_ms = -1;
  std::vector<std::pair<uint64_t, uint64_t>> bytes;
  std::map<std::string, std::vector<Held>> held;
  std::map<std::string, std::string> end;
  uint64_t asked = 0;
};

Seen read_viewer(const std::string& path) {
  Seen out;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    std::vector<std::string> fields;
    std::istringstream rest(line);
    for (std::string field; std::getline(rest, field, ',');) fields.push_back(field);
    if (fields[0] == "open") out.open_ms = std::stod(fields.at(2));
    if (fields[0] == "bytes") out.bytes.emplace_back(std::stoull(fields.at(1)), std::stoull(fields.at(2)));
    if (fields[0] == "held") out.held[fields.at(2)].push_back({std::stoull(fields.at(1)), std::stoull(fields.at(3))});
    if (fields[0] == "end") out.end[fields.at(1)] = fields.at(3);
    if (fields[0] == "counts") out.asked = std::stoull(fields.at(1));
  }
  if (out.open_ms == -1 && out.end.empty()) throw std::runtime_error(path + ": the viewer wrote nothing");
  return out;
}

// For each surface that a viewer showed: how long it had been superseded, ms; 0: it was the newest.
std::vector<std::pair<uint64_t, double>> superseded(const Seen& viewer, const Served& served, uint64_t from, uint64_t to) {
  std::vector<std::pair<uint64_t, double>> out;  // when, how long
  for (const auto& [car, list] : viewer.held) {
    const auto told = served.told.find(car);
    if (told == served.told.end()) continue;
    for (const Held& held : list) {
      if (held.ns < from || held.ns >= to) continue;
      const auto next = std::upper_bound(told->second.begin(), told->second.end(), held.tick);
      const auto made = next == told->second.end() ? served.tick_ns.end() : served.tick_ns.find(*next);
      const double age = made == served.tick_ns.end() ? 0 : 1e-6 * (double(held.ns) - double(made->second));
      out.emplace_back(held.ns, std::max(0.0, age));
    }
  }
  return out;
}

// The times from the end of a tick that changed a car until the viewer held this surface or a newer one. missing: counts
// surfaces that never came.
void latencies(const Seen& viewer, const ViewerRun& run, const Served& served, uint64_t from, uint64_t to,
               std::vector<double>& out, uint64_t& missing) {
  for (const std::string& car : run.cars) {
    const auto told = served.told.find(car);
    const auto seen = viewer.held.find(car);
    if (told == served.told.end()) continue;
    size_t at = 0;
    for (uint64_t tick : told->second) {
      const auto made = served.tick_ns.find(tick);
      if (made == served.tick_ns.end() || made->second < from || made->second >= to) continue;
      if (seen != viewer.held.end())
        while (at < seen->second.size() && seen->second[at].tick < tick) ++at;
      if (seen == viewer.held.end() || at == seen->second.size()) {
        ++missing;
      } else {
        out.push_back(1e-6 * (double(seen->second[at].ns) - double(made->second)));
      }
    }
  }
}

// The time from the return of the link until the viewer holds, for each car, the last surface that was sent before.
double back_after(const Seen& viewer, const ViewerRun& run, const Served& served, uint64_t back_ns) {
  double worst = 0;
  for (const std::string& car : run.cars) {
    const auto told = served.told.find(car);
    const auto seen = viewer.held.find(car);
    if (told == served.told.end() || seen == viewer.held.end()) continue;
    const auto before = std::find_if(told->second.rbegin(), told->second.rend(), [&](uint64_t tick) {
      const auto made = served.tick_ns.find(tick);
      return made != served.tick_ns.end() && made->second < back_ns;
    });
    const auto held = std::find_if(seen->second.begin(), seen->second.end(),
                                   [&](const Held& one) { return before != told->second.rend() && one.tick >= *before; });
    if (held != seen->second.end() && held->ns > back_ns) worst = std::max(worst, 1e-6 * double(held->ns - back_ns));
  }
  return worst;
}

// Slope by least squares, bytes per second.
double slope(const std::vector<Sample>& samples) {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0;
  for (size_t i = samples.size() / 4; i < samples.size(); ++i) {  // without the first quarter, which warms up
    const double t = 1e-9 * double(samples[i].ns - samples.front().ns), m = double(samples[i].memory);
    n += 1, x += t, y += m, xx += t * t, xy += t * m;
  }
  const double spread = n * xx - x * x;
  return spread > 0 ? (n * xy - x * y) / spread : 0;
}

struct Viewers {
  std::vector<double> latency;  // of steady viewers, ms, sorted
  uint64_t missing = 0, diverged = 0, compared = 0;
  double mean_mbits[2] = {},
         worst_mbits[2] = {};        // by surface level: rate of the busiest steady viewer, mean and in its busiest second
  double open_ms = 0, late_ms = 0;   // worst
  double back_ms = 0;                // worst time from the return of a cut link until all missed surfaces are there
  uint64_t asked = 0;                // keyframes
  double stale_ms = 0, thaw_ms = 0;  // worst of frozen viewers: age of the shown surface, time until it was current
};

Viewers put_together(const Run& run, const Served& served) {
  Viewers out;
  for (const ViewerRun& viewer : run.viewers) {
    if (!std::ifstream(viewer.file)) continue;  // killed
    const Seen seen = read_viewer(viewer.file);
    const bool is_far = viewer.part == "far";
    for (const std::string& car : viewer.cars) {
      ++out.compared;
      const auto end = seen.end.find(car);
      out.diverged += end == seen.end.end() || end->second != run.truth[is_far].at(car);
    }
    if (viewer.part == "late") out.late_ms = std::max(out.late_ms, seen.open_ms < 0 ? 1e9 : seen.open_ms);
    if (viewer.part == "steady") {
      // Surfaces from the time of a cut, or from just before it, arrive after the link has returned.
      latencies(seen, viewer, served, run.begin_ns, run.cut_ns > 0 ? run.cut_ns - cut_margin_ns : run.end_ns, out.latency,
                out.missing);
      if (run.back_ns > 0) out.back_ms = std::max(out.back_ms, back_after(seen, viewer, served, run.back_ns));
      out.asked += seen.asked;
      out.open_ms = std::max(out.open_ms, seen.open_ms);
    }
    if (viewer.part == "steady" || is_far) {
      const std::pair<uint64_t, uint64_t>* first = nullptr;
      for (size_t i = 1; i < seen.bytes.size(); ++i) {
        const auto& [ns, bytes] = seen.bytes[i];
        if (ns < run.begin_ns || ns > run.end_ns) continue;
        if (!first) first = &seen.bytes[i - 1];
        const auto mbits = [&ns = ns, &bytes = bytes](const auto& since) {
          return 8e3 * double(bytes - since.second) / double(ns - since.first);
        };
        out.worst_mbits[is_far] = std::max(out.worst_mbits[is_far], mbits(seen.bytes[i - 1]));
        if (i + 1 == seen.bytes.size() || seen.bytes[i + 1].first > run.end_ns)
          out.mean_mbits[is_far] = std::max(out.mean_mbits[is_far], mbits(*first));
      }
    }
    if (viewer.thawed_ns > 0) {
      uint64_t until = UINT64_MAX;
      for (const auto& [ns, age] : superseded(seen, served, viewer.thawed_ns, run.end_ns)) {
        out.stale_ms = std::max(out.stale_ms, age);
        if (age < current) until = std::min(until, ns);
      }
      if (until != UINT64_MAX) out.thaw_ms = std::max(out.thaw_ms, 1e-6 * double(until - viewer.thawed_ns));
    }
  }
  std::sort(out.latency.begin(), out.latency.end());
  return out;
}

}  // namespace

int report(const Options& options, const Run& run) {
  const Served served = read_recording(run);
  const Viewers viewers = put_together(run, served);
  std::vector<double> intervals;  // ms
  for (auto at = served.tick_ns.begin(), before = at++; at != served.tick_ns.end(); before = at++)
    if (before->second >= run.begin_ns && at->second < run.end_ns)
      intervals.push_back(1e-6 * double(at->second - before->second));
  std::sort(intervals.begin(), intervals.end());
  const double seconds = 1e-9 * double(run.end_ns - run.begin_ns);
  const Sample &first = run.samples.front(), &last = run.samples.back();
  const auto [fewest, most] =
      std::minmax_element(run.samples.begin() + std::ptrdiff_t(run.samples.size() / 4), run.samples.end(),
                          [](const Sample& a, const Sample& b) { return a.descriptors < b.descriptors; });
  const Health& end = served.health.back();
  const auto count = [&](const char* name) { return end.counts.count(name) ? end.counts.at(name) : 0; };
  double worst_tick = 0, residual = 0;
  uint64_t islands = 0, largest_island = 0;
  for (const Health& health : served.health) {
    worst_tick = std::max(worst_tick, health.rooms.count("tick") ? health.rooms.at("tick").second : 0.0);
    const auto raise = [&](const char* name, uint64_t& value) {
      if (const auto found = health.counts.find(name); found != health.counts.end()) value = std::max(value, found->second);
    };
    raise("islands", islands);
    raise("largest_island", largest_island);
    residual =
        std::max(residual, health.counts.count("residual_worst_nm") ? 1e-6 * double(health.counts.at("residual_worst_nm")) : 0);
  }
  const double shed_share = double(count("work_shed"));

  Json json(options.folder + "/load.json");
  json.text("machine", machine());
  json.number("seconds", seconds);
  json.number("hosts", options.hosts);
  json.number("asleep", options.asleep);
  json.number("driving", options.driving);
  json.number("crashing", options.crashing);
  json.number("meeting", meeting_of(options).cars);
  json.number("pile", meeting_of(options).pile);
  json.number("islands", double(islands));
  json.number("largest_island", double(largest_island));
  json.number("reactions", double(served.reactions));
  json.number("reactions_with_partners", double(served.with_partners));
  json.number("reactions_of_other_hosts", double(served.of_other_hosts));
  json.number("partners_most", double(served.most_partners));
  json.number("viewers", options.viewers);
  json.number("follow", options.follow);
  json.text("serve", options.serve);
  json.number("importance", options.importance);
  json.number("ticks", double(intervals.size()));
  json.number("late", double(end.late - served.late_before));
  json.number("worst_tick_ms", worst_tick);
  for (const auto& [name, share] : {std::pair{"p50", 0.5}, {"p99", 0.99}, {"p99.9", 0.999}, {"most", 1.0}}) {
    json.number(std::string("interval_ms_") + name, quantile(intervals, share));
    json.number(std::string("latency_ms_") + name, quantile(viewers.latency, share));
  }
  json.number("surfaces", double(viewers.latency.size()));
  json.number("surfaces_missing", double(viewers.missing));
  for (size_t level : {0, 1}) {
    const std::string far_one = level == 1 ? "far_" : "";
    const double bits =
        8 * double(served.bytes[level]) / (double(std::max<uint64_t>(1, served.frames[level])) * double(served.vertices));
    json.number(far_one + "bits_per_vertex_frame", bits);
    json.number(far_one + "viewer_mbits_mean", viewers.mean_mbits[level]);
    json.number(far_one + "viewer_mbits_worst", viewers.worst_mbits[level]);
  }
  json.number("open_ms_worst", viewers.open_ms);
  json.number("late_join_ms_worst", viewers.late_ms);
  const Weather& weather = options.weather;
  json.text("link", !options.impaired() ? "" : options.udp ? "udp" : "tcp");
  json.number("delay_ms", weather.delay);
  json.number("jitter_ms", weather.jitter);
  json.number("loss", weather.loss);
  json.number("reorder", weather.reorder);
  json.number("kbit", weather.kbit);
  json.number("cut_s", options.cut);
  json.number("back_ms_worst", viewers.back_ms);
  json.number("keyframes_asked", double(viewers.asked));
  json.number("packets", double(run.packets.passed));
  json.number("packets_lost", double(run.packets.lost));
  json.number("connections", double(run.packets.connections));
  json.number("thawed_stale_ms_worst", viewers.stale_ms);
  json.number("thawed_current_after_ms", viewers.thaw_ms);
  json.number("diverged", double(viewers.diverged));
  json.number("compared", double(viewers.compared));
  json.number("cpu_cores", (last.cpu - first.cpu) / seconds);
  json.number("recorder_cores", (last.recorder_cpu - first.recorder_cpu) / seconds);
  json.number("memory_mb", 1e-6 * double(last.memory));
  json.number("memory_slope_mb_per_hour", 3600e-6 * slope(run.samples));
  json.number("descriptors_fewest", fewest->descriptors);
  json.number("descriptors_most", most->descriptors);
  json.number("work_shed", shed_share);
  json.number("residual_worst_mm", residual);
  json.number("refusals", double(end.refusals));
  json.number("sent_dropped", double(count("sent_dropped")));
  json.number("received_dropped", double(count("received_dropped")));
  json.number("recording_lost", double(count("recording_lost")));
  std::vector<std::vector<double>> rows, rooms, points;
  for (const Sample& each : run.samples)
    rows.push_back(
        {1e-9 * double(each.ns - run.begin_ns), each.cpu - first.cpu, 1e-6 * double(each.memory), double(each.descriptors)});
  for (const Health& health : served.health) {
    auto& row =
        rooms.emplace_back(std::vector{1e-9 * double(health.ns - run.begin_ns), double(health.late - served.late_before)});
    for (const char* name : {"decode", "contacts", "solve", "flow", "surface", "tick"})
      row.push_back(health.rooms.count(name) ? health.rooms.at(name).first : 0.0);
    row.push_back(health.rooms.count("tick") ? health.rooms.at("tick").second : 0.0);
  }
  for (int k = 0; k <= 1000; ++k)
    points.push_back({0.001 * k, quantile(intervals, 0.001 * k), quantile(viewers.latency, 0.001 * k)});
  json.rows("samples", rows);      // s, CPU s, MB, descriptors
  json.rows("rooms", rooms);       // s, late, mean ms of each room, worst tick
  json.rows("quantiles", points);  // share, interval ms, latency ms
  json.close();

  std::printf("ticks %zu, late %llu, longest %.1f ms; interval p99 %.1f, p99.9 %.1f, most %.1f ms\n", intervals.size(),
              static_cast<unsigned long long>(end.late - served.late_before), worst_tick, quantile(intervals, 0.99),
              quantile(intervals, 0.999), quantile(intervals, 1));
  std::printf("surfaces %zu, %llu never came; after the tick p50 %.2f, p99 %.2f, p99.9 %.2f ms\n", viewers.latency.size(),
              static_cast<unsigned long long>(viewers.missing), quantile(viewers.latency, 0.5), quantile(viewers.latency, 0.99),
              quantile(viewers.latency, 0.999));
  std::printf("viewer: %.2f Mb/s, %.2f in its busiest second; first surfaces after %.0f ms, of late ones %.0f ms\n",
              viewers.mean_mbits[0], viewers.worst_mbits[0], viewers.open_ms, viewers.late_ms);
  if (meeting_of(options).cars > 0) {
    const auto number = [](uint64_t value) { return static_cast<unsigned long long>(value); };
    std::printf(
        "islands of several cars: %llu in one tick, of up to %llu cars; reactions %llu, %llu with partners (up to %llu), %llu "
        "of "
        "these with cars of other hosts\n",
        number(islands), number(largest_island), number(served.reactions), number(served.with_partners),
        number(served.most_partners), number(served.of_other_hosts));
  }
  if (options.far > 0)
    std::printf("far viewer of all %u cars: %.2f Mb/s, %.2f in its busiest second\n", options.crashing, viewers.mean_mbits[1],
                viewers.worst_mbits[1]);
  if (run.back_ns > 0)
    std::printf("cut for %g s: all that it missed after %.0f ms; behind for %.0f ms at most before; %llu keyframes asked for\n",
                options.cut, viewers.back_ms, quantile(viewers.latency, 1), static_cast<unsigned long long>(viewers.asked));
  if (viewers.thaw_ms > 0)
    std::printf("frozen for 3 s: current again after %.0f ms; the oldest surface shown was superseded %.0f ms before\n",
                viewers.thaw_ms, viewers.stale_ms);
  std::printf("server: %.2f cores, recording %.3f; %.0f MB, %+.1f MB an hour; %u to %u descriptors\n",
              (last.cpu - first.cpu) / seconds, (last.recorder_cpu - first.recorder_cpu) / seconds, 1e-6 * double(last.memory),
              3600e-6 * slope(run.samples), fewest->descriptors, most->descriptors);
  std::printf("%llu of %llu surfaces differ from the server's at the end; written %s/load.json\n",
              static_cast<unsigned long long>(viewers.diverged), static_cast<unsigned long long>(viewers.compared),
              options.folder.c_str());
  return viewers.diverged == 0 ? 0 : 1;
}

}  // namespace crumple::load

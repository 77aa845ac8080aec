#include "cli/info.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <map>
#include <set>

#include "bake/load_car.h"
#include "recording/recording.h"
#include "schema/message_generated.h"

namespace crumple {
namespace {

void print_car(const Car& car) {
  const Model& model = car.model;
  const auto anchored = std::count(model.node_anchored.begin(), model.node_anchored.end(), 1);
  std::printf("  %s  %s\n  %s\n", car.hash.c_str(), car.name.c_str(), car.attribution.c_str());
  std::printf("  nodes %zu (%td anchored)  tets %zu  edges %zu  vertices %zu  triangles %zu\n", model.node.size(), anchored,
              model.tet.size(), model.edge.size(), model.vertex.size(), model.triangle.size() / 3);
  Vec3 low = Vec3::Constant(INFINITY), high = -low;
  for (const Vec3& vertex : model.vertex) {
    low = low.cwiseMin(vertex);
    high = high.cwiseMax(vertex);
  }
  const Vec3 size = high - low;
  std::printf("  length %.2f m  width %.2f m  height %.2f m  mass %.0f kg  file %.1f kB\n  regions", size.x(), size.y(),
              size.z(), model.mass, 1e-3 * static_cast<double>(car.bytes.size()));
  for (const std::string& region : car.regions) std::printf(" %s", region.c_str());
  std::printf("\n");
  if (car.parts.part.empty()) return;
  std::printf("  parts");
  for (size_t i = 1; i < car.parts.part.size(); ++i)
    std::printf("%s %s (%s)", i > 1 ? "," : "", car.parts.part[i].name.c_str(),
                schema::EnumNamePartKind(car.parts.part[i].kind));
  std::printf("\n");
}

struct ChannelCount {
  uint64_t messages = 0, bytes = 0;
};

// A crash of one car: ticks with contact, less than a second apart.
struct Crash {
  double first = 0, last = 0;  // s
  double impulse = 0;          // N s
  double absorbed = 0;         // J
  float deepest = 0;           // m
};

struct Summary {
  std::map<std::string, ChannelCount> channels;
  std::set<std::string> hosts;
  std::map<std::string, std::vector<Crash>> crashes;  // by car
  std::map<std::string, double> absorbed;             // J, by car, as of its last reaction
  uint64_t ticks = 0, messages = 0;
};

void add_reactions(const RecordingReader::Item& item, Summary& summary) {
  flatbuffers::Verifier verifier(item.bytes.data(), item.bytes.size());
  if (!verifier.VerifyBuffer<schema::Reactions>(nullptr)) return;
  const auto* message = flatbuffers::GetRoot<schema::Reactions>(item.bytes.data());
  for (const auto* reaction : *message->cars()) {
    const std::string id = reaction->car()->str();
    double& absorbed = summary.absorbed[id];
    const double before = absorbed;
    absorbed = reaction->energy_absorbed();
    const auto& j = *reaction->impulse();
    const double impulse = std::hypot(j.x(), j.y(), j.z());
    auto& crashes = summary.crashes[id];
    if (impulse > 0 && (crashes.empty() || message->time() - crashes.back().last > 1)) crashes.push_back({message->time()});
    if (crashes.empty()) continue;
    Crash& crash = crashes.back();
    if (impulse > 0) crash.last = message->time();
    crash.impulse += impulse;
    crash.absorbed += absorbed - before;
    crash.deepest = std::max(crash.deepest, reaction->deepest());
  }
}

void print_recording(const std::string& path) {
  RecordingReader file(path);
  const RecordingHead& head = file.head();
  Summary summary;
  for (RecordingReader::Item item; file.next(item);) {
    ChannelCount& count = summary.channels[std::string(item.key)];
    ++count.messages;
    ++summary.messages;
    count.bytes += item.bytes.size();
    if (item.key.starts_with("host/")) summary.hosts.emplace(item.key.substr(5, item.key.find('/', 5) - 5));
    if (item.channel == Channel::reactions) add_reactions(item, summary);
    summary.ticks += item.channel == Channel::tick_end;
  }
  const auto number = [](uint64_t value) { return static_cast<unsigned long long>(value); };
  const std::string trouble = trouble_at_end(file.end(), summary.ticks, summary.messages);
  const std::string end = file.cut()             ? "; CUT OFF: whole up to its last tick"
                          : !trouble.empty()     ? "; ENDS EARLY: " + trouble
                          : file.end().recovered ? "; recovered: the original recording had more"
                                                 : "";
  std::printf("%s: a recording by %s, started %s%s\n", path.c_str(), head.program.c_str(), head.started.c_str(), end.c_str());
  std::printf("  scene %s  %llu ticks at %g a second: %.1f s  quantum %g mm  hosts", head.scene.c_str(), number(summary.ticks),
              head.rate, static_cast<double>(summary.ticks) / head.rate, 1e3 * static_cast<double>(head.quantum));
  for (const std::string& host : summary.hosts) std::printf(" %s", host.c_str());
  std::printf("\ncars that could be spawned\n");
  for (const auto& car : head.cars) print_car(*car);
  std::printf("channels                                  messages        bytes\n");
  for (const auto& [key, count] : summary.channels)
    std::printf("  %-36s %10llu %12llu\n", key.c_str(), number(count.messages), number(count.bytes));
  std::printf("crashes\n");
  for (const auto& [car, crashes] : summary.crashes)
    for (const Crash& crash : crashes)
      std::printf("  car %s  at %.2f s for %.0f ms  impulse %.0f N s  absorbed %.1f kJ  deepest push in a tick %.0f mm\n",
                  car.c_str(), crash.first, 1e3 * (crash.last - crash.first) + 1e3 / head.rate, crash.impulse,
                  1e-3 * crash.absorbed, 1e3 * static_cast<double>(crash.deepest));
  if (summary.crashes.empty()) std::printf("  none\n");
}

bool is_mcap(const std::string& path) {
  char magic[5] = {};
  std::ifstream(path, std::ios::binary).read(magic, sizeof magic);
  return std::memcmp(magic, "\x89MCAP", sizeof magic) == 0;
}

}  // namespace

int info(const std::vector<std::string>& files) {
  for (const std::string& path : files) {
    if (is_mcap(path)) {
      print_recording(path);
    } else {
      std::printf("%s: a baked car\n", path.c_str());
      print_car(*load_car(path));
    }
  }
  return 0;
}

}  // namespace crumple

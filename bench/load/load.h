// The load harness starts a server, runs hosts and viewers against it over real Zenoh, and reports how the server performed.
// Each host is a thread of this program with its own session. Each viewer is a process, so that the harness can freeze and kill
// it.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "impaired_link.h"

namespace crumple::load {

inline constexpr const char* scene = "load";
inline constexpr std::chrono::seconds patience{20};  // with a server under load

struct Options {
  std::string program;            // the path of crumple
  std::vector<std::string> cars;  // baked cars: the first is spawned, the others are its levels
  std::string serve;              // further options of `crumple serve`, as on a command line
  std::string folder = "build/bench/load/run";
  double seconds = 60;  // s of load, without the preparation and the calm afterwards
  uint32_t hosts = 1;   // number of hosts, which share the cars
  uint32_t asleep = 0, driving = 0, crashing = 1;
  double speed_kmh = 50;
  double period = 3;                          // s between crashes; all crashing cars hit at the same time
  double importance = 1;                      // importance of crashing cars
  double meeting = 0;                         // share of the crashing cars that hit cars instead of walls
  uint32_t pile = 2;                          // so many of them meet in one place; the others meet in pairs
  uint32_t viewers = 4, follow = 5, far = 0;  // far: so many of the viewers follow all cars on surface level 1
  uint32_t frozen = 0, killed = 0, late = 0;  // viewers
  Weather weather;                            // of each viewer's link, if any of these is set
  bool udp = false;
  double cut = 0;  // s for which the viewers' links are cut, at half of the time
  bool impaired() const {
    const Weather& w = weather;
    return udp || cut > 0 || w.delay + w.jitter + w.loss + w.damage + w.repeat + w.reorder + w.kbit > 0;
  }
};

// How crashing cars meet each other: the cars below `pile` in one place, from both sides one behind the other; those from there
// to `cars` head-on in pairs; the others hit walls. Neighbours in number have different hosts.
struct Meeting {
  uint32_t cars = 0, pile = 2;
};
Meeting meeting_of(const Options&);

// Ids: "c7" for a crashing car, "d7" for a driving car, "a7" for a sleeping car.
std::string car_id(char kind, uint32_t number);

struct HostTask {
  std::string endpoint, id, asset;
  std::vector<uint32_t> crashing, driving, asleep;  // numbers in the ids of its cars
  double speed = 0, period = 0, importance = 1;     // m/s, s
  Meeting meeting;
};
// Spawns its cars, sets `ready`, waits for `go`, and drives until `stop`. Throws std::runtime_error.
void play_host(const HostTask&, std::atomic<uint32_t>& ready, const std::atomic<bool>& go, const std::atomic<bool>& stop);

// A viewer process follows the cars until SIGTERM; on surface level 1 it follows all other cars too. Then it writes its events
// as lines of CSV:
//   open,NS,MS            when it started, and the time until it held every car
//   bytes,NS,BYTES        once a second: bytes received so far
//   held,NS,CAR,TICK      whenever the surface of a car became newer
//   end,CAR,TICK,HASH     the surface that it holds at the end
//   counts,ASKED,OLDER,REFUSED
struct ViewerTask {
  std::string endpoint, file;
  int level = 0;  // surface level
  std::vector<std::string> cars;
};
int view(const ViewerTask&);

// All results of the run.
struct Sample {  // the server's process, once a second
  uint64_t ns = 0;
  double cpu = 0, recorder_cpu = 0;  // s since it started
  uint64_t memory = 0;               // bytes resident
  uint32_t descriptors = 0;
};
struct ViewerRun {
  std::string file;
  std::vector<std::string> cars;
  std::string part;        // "steady", "frozen", "late", "far"
  uint64_t thawed_ns = 0;  // when a frozen viewer continued
};
struct Run {
  uint64_t begin_ns = 0, end_ns = 0;  // of the load phase
  uint64_t cut_ns = 0, back_ns = 0;   // when the viewers' links were cut and restored
  ImpairedLink::Counts packets;       // on these links
  std::string recording;
  std::vector<Sample> samples;
  std::vector<ViewerRun> viewers;
  std::map<std::string, std::string> truth[2];  // by surface level and car: the hash that a new viewer gets after the calm
};
// Writes load.json and prints the summary. Returns 1 if a viewer's last surface differs from the server's.
int report(const Options&, const Run&);

uint64_t wall_ns();

}  // namespace crumple::load

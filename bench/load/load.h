// The load harness: starts a server, plays hosts and viewers against it over real zenoh, and reports how it held. Hosts are
// threads of this program, each with a session of its own; viewers are processes, so that they can be frozen and killed.
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
  std::string program;            // the crumple to start
  std::vector<std::string> cars;  // baked; the first is spawned, further ones are its levels
  std::string serve;              // further options of `crumple serve`, as one would type them
  std::string folder = "build/bench/load/run";
  double seconds = 60;  // of load; setting up and the calm afterwards come on top
  uint32_t hosts = 1;   // share the cars
  uint32_t asleep = 0, driving = 0, crashing = 1;
  double speed_kmh = 50;
  double period = 3;                          // s from crash to crash; all crashing cars hit at the same time
  double importance = 1;                      // of crashing cars, which chooses their level
  uint32_t viewers = 4, follow = 5, far = 0;  // far: viewers, the last of them, that follow all cars on surface level 1
  uint32_t frozen = 0, killed = 0, late = 0;  // viewers
  Weather weather;                            // of the viewers' links, each of its own, if any of these is given
  bool udp = false;
  double cut = 0;  // s that the viewers' links are cut for, at a half of the time
  bool impaired() const {
    const Weather& w = weather;
    return udp || cut > 0 || w.delay + w.jitter + w.loss + w.damage + w.repeat + w.reorder + w.kbit > 0;
  }
};

// "c7": the crashing cars; "d7": those that drive; "a7": those asleep.
std::string car_id(char kind, uint32_t number);

struct HostTask {
  std::string endpoint, id, asset;
  std::vector<uint32_t> crashing, driving, asleep;  // numbers of its cars
  double speed = 0, period = 0, importance = 1;     // m/s, s
};
// Spawns its cars, tells `ready`, waits for `go`, drives until `stop`. Throws std::runtime_error.
void play_host(const HostTask&, std::atomic<uint32_t>& ready, const std::atomic<bool>& go, const std::atomic<bool>& stop);

// A viewer process: follows the cars (on surface level 1 with them all others) until SIGTERM, then writes what it saw as lines
// of CSV:
//   open,NS,MS            when it began, and how long until it held every car
//   bytes,NS,BYTES        once a second: bytes received so far
//   held,NS,CAR,TICK      whenever the surface of a car became newer
//   end,CAR,TICK,HASH     what it holds at the end
//   counts,ASKED,OLDER,REFUSED
struct ViewerTask {
  std::string endpoint, file;
  int level = 0;  // of the surfaces
  std::vector<std::string> cars;
};
int view(const ViewerTask&);

// What the run left behind, put together.
struct Sample {  // of the server's process, once a second
  uint64_t ns = 0;
  double cpu = 0, recorder_cpu = 0;  // s since it started
  uint64_t memory = 0;               // bytes resident
  uint32_t descriptors = 0;
};
struct ViewerRun {
  std::string file;
  std::vector<std::string> cars;
  std::string part;        // "steady", "frozen", "late", "far"
  uint64_t thawed_ns = 0;  // frozen: when it went on
};
struct Run {
  uint64_t begin_ns = 0, end_ns = 0;  // of the load
  uint64_t cut_ns = 0, back_ns = 0;   // of the viewers' links
  ImpairedLink::Counts packets;       // over them
  std::string recording;
  std::vector<Sample> samples;
  std::vector<ViewerRun> viewers;
  std::map<std::string, std::string> truth[2];  // by surface level and car: hash of what a fresh viewer gets after the calm
};
// Writes load.json; prints the summary. Returns 1 if some viewer ended with another surface than the server's.
int report(const Options&, const Run&);

uint64_t wall_ns();

}  // namespace crumple::load

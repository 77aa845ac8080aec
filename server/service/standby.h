// A standby: a second server of a scene. It receives the owner's inputs and computes the same ticks, so it holds the same
// world, bit for bit. When the owner ends, the standby goes on. It receives the inputs of each tick and, once at the start, the
// whole world. owner.h describes how servers know the owner.
#pragma once

#include <atomic>
#include <chrono>
#include <map>
#include <optional>
#include <span>
#include <string>

#include "io/net.h"
#include "tick/inputs.h"
#include "tick/world.h"

namespace crumple {

// ---- for the owner ----

// A question for the owner's world: the offset of the piece, a number chosen by the asker for all pieces of one snapshot, and
// the asker's program, because another program would not compute the same ticks.
std::vector<std::byte> world_question(uint64_t offset, uint64_t asker);

// Answers such questions. Offset 0 takes a new snapshot, at most one a second, because writing 1 MB per
// damaged car takes tick time.
class WorldAnswers {
 public:
  void answer(Net*, const NetEvent&, const World&);

 private:
  struct Snapshot {
    std::chrono::steady_clock::time_point asked;
    std::vector<std::byte> bytes;
  };
  std::map<uint64_t, Snapshot> snapshots_;  // by asker
  std::chrono::steady_clock::time_point last_{};
};

// ---- for a standby ----

struct StandbyOptions {
  std::string root;  // "crumple/1/{scene}/"
  std::string id;
  int threads = 1;
};
// Follows the owner until it is gone and this server is the one to take over. Then announces this server as the owner and
// returns its epoch; `world` is the owner's, as far as it was received. Returns nothing if `stop` came first. Prints to stdout
// what happens. Throws std::runtime_error if the session is broken or this server cannot hold the owner's world.
std::optional<uint64_t> stand_by(Net*, const StandbyOptions&, World& world, const std::atomic<bool>& stop);

}  // namespace crumple

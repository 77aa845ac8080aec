// A second server of a scene. It takes in what the owner takes in, makes the same ticks of it, and so holds the same world, bit
// for bit; where the owner ends, it goes on. What travels are the inputs of each tick, and once the whole world to begin with.
//
// Who owns a scene stands in a token, owner/{epoch}-{id}: the epoch counts up with each takeover. A server that was only cut
// off, and meets the token of a later epoch when it is back, knows that it was replaced.
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

// ---- of the owner ----

// What a question for the world says: where the piece begins, a number of the asker's own for all pieces of one snapshot, and
// its program, since another one would not make the same ticks.
std::vector<std::byte> world_question(uint64_t offset, uint64_t asker);

// Answers them. Offset 0 takes a new snapshot, at most one a second, since it takes some of a tick's time: 1 MB a damaged car.
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

// ---- of who stands by ----

struct StandbyOptions {
  std::string root;  // "crumple/1/{scene}/"
  std::string id;
  int threads = 1;
};
// Until the owner is gone and this server is the one to take over: then the epoch with which it has announced itself as the
// owner, and `world` is as the owner's was. Nothing if `stop` came first. Says on stdout what happens. Throws
// std::runtime_error: the session is broken, or the owner's world cannot be held here.
std::optional<uint64_t> stand_by(Net*, const StandbyOptions&, World& world, const std::atomic<bool>& stop);

}  // namespace crumple

// The tick: bytes in, bytes out. A function of (world, inbox): it knows no clock, socket, file or thread count that could
// change its answer, so serve, replay, tests and benchmarks all call the same one.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "car/car.h"
#include "protocol/limits.h"

namespace crumple {

// One message as it came: the key below crumple/1/{scene}/ (such as "host/game/poses") and the payload.
struct Message {
  std::string key;
  std::vector<std::byte> bytes;
  uint64_t ticket = 0;  // of a query, given back with its answer; 0 for samples
  bool failed = false;  // of an answer: a schema Answer with the reason, where something else was asked for
};

using Inbox = std::vector<Message>;
// What a tick gives back: samples to publish, and answers (ticket != 0) to the queries of the inbox.
using Outbox = std::vector<Message>;

struct World;  // cars, hosts, obstacles, counters: server/tick/state.h
struct WorldDeleter {
  void operator()(World*) const;
};
using WorldHandle = std::unique_ptr<World, WorldDeleter>;

// rate: ticks a second. quantum: of the surface, m.
WorldHandle make_world(double rate, float quantum, const Limits& = {});
// Lets every worker of the tick crash a car of each asset that nobody keeps: the memory that it takes is there before the first
// tick that needs it, which would be twice as long otherwise. No influence on the outcome. Returns the work that it did, as of
// Work::done: timed the second time, it says how fast this machine is.
uint64_t warm_up(World&, int threads);

// What a tick came to, and what it would have come to beyond that without a budget: tet visits of sweeps, and what else a
// crashing car takes, counted in those.
struct Work {
  uint64_t done = 0, shed = 0;
};

// What a tick did to the list of cars: ids in the order of its commands. A car that was despawned and spawned anew is in both
// lists; one that came and went within the tick is in none.
struct TickResult {
  std::vector<std::string> spawned, despawned, replaced;
  Work work;
};

// One tick; what was in the outbox goes. `threads`: TBB workers over cars, no influence on the outcome.
TickResult tick(World&, const Inbox&, Outbox&, int threads);
// Viewers are told of every car anew in the next tick: a server has taken over.
void renew(World&);
// The keyframes of all cars that the next deltas refer to: samples.
void shown(const World&, Outbox&);
// Ids of the cars that live, and of the hosts that have cars or obstacles.
std::vector<std::string> cars(const World&);
std::vector<std::string> hosts(const World&);
// Ticks done. The first is 1, so that 0 can stand for none.
uint64_t tick_count(const World&);
// Times in health come from this clock: seconds since any start; several threads ask it at once. Without one there are no
// times.
void set_clock(World&, std::function<double()> clock);

}  // namespace crumple

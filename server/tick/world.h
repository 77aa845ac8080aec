// The tick: bytes in, bytes out. It is a function of (world, inbox): no clock, socket, file or thread count can change its
// result, so serve, replay, tests and benchmarks all call the same one.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "car/car.h"
#include "protocol/limits.h"

namespace crumple {

// One received message: the key below crumple/1/{scene}/ (such as "host/game/poses") and the payload.
struct Message {
  std::string key;
  std::vector<std::byte> bytes;
  uint64_t ticket = 0;  // of a query, repeated in its answer; 0 for samples
  bool failed = false;  // of an answer: the bytes are not the reply, but a schema Answer with the reason
};

using Inbox = std::vector<Message>;
// The results of a tick: samples to publish, and answers (ticket != 0) to the queries of the inbox.
using Outbox = std::vector<Message>;

struct World;  // cars, hosts, obstacles, counters: server/tick/state.h
struct WorldDeleter {
  void operator()(World*) const;
};
using WorldHandle = std::unique_ptr<World, WorldDeleter>;

// rate: ticks a second. quantum: unit of surface displacements, m.
WorldHandle make_world(double rate, float quantum, const Limits& = {});
// Lets every worker crash a temporary car of each asset. This allocates its memory before the first tick that needs it; that
// tick would otherwise take twice as long. It does not change any result. Returns the work done, in the unit of Work::done:
// timed on a second call, it shows how fast this machine is.
uint64_t warm_up(World&, int threads);

// The work of a tick (done), and the work that the budget cut from it (shed), in tet visits of sweeps. All other work of a
// crashing car is converted to tet visits.
struct Work {
  uint64_t done = 0, shed = 0;
};

// The changes of the list of cars in a tick: ids in the order of its commands. A car that was despawned and spawned again is in
// both lists; a car that was spawned and despawned within the tick is in neither.
struct TickResult {
  std::vector<std::string> spawned, despawned, replaced;
  std::vector<size_t> latest;  // the messages of the inbox that are the latest poses or obstacles of their host now
  Work work;
};

// Computes one tick. Clears the outbox first. `threads`: TBB workers over cars; they do not change the result.
TickResult tick(World&, const Inbox&, Outbox&, int threads);
// Sends viewers a keyframe of every car in the next tick, because another server has taken over.
void renew(World&);
// Writes the keyframes to which the next deltas of all cars refer, as samples.
void shown(const World&, Outbox&);
// Ids of the living cars, and of the hosts that have cars or obstacles.
std::vector<std::string> cars(const World&);
std::vector<std::string> hosts(const World&);
// Number of ticks done. The first tick is 1, so 0 can mean none.
uint64_t tick_count(const World&);
// Sets the clock for the times in health. It returns seconds since any moment, and several threads call it at once. Without a
// clock health has no times.
void set_clock(World&, std::function<double()> clock);

}  // namespace crumple

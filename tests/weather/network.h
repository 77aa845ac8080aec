// Implements net.h with a simulated network: every session is a client of one router. It keeps Zenoh's promises and no others:
// a link keeps the order in each of its queues, a session that reconnects declares everything again, and tokens disappear with
// the link.
#pragma once

#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "fibers.h"
#include "io/net.h"

namespace crumple::weather {

inline constexpr Time lease = 3 * second;  // as net.h has it

class Draw {
 public:
  explicit Draw(uint64_t seed) : engine_(seed) {}
  uint64_t below(uint64_t end) { return engine_() % end; }
  double share() { return double(engine_() >> 11) * 0x1p-53; }
  bool chance(double share_of_one) { return share() < share_of_one; }
  Time between(Time least, Time most) { return least + Time(share() * double(most - least)); }
  uint64_t word() { return engine_(); }

 private:
  std::mt19937_64 engine_;
};

struct alignas(16) Block {
  uint8_t bytes[16];
};
struct Payload {
  std::vector<Block> blocks;
  size_t size = 0;
  const uint8_t* data() const { return blocks.empty() ? nullptr : blocks.front().bytes; }
};
using Bytes = std::shared_ptr<const Payload>;
Bytes payload(const void* data, size_t size);

// The network of a schedule.
struct Climate {
  Time latency = millisecond;  // one way, from a session to the router or back
  double jitter = 0;           // as a share of the latency
  double repeat = 0;           // share of the samples that arrive twice
  bool by_key = false;         // true: samples keep their order only within a key; false: within a priority
  bool ends_at_cut = true;     // true: open queries end when the link is cut; false: by their timeout
};

// Starts again without sessions. All earlier sessions are gone.
void begin_network(const Climate&, uint64_t seed);

bool tracing();
void set_tracing(bool on);
void trace(const std::string&);
std::vector<std::string>& traced();
// A hash of all events. The same seed must give the same hash.
uint64_t digest();
void digest(uint64_t);

// ---- what may befall a session ----

std::string& name_of(Net*);
void set_latency(Net*, Time latency, double jitter);
// Ends its process now, or after this many more calls of net.h. The router learns it at once, or after the lease.
void kill(Net*, bool at_once);
void kill_after(Net*, uint64_t calls, bool at_once);
bool is_dead(const Net*);
// Blocks its link for this long. After the lease the link is lost, and returns a little later.
void stall(Net*, Time);
// Closes its socket. It reconnects after this time.
void cut(Net*, Time);
// Stops its process for this long. After the lease its link is lost.
void freeze(Net*, Time);
// Loses this share of the samples to and from it until this time.
void storm(Net*, Time, double loss);
bool is_linked(const Net*);
// The time at which the last of these faults happened or ends.
Time trouble_until(const Net*);

// ---- what it has ----

const std::multiset<std::string>& tokens_of(const Net*);
size_t keys_of(const Net*);
Time oldest_query_of(const Net*);  // time of the oldest query without an answer; now(): there is none
size_t waiting_of(const Net*);
bool is_open(const Net*);

// The network calls these to inform the schedule.
void note_opened(Net*);
void note_announced(Net*, const std::string& key);

// Messages of other sessions, for a stranger who replays them.
using Seen = std::pair<std::string, Bytes>;
const std::deque<Seen>& seen();

}  // namespace crumple::weather

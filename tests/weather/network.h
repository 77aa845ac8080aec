// net.h over a simulated network: every session is a client of one router. What zenoh promises holds (a link keeps the
// order of each of its queues; whoever is linked anew declares all again; tokens go with the link), and nothing more.
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

// Of a schedule.
struct Climate {
  Time latency = millisecond;  // one way, from a session to the router or back
  double jitter = 0;           // share of it
  double repeat = 0;           // share of the samples that come twice
  bool by_key = false;         // samples keep their order within a key only, else within a priority
  bool ends_at_cut = true;     // questions under way end when the line is cut, else by their timeout
};

// Anew, with no session; the sessions of before are gone.
void begin_network(const Climate&, uint64_t seed);

bool tracing();
void set_tracing(bool on);
void trace(const std::string&);
std::vector<std::string>& traced();
// Of all that happened: the same for the same seed.
uint64_t digest();
void digest(uint64_t);

// ---- what may befall a session ----

std::string& name_of(Net*);
void set_latency(Net*, Time latency, double jitter);
// Its process ends in this moment, or after so many more calls of net.h. The router learns it at once, or after the
// lease.
void kill(Net*, bool at_once);
void kill_after(Net*, uint64_t calls, bool at_once);
bool is_dead(const Net*);
// Nothing comes through for so long; beyond the lease the link is lost, and comes back a little after.
void stall(Net*, Time);
// The socket is closed; linked anew after so long.
void cut(Net*, Time);
// Its process does not run for so long; beyond the lease the link is lost meanwhile.
void freeze(Net*, Time);
// Of the samples that come and go until then such a share is lost.
void storm(Net*, Time, double loss);
bool is_linked(const Net*);
// When anything of this befell it last, or ends.
Time trouble_until(const Net*);

// ---- what it has ----

const std::multiset<std::string>& tokens_of(const Net*);
size_t keys_of(const Net*);
Time oldest_query_of(const Net*);  // that came and is not answered; now: there is none
size_t waiting_of(const Net*);
bool is_open(const Net*);

// The schedule is told of these, by the network.
void note_opened(Net*);
void note_announced(Net*, const std::string& key);

// Messages of others, for whoever plays them again.
using Seen = std::pair<std::string, Bytes>;
const std::deque<Seen>& seen();

}  // namespace crumple::weather

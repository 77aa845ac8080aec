// A bad network between programs of one machine, for tests and the load harness; it needs no rights, as `tc netem` would. A
// proxy: clients connect to endpoint(), what passes is delayed and damaged in both directions alike, and comes out at `to`. TCP
// shows what it makes of loss: the stream stands until the segment was sent again. Datagrams are really lost. Seeded.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

namespace crumple {

struct Weather {
  double delay = 0, jitter = 0;  // ms, one way: delay +- jitter; the order stays
  double loss = 0;               // share of segments (1448 bytes) or datagrams
  double damage = 0;             // share of segments or datagrams in which a bit is flipped
  double repeat = 0;             // share of datagrams that arrive twice
  double reorder = 0;            // share of datagrams that are not delayed, and so overtake
  double kbit = 0;               // a second; what is over it waits half a second at most; 0: no limit
};

enum class LinkState {
  up,
  stalled,  // connections stay, nothing passes
  cut,      // connections are closed, new ones too
};

class ImpairedLink {
 public:
  // to: "tcp/127.0.0.1:PORT" or "udp/127.0.0.1:PORT". Throws std::runtime_error.
  ImpairedLink(const std::string& to, const Weather&, uint32_t seed = 1);
  ~ImpairedLink();
  const std::string& endpoint() const;
  void set(const Weather&);
  void set(LinkState);
  struct Counts {
    uint64_t connections = 0, bytes = 0, passed = 0, lost = 0, damaged = 0, repeated = 0, reordered = 0;
  };
  Counts counts() const;

 private:
  struct Proxy;
  std::unique_ptr<Proxy> proxy_;
};

}  // namespace crumple

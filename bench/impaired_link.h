// A proxy that imitates a bad network between programs of one machine, for tests and the load harness. Unlike `tc netem` it
// needs no root rights. Clients connect to endpoint(), and the proxy connects to `to`. It delays and damages the data in both
// directions alike. On a lost TCP segment it holds the stream until TCP would have resent the segment; datagrams are really
// lost. A seed determines all random draws.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

namespace crumple {

struct Weather {
  double delay = 0, jitter = 0;  // ms, one way: delay +- jitter; the order is kept
  double loss = 0;               // share of segments (1448 bytes) or datagrams
  double damage = 0;             // share of segments or datagrams in which a bit is flipped
  double repeat = 0;             // share of datagrams that arrive twice
  double reorder = 0;            // share of datagrams that are not delayed, so they overtake others
  double kbit = 0;               // kbit/s; further data waits for half a second at most; 0: no limit
};

enum class LinkState {
  up,
  stalled,  // connections stay open, but no data passes
  cut,      // all connections are closed, also new ones
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

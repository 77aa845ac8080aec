#include "impaired_link.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <deque>
#include <list>
#include <mutex>
#include <optional>
#include <random>
#include <stdexcept>
#include <thread>
#include <utility>
#include <vector>

namespace crumple {
namespace {

using Clock = std::chrono::steady_clock;

constexpr size_t segment = 1448;          // bytes of TCP in an Ethernet frame
constexpr size_t longest = 65'536;        // bytes of a datagram
constexpr size_t most_waiting = 4 << 20;  // bytes in one direction without a rate limit
constexpr double queue_seconds = 0.5;     // s: data that may wait for a rate limit
constexpr double least_timeout = 200;     // ms until TCP sends a lost segment again
constexpr int socket_buffer = 32 << 10;   // bytes: small, so that data waits in the proxy
constexpr size_t most_flows = 256;

Clock::duration milliseconds(double ms) {
  return std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double, std::milli>(ms));
}

struct Socket {
  int fd = -1;
  explicit Socket(int from = -1) : fd(from) {}
  Socket(Socket&& other) noexcept : fd(std::exchange(other.fd, -1)) {}
  Socket& operator=(Socket&& other) noexcept {
    std::swap(fd, other.fd);
    return *this;
  }
  ~Socket() {
    if (fd >= 0) close(fd);
  }
};

struct Packet {
  Clock::time_point due;
  std::vector<char> bytes;  // empty: the end of a stream
  size_t sent = 0;
};

// One direction of one connection.
struct Way {
  int from = -1, to = -1;
  std::deque<Packet> packets;  // sorted by due time
  size_t waiting = 0;          // bytes
  Clock::time_point free{};    // when a wire with a rate limit is free again
  Clock::time_point last{};    // latest due time so far
  bool ended = false, blocked = false;
};

// The client's end of a datagram flow is an address that the listening socket sends to.
struct Flow {
  Socket near, far;
  sockaddr_in client{};
  Way there, back;
  bool broken = false;
};

sockaddr_in address_of(const std::string& text) {
  const size_t slash = text.find('/'), colon = text.rfind(':');
  sockaddr_in out{};
  out.sin_family = AF_INET;
  if (slash == std::string::npos || colon == std::string::npos || colon < slash ||
      inet_pton(AF_INET, text.substr(slash + 1, colon - slash - 1).c_str(), &out.sin_addr) != 1)
    throw std::runtime_error(text + ": not an endpoint such as tcp/127.0.0.1:7447");
  out.sin_port = htons(static_cast<uint16_t>(std::stoul(text.substr(colon + 1))));
  return out;
}

void check(int status, const char* what) {
  if (status < 0) throw std::runtime_error(std::string("an impaired link cannot ") + what + ": " + std::strerror(errno));
}

const sockaddr* plain(const sockaddr_in& address) { return reinterpret_cast<const sockaddr*>(&address); }

}  // namespace

struct ImpairedLink::Proxy {
  bool datagrams;
  sockaddr_in to;
  Socket listener, wake;
  std::string endpoint;
  std::mt19937 random;
  std::list<Flow> flows;
  std::vector<char> buffer = std::vector<char>(longest);

  mutable std::mutex lock;  // protects the members below
  Weather weather;
  LinkState state = LinkState::up;
  Counts counts;
  bool stop = false;
  std::thread thread;

  bool happens(double share) { return share > 0 && std::uniform_real_distribution<double>()(random) < share; }
  size_t capacity() const {
    return weather.kbit > 0 ? size_t((queue_seconds + 1e-3 * weather.delay) * weather.kbit * 125) : most_waiting;
  }

  void add(Way& way, const char* bytes, size_t size) {
    Packet packet{{}, {bytes, bytes + size}};
    const auto now = Clock::now();
    way.free = std::max(way.free, now) + milliseconds(weather.kbit > 0 ? 8 * double(size) / weather.kbit : 0);
    const double jitter = std::uniform_real_distribution<double>(-weather.jitter, weather.jitter)(random);
    packet.due = way.free + milliseconds(std::max(0.0, weather.delay + jitter));
    ++counts.passed;
    counts.bytes += size;
    if (size > 0 && happens(weather.damage)) {
      packet.bytes[random() % size] ^= static_cast<char>(1 << random() % 8);
      ++counts.damaged;
    }
    if (!datagrams) {
      double timeout = std::max(least_timeout, 2 * weather.delay);
      for (; size > 0 && happens(weather.loss) && timeout < 60'000; timeout *= 2) {
        packet.due += milliseconds(timeout);
        ++counts.lost;
      }
    } else if (happens(weather.loss) || way.waiting + size > capacity()) {
      ++counts.lost;
      return;
    }
    const bool overtakes = datagrams && happens(weather.reorder);
    counts.reordered += overtakes;
    packet.due = overtakes ? way.free : std::max(packet.due, way.last);
    way.last = std::max(way.last, packet.due);
    const bool twice = datagrams && happens(weather.repeat);
    counts.repeated += twice;
    const auto after = [](Clock::time_point due, const Packet& other) { return due < other.due; };
    for (int n = twice ? 2 : 1; n > 0; --n) {
      way.waiting += size;
      way.packets.insert(std::upper_bound(way.packets.begin(), way.packets.end(), packet.due, after), packet);
    }
  }

  void take_stream(Flow& flow, Way& way) {
    const ssize_t size = recv(way.from, buffer.data(), buffer.size(), MSG_DONTWAIT);
    if (size < 0) {
      flow.broken |= errno != EAGAIN && errno != EINTR;
      return;
    }
    for (ssize_t at = 0; at < size; at += segment) add(way, buffer.data() + at, std::min(segment, size_t(size - at)));
    if (size == 0) {
      way.ended = true;
      add(way, nullptr, 0);
    }
  }

  void take_datagrams(Flow& flow) {
    for (ssize_t size; (size = recv(flow.far.fd, buffer.data(), buffer.size(), MSG_DONTWAIT)) >= 0;)
      add(flow.back, buffer.data(), size_t(size));
  }

  void accept_stream() {
    Socket near(accept4(listener.fd, nullptr, nullptr, SOCK_CLOEXEC));
    if (near.fd < 0 || state == LinkState::cut || flows.size() >= most_flows) return;
    Socket far(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
    const int at_once = 1;
    for (const Socket* one : {&near, &far}) {
      setsockopt(one->fd, IPPROTO_TCP, TCP_NODELAY, &at_once, sizeof at_once);
      for (const int option : {SO_SNDBUF, SO_RCVBUF})
        setsockopt(one->fd, SOL_SOCKET, option, &socket_buffer, sizeof socket_buffer);
    }
    if (far.fd < 0 || connect(far.fd, plain(to), sizeof to) < 0) return;
    Flow& flow = flows.emplace_back();
    flow.near = std::move(near);
    flow.far = std::move(far);
    flow.there.from = flow.back.to = flow.near.fd;
    flow.there.to = flow.back.from = flow.far.fd;
    ++counts.connections;
  }

  void accept_datagrams() {
    sockaddr_in client{};
    socklen_t length = sizeof client;
    ssize_t size;
    while ((size = recvfrom(listener.fd, buffer.data(), buffer.size(), MSG_DONTWAIT, reinterpret_cast<sockaddr*>(&client),
                            &length)) >= 0) {
      if (state == LinkState::cut) continue;
      auto flow = std::find_if(flows.begin(), flows.end(), [&](const Flow& one) {
        return one.client.sin_port == client.sin_port && one.client.sin_addr.s_addr == client.sin_addr.s_addr;
      });
      if (flow == flows.end()) {
        Socket far(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
        if (flows.size() >= most_flows || far.fd < 0 || connect(far.fd, plain(to), sizeof to) < 0) continue;
        flow = flows.emplace(flows.end());
        flow->client = client;
        flow->there.to = flow->back.from = far.fd;
        flow->back.to = listener.fd;
        flow->far = std::move(far);
        ++counts.connections;
      }
      add(flow->there, buffer.data(), size_t(size));
    }
  }

  // Sends the packets that are due.
  void pass(Flow& flow, Way& way) {
    way.blocked = false;
    while (!way.packets.empty() && way.packets.front().due <= Clock::now()) {
      Packet& packet = way.packets.front();
      const char* rest = packet.bytes.data() + packet.sent;
      const size_t size = packet.bytes.size() - packet.sent;
      constexpr int flags = MSG_DONTWAIT | MSG_NOSIGNAL;
      if (datagrams) {
        const bool back = &way == &flow.back;
        sendto(way.to, rest, size, flags, back ? plain(flow.client) : nullptr, back ? sizeof flow.client : 0);
      } else if (size == 0) {
        shutdown(way.to, SHUT_WR);
      } else {
        const ssize_t sent = send(way.to, rest, size, flags);
        if (sent < 0 && (errno == EAGAIN || errno == EINTR)) {
          way.blocked = true;
          return;
        }
        if (sent < 0) {
          flow.broken = true;
          return;
        }
        packet.sent += size_t(sent);
        if (packet.sent < packet.bytes.size()) continue;
      }
      way.waiting -= packet.bytes.size();
      way.packets.pop_front();
    }
  }

  // Waits until a socket or a packet is ready, and handles it.
  void turn() {
    if (state == LinkState::cut) flows.clear();
    std::vector<pollfd> fds = {{wake.fd, POLLIN, 0}};
    struct Waiting {
      Flow* flow;
      Way* way;
      bool in;
    };
    std::vector<Waiting> waiting;
    std::optional<Clock::time_point> next;
    if (state != LinkState::stalled) {
      fds.push_back({listener.fd, POLLIN, 0});
      for (Flow& flow : flows) {
        for (Way* way : {&flow.there, &flow.back}) {
          const bool listens = datagrams ? way == &flow.back : !way->ended && way->waiting < capacity();
          if (listens) {
            fds.push_back({way->from, POLLIN, 0});
            waiting.push_back({&flow, way, true});
          }
          if (way->blocked) {
            fds.push_back({way->to, POLLOUT, 0});
            waiting.push_back({&flow, way, false});
          } else if (!way->packets.empty()) {
            next = std::min(next.value_or(Clock::time_point::max()), way->packets.front().due);
          }
        }
      }
    }
    timespec timeout{};
    if (next) {
      const auto left = std::max(Clock::duration::zero(), *next - Clock::now());
      const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(left);
      timeout = {seconds.count(), std::chrono::duration_cast<std::chrono::nanoseconds>(left - seconds).count()};
    }
    lock.unlock();
    ppoll(fds.data(), fds.size(), next ? &timeout : nullptr, nullptr);
    lock.lock();
    uint64_t woken;
    if (fds[0].revents && read(wake.fd, &woken, sizeof woken) > 0) return;  // a new setting may forbid the awaited event
    for (size_t i = 0; i < waiting.size(); ++i) {
      if (!fds[i + 2].revents || !waiting[i].in) continue;
      datagrams ? take_datagrams(*waiting[i].flow) : take_stream(*waiting[i].flow, *waiting[i].way);
    }
    if (fds.size() > 1 && fds[1].revents) datagrams ? accept_datagrams() : accept_stream();
    for (Flow& flow : flows)
      for (Way* way : {&flow.there, &flow.back}) pass(flow, *way);
    flows.remove_if([this](const Flow& flow) {
      const auto over = [](const Way& way) { return way.ended && way.packets.empty(); };
      return flow.broken || (!datagrams && over(flow.there) && over(flow.back));
    });
  }

  void run() {
    std::unique_lock guard(lock);
    while (!stop) turn();
  }

  void tell() const {
    const uint64_t one = 1;
    static_cast<void>(write(wake.fd, &one, sizeof one));
  }
};

ImpairedLink::ImpairedLink(const std::string& to, const Weather& weather, uint32_t seed) : proxy_(new Proxy) {
  Proxy& proxy = *proxy_;
  proxy.datagrams = to.starts_with("udp/");
  proxy.to = address_of(to);
  proxy.weather = weather;
  proxy.random.seed(seed);
  const int kind = (proxy.datagrams ? SOCK_DGRAM : SOCK_STREAM) | SOCK_CLOEXEC | SOCK_NONBLOCK;
  proxy.listener = Socket(socket(AF_INET, kind, 0));
  sockaddr_in here{};
  here.sin_family = AF_INET;
  here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t length = sizeof here;
  check(bind(proxy.listener.fd, plain(here), sizeof here), "bind a port of 127.0.0.1");
  check(getsockname(proxy.listener.fd, reinterpret_cast<sockaddr*>(&here), &length), "learn its port");
  if (!proxy.datagrams) check(listen(proxy.listener.fd, 64), "listen");
  proxy.endpoint = (proxy.datagrams ? "udp/127.0.0.1:" : "tcp/127.0.0.1:") + std::to_string(ntohs(here.sin_port));
  proxy.wake = Socket(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  check(proxy.wake.fd, "make an eventfd");
  proxy.thread = std::thread([&proxy] { proxy.run(); });
}

ImpairedLink::~ImpairedLink() {
  {
    const std::lock_guard guard(proxy_->lock);
    proxy_->stop = true;
  }
  proxy_->tell();
  proxy_->thread.join();
}

const std::string& ImpairedLink::endpoint() const { return proxy_->endpoint; }

void ImpairedLink::set(const Weather& weather) {
  const std::lock_guard guard(proxy_->lock);
  proxy_->weather = weather;
  proxy_->tell();
}

void ImpairedLink::set(LinkState state) {
  const std::lock_guard guard(proxy_->lock);
  proxy_->state = state;
  proxy_->tell();
}

ImpairedLink::Counts ImpairedLink::counts() const {
  const std::lock_guard guard(proxy_->lock);
  return proxy_->counts;
}

}  // namespace crumple

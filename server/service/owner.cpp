#include "service/owner.h"

#include <cstdio>
#include <random>
#include <stdexcept>
#include <utility>

namespace crumple {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds look{2000};  // how long to look for an owner before claiming the scene

void need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
}

}  // namespace

std::string random_id() {
  std::random_device device;
  char digits[17];
  std::snprintf(digits, sizeof digits, "%08x%08x", device(), device());
  return digits;
}

bool claim_scene(Net* net, const std::string& scene, const Owner& owner, const std::atomic<bool>& stop) {
  const std::string root = root_of(scene);
  need(net_watch(net, (root + "owner/*").c_str()));
  for (auto looked = Clock::now(), until = looked + look; looked < until && !stop;) {
    NetEvent events[16];
    const int got = net_poll(net, events, 16, 50'000);
    need(got);
    // While this server's link was down or the process slept, it could see nobody: start over.
    const auto before = std::exchange(looked, Clock::now());
    if (net_connected(net) != 1 || looked - before > longest_blink) until = looked + look;
    for (int k = 0; k < got; ++k)
      if (events[k].kind == NET_ALIVE && parse_key(events[k].key, root).value_or(Key{}).channel == Channel::owner)
        throw std::runtime_error("scene " + scene +
                                 " has a server already: wait for its end with --standby, or serve another --scene");
  }
  if (!stop) need(net_announce(net, (root + owner_key(owner.epoch, owner.id)).c_str()));
  return !stop;
}

bool is_replaced(const Owner& owner, const Key& key) {
  return key.channel == Channel::owner && Owner{key.number, std::string(key.id)} > owner;
}

}  // namespace crumple

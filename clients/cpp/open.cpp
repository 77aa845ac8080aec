// Opens a session: checks the options, connects, and waits for the server.
#include <algorithm>
#include <utility>

#include "cpp/session.h"
#include "protocol/key.h"

namespace crumple::client {
namespace {

// Sends a query to the server and returns its ticket; 0: it could not be sent.
uint64_t put(Net* net, const std::string& key, std::span<const uint8_t> payload, std::chrono::milliseconds patience) {
  uint64_t ticket = 0;
  const auto timeout = static_cast<uint32_t>(patience.count());
  return net && net_get(net, key.c_str(), payload.data(), payload.size(), timeout, &ticket) == 0 ? ticket : 0;
}

// Subscribes and waits for the server. It throws nothing and sets the error.
int begin(Crumple& session, const char* connect, const char* network) {
  const auto timeout = static_cast<uint32_t>(session.timeout.count());
  if (net_open("client", nullptr, connect, network, timeout, &session.net) != 0)
    return fail(CRUMPLE_CLOSED, std::string("cannot reach ") + connect + " (" + transport_error() +
                                    "): is `crumple serve` running there" +
                                    (network ? ", and does it know this user and certificate?" : "?"));
  const std::string server = session.root + "server", owners = session.root + "owner/*", health = session.root + "health";
  if (net_watch(session.net, server.c_str()) != 0 || net_watch(session.net, owners.c_str()) != 0 ||
      net_subscribe(session.net, health.c_str(), 0, sample_limit) != 0)
    return fail(CRUMPLE_CLOSED, transport_error());
  const std::string reactions = session.root + "host/" + session.host + "/reactions";
  if (!session.host.empty() && net_subscribe(session.net, reactions.c_str(), reactions_kept, sample_limit) != 0)
    return fail(CRUMPLE_CLOSED, transport_error());
  const auto deadline = Clock::now() + session.timeout;
  while (!session.server_alive) {
    const auto left = std::chrono::duration_cast<std::chrono::microseconds>(deadline - Clock::now());
    if (left.count() <= 0)
      return fail(CRUMPLE_CLOSED,
                  "no server of scene " + session.root.substr(key_root.size(), session.root.size() - key_root.size() - 1) +
                      " answers at " + connect +
                      ": start `crumple serve --scene ...` there, or give the scene of the server that runs there");
    if (const int got = poll(&session, static_cast<uint64_t>(left.count())); got < 0) return got;
  }
  return CRUMPLE_OK;
}

}  // namespace
}  // namespace crumple::client

using namespace crumple::client;

// If there is no network, the count tells the caller that a keyframe is missing.
Crumple::Crumple(std::string scene_root) : root(std::move(scene_root)) {
  following.root = root;
  following.ask = [this](const std::string& key, std::span<const uint8_t> payload, std::chrono::milliseconds patience) {
    const uint64_t ticket = put(net, key, payload, patience);
    if (ticket != 0 || !net) ++statistics.asked;
    return ticket;
  };
  fetching.ask = [this](const std::string& key, std::span<const uint8_t> payload, std::chrono::milliseconds patience) {
    return put(net, key, payload, patience);
  };
}

Crumple::~Crumple() {
  if (net) net_close(net);
}

int crumple_open(const CrumpleOptions* options, Crumple** out) {
  return guarded({{"options", options}, {"out", out}}, [&]() -> int {
    *out = nullptr;
    if (options->version != CRUMPLE_CLIENT_VERSION)
      return fail(CRUMPLE_BAD_ARGUMENT, "options.version is not CRUMPLE_CLIENT_VERSION: rebuild with this library's header");
    if (!is_id(options->scene) || (options->host && !is_id(options->host)))
      return fail(CRUMPLE_BAD_ARGUMENT, "options.scene or .host is not an id: 1 to 32 characters of a-z A-Z 0-9 _ -");
    if (!crumple::is_scene(options->scene))
      return fail(CRUMPLE_BAD_ARGUMENT,
                  "options.scene is \"asset\", but the keys of baked cars begin with this name: give another name");
    const char* network = options->network && *options->network ? options->network : nullptr;
    if (network && net_check(network) != 0)
      return fail(CRUMPLE_BAD_ARGUMENT, std::string("options.network: ") + transport_error());
    auto session = std::make_unique<Crumple>(crumple::root_of(options->scene));
    session->host = options->host ? options->host : "";
    if (options->timeout_ms) session->timeout = std::chrono::milliseconds(options->timeout_ms);
    session->fetching.patience = std::max(session->timeout, piece_patience);
    // Sequence numbers begin above those of an earlier session of this host; else the server would drop messages as old.
    session->sequence = static_cast<uint64_t>(
        std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::system_clock::now().time_since_epoch()).count());
    const int status = options->connect ? begin(*session, options->connect, network) : CRUMPLE_OK;
    if (status != CRUMPLE_OK) return status;
    *out = keep(std::move(session));
    return CRUMPLE_OK;
  });
}

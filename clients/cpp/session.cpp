// Polls and feeds a session, and has the viewer's functions of crumple_client.h.
#include "cpp/session.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "protocol/key.h"

namespace crumple::client {
namespace {

// Changes the subscriptions for a car, or for "*", to this level, or to none.
int subscribe(Crumple& session, const std::string& cars, int level) {
  int& now = session.subscribed.try_emplace(cars, none).first->second;
  if (now == level || !session.net) return CRUMPLE_OK;
  for (const char* what : {"/key/", "/delta/"}) {
    const std::string key = session.root + "car/" + cars + what;
    if (level != none && net_subscribe(session.net, (key + std::to_string(level)).c_str(), samples_waiting, sample_limit) != 0)
      return fail(CRUMPLE_CLOSED, transport_error());
    if (now != none && net_unsubscribe(session.net, (key + std::to_string(now)).c_str()) != 0)
      return fail(CRUMPLE_CLOSED, transport_error());
  }
  now = level;
  return CRUMPLE_OK;
}

}  // namespace
}  // namespace crumple::client

using namespace crumple::client;

int crumple::client::poll(Crumple* session, uint64_t timeout_us) {
  if (!session->net) return fail(CRUMPLE_CLOSED, no_network);
  if (const auto now = Clock::now(); now - session->polled >= unpolled) session->following.doubt(now);
  NetEvent events[64];
  int total = 0, got = 0;
  do {
    got = net_poll(session->net, events, 64, until_next(session->impaired, timeout_us));
    if (got < 0) return fail(CRUMPLE_CLOSED, transport_error());
    for (int i = 0; i < got; ++i) {
      const NetEvent& event = events[i];
      if (event.kind == NET_SAMPLE && impair(session->impaired, false, event.key, {event.data, event.size})) continue;
      take(*session, event);
      ++total;
    }
    timeout_us = 0;
  } while (got == 64);
  total += take_impaired(*session);
  session->polled = Clock::now();  // this wait is no pause of the caller
  session->following.ask_due(session->polled);
  return total;
}

int crumple_poll(Crumple* handle, uint64_t timeout_us) {
  return with(handle, {}, [&](Crumple* session) { return poll(session, timeout_us); });
}

void crumple_statistics(const Crumple* handle, CrumpleStatistics* out) {
  if (out) *out = {};
  with(handle, {{"out", out}}, [&](Crumple* session) {
    *out = session->statistics;
    return CRUMPLE_OK;
  });
}

double crumple_time(const Crumple* handle) {
  double now = 0;
  with(handle, {}, [&](Crumple* session) {
    const ServerClock& clock = session->clock;
    now = session->net ? clock.now() : static_cast<double>(clock.tick) / clock.rate;
    return CRUMPLE_OK;
  });
  return now;
}

int crumple_feed(Crumple* handle, const char* key, const void* bytes, size_t size) {
  return with(handle, {{"key", key}}, [&](Crumple* session) -> int {
    if (size > 0 && !not_null({{"bytes", bytes}})) return CRUMPLE_BAD_ARGUMENT;
    if (size > message_limit) return fail(CRUMPLE_BAD_ARGUMENT, "the message is over 64 MiB");
    if (session->net)
      return fail(CRUMPLE_BAD_ARGUMENT, "this session has a network: open one without options.connect to feed it");
    std::vector<uint64_t> aligned((size + 7) / 8);
    if (size > 0) std::memcpy(aligned.data(), bytes, size);
    NetEvent event{};
    event.kind = NET_SAMPLE;
    event.key = key;
    event.data = reinterpret_cast<const uint8_t*>(aligned.data());
    event.size = size;
    const uint64_t refused = session->statistics.refused;
    take(*session, event);
    return session->statistics.refused == refused ? CRUMPLE_OK : CRUMPLE_BAD_ARGUMENT;
  });
}

int crumple_follow(Crumple* handle, const char* id, int level) {
  return with(handle, {}, [&](Crumple* session) -> int {
    if (id && !is_id(id)) return fail(CRUMPLE_BAD_ARGUMENT, "car is not an id: give 1 to 32 characters of a-z A-Z 0-9 _ -");
    if (level != 0 && level != 1) return fail(CRUMPLE_BAD_ARGUMENT, "level is neither 0 (near) nor 1 (far)");
    const bool watched = !session->net || session->following.level != none || (id && session->following.cars.count(id) > 0);
    if (!watched && net_watch(session->net, (session->root + "car/" + (id ? id : "*")).c_str()) != 0)
      return fail(CRUMPLE_CLOSED, transport_error());
    if (id) {
      // Messages that come for all cars need not come twice for this one.
      const int own_level = session->following.level == level ? none : level;
      if (const int status = subscribe(*session, id, own_level); status != CRUMPLE_OK) return status;
      session->following.follow(id, level, Clock::now());
      return CRUMPLE_OK;
    }
    if (const int status = subscribe(*session, "*", level); status != CRUMPLE_OK) return status;
    for (const auto& [each, car] : session->following.cars)
      if (const int status = subscribe(*session, each, none); status != CRUMPLE_OK) return status;
    session->following.follow_all(level, Clock::now());
    return CRUMPLE_OK;
  });
}

size_t crumple_cars(const Crumple* handle, const char** ids, size_t capacity) {
  const int count = with(handle, {}, [&](Crumple* session) -> int {
    if (capacity > 0 && !not_null({{"ids", ids}})) return CRUMPLE_BAD_ARGUMENT;
    size_t next = 0;
    for (const auto& [id, car] : session->following.cars) {
      if (next == capacity) break;
      ids[next++] = id.c_str();
    }
    return static_cast<int>(session->following.cars.size());
  });
  return static_cast<size_t>(std::max(0, count));
}

int crumple_surface(Crumple* handle, const char* id, CrumpleSurface* out) {
  return with(handle, {{"car", id}, {"out", out}}, [&](Crumple* session) -> int {
    const auto at = session->following.cars.find(id);
    if (at == session->following.cars.end())
      return fail(CRUMPLE_UNKNOWN, std::string("car ") + id + " is not followed: call crumple_follow");
    const FollowedCar& car = at->second;
    if (!held(car)) return CRUMPLE_PENDING;
    *out = {car.surface.tick,
            car.surface.hash,
            static_cast<uint32_t>(car.surface.quanta.size() / 3),
            car.surface.quantum,
            car.surface.asset.c_str(),
            car.surface.quanta.data(),
            session->shown[at->first].dirty,
            !car.gone};
    return CRUMPLE_OK;
  });
}

int crumple_health(const Crumple* handle, CrumpleHealth* out) {
  return with(handle, {{"out", out}}, [&](Crumple* session) -> int {
    *out = session->health;
    return session->health.rate > 0 ? CRUMPLE_OK : CRUMPLE_PENDING;
  });
}

#include "network.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <optional>
#include <string_view>

using namespace crumple::weather;

namespace {

struct Source {
  std::string expression;
  uint32_t depth = 0;
  size_t longest = 0;
  size_t waiting = 0;
  std::map<std::string, uint64_t> latest;  // if depth is 0: the number of the waiting sample by key
  NetIsNewer is_newer = nullptr;
};
using SourceHandle = std::shared_ptr<Source>;

struct Arrived {
  uint32_t kind;
  bool failed;
  std::string key;
  Bytes bytes;
  uint64_t ticket;
  SourceHandle source;
};

struct Asking {  // an open query at the router
  Net* asker;
  uint64_t epoch, ticket;
  std::multiset<Net*> awaited;
};
using AskingHandle = std::shared_ptr<Asking>;

struct OpenQuery {
  AskingHandle asking;
  std::string answer_key;
  Time since;
};

// The router's data about a session.
struct Face {
  std::vector<SourceHandle> subscribed, queryables, watched;
  std::multiset<std::string> tokens;
  std::map<std::string, bool> keys;  // and whether the session was told of a subscriber
  std::set<std::string> told;        // tokens of others
};

constexpr size_t lanes_most = 16;
enum Lane : unsigned { declaring, asking_lane, first_of_samples };
constexpr size_t replies_most = 4096, open_queries_most = 4096, keys_most = 1 << 14, latest_keys_most = 4096;
constexpr size_t bytes_most = size_t{256} << 20, key_most = 256, seen_most = 64;

}  // namespace

struct Net {
  uint64_t id = 0;
  std::string name;
  Fiber* fiber = nullptr;
  Time latency = 0;
  double jitter = 0;

  bool linked = false, closed = false, dead = false, black = false;
  uint64_t epoch = 0;  // of the link: messages from an earlier link do not arrive
  Time stalled_until = 0, storm_until = 0, trouble = -1000 * second;
  double loss = 0;
  uint64_t calls_left = UINT64_MAX;
  bool dies_at_once = true;
  std::array<Time, lanes_most> up_last{}, down_last{};
  Draw draw{0};

  std::vector<SourceHandle> subscribed, queryables, watched;
  std::multiset<std::string> tokens;
  std::map<std::string, bool> keys;  // and whether the session knows of a subscriber
  std::set<std::string> alive;       // tokens of others
  std::map<uint64_t, OpenQuery> open_queries;
  std::map<uint64_t, std::pair<std::string, uint64_t>> asked;  // by ticket: key, epoch of the link
  uint64_t tickets = 0, numbers = 0;
  size_t waiting_bytes = 0;
  std::map<uint64_t, Arrived> waiting;
  std::vector<Arrived> polled;
  SourceHandle replies = std::make_shared<Source>(Source{"", replies_most, SIZE_MAX, 0, {}, nullptr});
  NetStats stats{};
  std::optional<Face> face;  // the router's data about this session
};

namespace crumple::weather {
namespace {

Climate climate;
Draw draws{0};
std::vector<std::unique_ptr<Net>> sessions;
std::string error;
bool trace_on = false;
std::vector<std::string> lines;
uint64_t sum = 0;
std::deque<Seen> recent;

int fail(int status, std::string sentence) {
  error = std::move(sentence);
  return status;
}

// ---- key expressions ----

bool chunks_meet(std::string_view a, std::string_view b) {  // each is one chunk; $* matches any characters
  if (a.empty() && b.empty()) return true;
  if (a.starts_with("$*"))
    return chunks_meet(a.substr(2), b) || (!b.empty() && chunks_meet(a, b.substr(b.starts_with("$*") ? 2 : 1)));
  if (b.starts_with("$*")) return chunks_meet(b, a);
  return !a.empty() && !b.empty() && a[0] == b[0] && chunks_meet(a.substr(1), b.substr(1));
}

std::pair<std::string_view, std::string_view> first_chunk(std::string_view text) {
  const size_t slash = text.find('/');
  if (slash == std::string_view::npos) return {text, {}};
  return {text.substr(0, slash), text.substr(slash + 1)};
}

bool meet(std::string_view a, std::string_view b) {
  if (a == b) return true;
  if (a.empty() || b.empty()) return (a.empty() ? b : a) == "**";
  const auto [first_a, rest_a] = first_chunk(a);
  const auto [first_b, rest_b] = first_chunk(b);
  if (first_a == "**") return meet(rest_a, b) || (first_b[0] != '@' && meet(a, rest_b));
  if (first_b == "**") return meet(b, a);
  const bool verbatim = first_a[0] == '@' || first_b[0] == '@';
  if (verbatim ? first_a != first_b : first_a != "*" && first_b != "*" && !chunks_meet(first_a, first_b)) return false;
  return rest_a.empty() == rest_b.empty() ? rest_a.empty() || meet(rest_a, rest_b) : (rest_a.empty() ? rest_b : rest_a) == "**";
}

bool is_wild(std::string_view key) { return key.find('*') != std::string_view::npos; }

bool is_expression(std::string_view key) {
  return !key.empty() && !key.starts_with('/') && !key.ends_with('/') && key.find("//") == std::string_view::npos &&
         key.find_first_of("?#") == std::string_view::npos;
}

// ---- links ----

Time way(Net& session) { return Time(double(session.latency) * (1 + session.jitter * session.draw.share())); }

void along(Net& session, std::array<Time, lanes_most>& last, unsigned lane, std::function<void()> action) {
  if (!session.linked && !session.face) return;
  if (session.black || session.dead) return;
  Time& before = last[lane % lanes_most];
  before = std::max(before, std::max(now(), session.stalled_until) + way(session));
  at(before, [&session, epoch = session.epoch, action = std::move(action)] {
    if (session.epoch == epoch && !session.black) action();
  });
}
void up(Net& session, unsigned lane, std::function<void()> action) {
  if (session.linked) along(session, session.up_last, lane, std::move(action));
}
void down(Net& session, unsigned lane, std::function<void()> action) {
  if (session.face) along(session, session.down_last, lane, std::move(action));
}

bool is_lost(Net& session, const std::string& key) {
  // Obstacles are sent only once, and no real link loses them for ever.
  return now() < session.storm_until && !key.ends_with("/obstacles") && session.draw.chance(session.loss);
}

unsigned lane_of(const std::string& key, unsigned priority) {
  return first_of_samples + unsigned(climate.by_key ? std::hash<std::string>()(key) % 13 : priority);
}

// ---- what comes to a session ----

bool push(Net& session, Arrived arrived) {
  if (session.dead || session.closed) return false;
  Source& source = *arrived.source;
  const size_t size = arrived.bytes ? arrived.bytes->size : 0;
  const bool sample = arrived.kind == NET_SAMPLE, query = arrived.kind == NET_QUERY;
  auto& refused = query ? session.stats.queries_refused : session.stats.received_dropped;
  const bool latest = sample && source.depth == 0;
  const bool full = (!latest && source.waiting >= source.depth) || session.waiting_bytes + size > bytes_most ||
                    (latest && source.latest.size() >= latest_keys_most && !source.latest.contains(arrived.key));
  if (full && arrived.kind != NET_REPLY_END) {
    ++refused;
    return false;
  }
  if (const auto found = source.latest.find(arrived.key); latest && source.is_newer && found != source.latest.end()) {
    const Bytes& before = session.waiting.at(found->second).bytes;
    if (!source.is_newer(arrived.bytes->data(), size, before->data(), before->size)) {
      ++session.stats.overtaken;
      return false;
    }
  }
  const uint64_t number = ++session.numbers;
  if (latest) {
    const auto [found, is_new] = source.latest.try_emplace(arrived.key, number);
    if (!is_new) {
      const auto older = session.waiting.find(std::exchange(found->second, number));
      session.waiting_bytes -= older->second.bytes->size;
      --source.waiting;
      session.waiting.erase(older);
      ++session.stats.replaced;
    }
  }
  if (sample) ++session.stats.received, session.stats.received_bytes += size;
  if (query) ++session.stats.queries;
  ++source.waiting;
  session.waiting_bytes += size;
  session.waiting.emplace(number, std::move(arrived));
  wake(session.fiber);
  return true;
}

void take_sample(Net& session, const std::string& key, const Bytes& bytes) {
  for (const SourceHandle& source : session.subscribed) {
    if (!meet(source->expression, key)) continue;
    if (key.size() > key_most || key.find('\0') != std::string::npos)
      ++session.stats.received_dropped;
    else if (bytes->size > source->longest)
      ++session.stats.oversized;
    else
      push(session, {NET_SAMPLE, false, key, bytes, 0, source});
  }
}

void report(Net& session, const std::string& key, bool alive, const SourceHandle& to) {
  if (key.size() > key_most || key.find('\0') != std::string::npos) return;
  push(session, {uint32_t(alive ? NET_ALIVE : NET_GONE), false, key, nullptr, 0, to});
}

void report_to_all(Net& session, const std::string& key, bool alive) {
  for (const SourceHandle& source : session.watched)
    if (meet(source->expression, key)) report(session, key, alive, source);
}

void end_question(Net& session, uint64_t ticket, const char* failure) {
  const auto found = session.asked.find(ticket);
  if (found == session.asked.end()) return;
  const std::string key = found->second.first;
  session.asked.erase(found);
  if (failure) push(session, {NET_REPLY, true, key, payload(failure, std::strlen(failure)), ticket, session.replies});
  push(session, {NET_REPLY_END, false, key, nullptr, ticket, session.replies});
}

// ---- the router ----

void tell_matching() {
  for (const auto& session : sessions) {
    if (!session->face) continue;
    for (auto& [key, told] : session->face->keys) {
      const bool matching = std::any_of(sessions.begin(), sessions.end(), [&](const auto& other) {
        if (other == session || !other->face) return false;
        const auto& all = other->face->subscribed;
        return std::any_of(all.begin(), all.end(), [&](const auto& each) { return meet(each->expression, key); });
      });
      if (matching == std::exchange(told, matching)) continue;
      Net& to = *session;
      down(to, declaring, [&to, key = key, matching] {
        if (const auto found = to.keys.find(key); found != to.keys.end()) found->second = matching;
      });
    }
  }
}

bool other_has_token(const Net& than, const std::string& key) {
  return std::any_of(sessions.begin(), sessions.end(),
                     [&](const auto& each) { return each.get() != &than && each->face && each->face->tokens.contains(key); });
}

void tell_token(Net& to, const std::string& key, bool alive) {
  down(to, declaring, [&to, key, alive] {
    if (alive ? !to.alive.insert(key).second : to.alive.erase(key) == 0) return;
    report_to_all(to, key, alive);
  });
}

void token_changed(const std::string& key) {
  for (const auto& each : sessions) {
    Net& session = *each;
    if (!session.face) continue;
    const auto& watched = session.face->watched;
    const bool watches = std::any_of(watched.begin(), watched.end(), [&](const auto& it) { return meet(it->expression, key); });
    const bool alive = other_has_token(session, key);
    if (!watches || alive == session.face->told.contains(key)) continue;
    if (alive)
      session.face->told.insert(key);
    else
      session.face->told.erase(key);
    tell_token(session, key, alive);
  }
}

void finish(const AskingHandle& asking, Net* by) {
  const auto one = asking->awaited.find(by);
  if (one == asking->awaited.end()) return;
  asking->awaited.erase(one);
  if (!asking->awaited.empty() || asking->asker->epoch != asking->epoch) return;
  down(*asking->asker, asking_lane, [asking] { end_question(*asking->asker, asking->ticket, nullptr); });
}

void take_query(Net& session, const SourceHandle& source, const AskingHandle& asking, const std::string& key,
                const Bytes& bytes);

void route_query(Net& from, uint64_t ticket, const std::string& key, const Bytes& bytes) {
  const auto asking = std::make_shared<Asking>(Asking{&from, from.epoch, ticket, {}});
  for (const auto& each : sessions) {
    Net& to = *each;
    if (&to == &from || !to.face) continue;
    for (const SourceHandle& source : to.face->queryables) {
      if (!meet(source->expression, key)) continue;
      asking->awaited.insert(&to);
      down(to, asking_lane, [&to, source, asking, key, bytes] { take_query(to, source, asking, key, bytes); });
    }
  }
  if (asking->awaited.empty()) {
    asking->awaited.insert(nullptr);
    finish(asking, nullptr);
  }
}

void route_sample(Net& from, const std::string& key, const Bytes& bytes, unsigned priority) {
  for (const auto& each : sessions) {
    Net& to = *each;
    if (&to == &from || !to.face) continue;
    const auto& all = to.face->subscribed;
    if (std::none_of(all.begin(), all.end(), [&](const auto& it) { return meet(it->expression, key); })) continue;
    if (is_lost(to, key)) continue;
    for (int copies = to.draw.chance(climate.repeat) ? 2 : 1; copies > 0; --copies)
      down(to, lane_of(key, priority), [&to, key, bytes] { take_sample(to, key, bytes); });
  }
}

// The router loses the session.
void router_drop(Net& session) {
  if (!session.face) return;
  const Face face = std::move(*session.face);
  session.face.reset();
  for (const std::string& token : std::set(face.tokens.begin(), face.tokens.end())) token_changed(token);
  tell_matching();
}

std::multimap<Net*, std::weak_ptr<Asking>> awaiting;  // by the session that must answer

void end_what_it_owes(Net& session) {
  const auto [first, last] = awaiting.equal_range(&session);
  std::vector<AskingHandle> owed;
  for (auto at = first; at != last; ++at)
    if (auto asking = at->second.lock()) owed.push_back(std::move(asking));
  awaiting.erase(&session);
  for (const AskingHandle& asking : owed)
    while (asking->awaited.contains(&session)) finish(asking, &session);
}

// ---- the session learns ----

void client_drop(Net& session) {
  if (!session.linked) return;
  session.linked = false;
  trace(session.name + ": its line is cut");
  const auto alive = std::exchange(session.alive, {});
  for (const std::string& token : alive) report_to_all(session, token, false);
  for (auto& [key, matching] : session.keys) matching = false;
  session.open_queries.clear();
  if (!climate.ends_at_cut) return;
  std::vector<uint64_t> tickets;
  for (const auto& [ticket, asked] : session.asked) tickets.push_back(ticket);
  for (const uint64_t ticket : tickets) end_question(session, ticket, nullptr);
}

void declare(Net& session, const SourceHandle& source, std::vector<SourceHandle> Face::*list) {
  up(session, asking_lane, [&session, source, list] {
    if (!session.face) return;
    ((*session.face).*list).push_back(source);
    if (list == &Face::subscribed) tell_matching();
    if (list != &Face::watched) return;
    std::set<std::string> all;
    for (const auto& other : sessions)
      if (other.get() != &session && other->face)
        for (const std::string& token : other->face->tokens)
          if (meet(source->expression, token)) all.insert(token);
    for (const std::string& token : all) {
      session.face->told.insert(token);
      down(session, declaring, [&session, token, source] {
        session.alive.insert(token);
        report(session, token, true, source);
      });
    }
  });
}

void declare_token(Net& session, const std::string& key) {
  up(session, asking_lane, [&session, key] {
    if (!session.face) return;
    session.face->tokens.insert(key);
    token_changed(key);
  });
}

void declare_key(Net& session, const std::string& key) {
  up(session, asking_lane, [&session, key] {
    if (!session.face) return;
    session.face->keys.try_emplace(key, false);
    tell_matching();
  });
}

void link_up(Net& session) {
  if (session.linked || session.dead || session.closed) return;
  router_drop(session);
  end_what_it_owes(session);
  ++session.epoch;
  session.black = false;
  session.linked = true;
  session.up_last.fill(now());
  session.down_last.fill(now());
  session.face.emplace();
  session.trouble = std::max(session.trouble, now());
  trace(session.name + ": linked");
  for (const auto& source : session.subscribed) declare(session, source, &Face::subscribed);
  for (const auto& source : session.queryables) declare(session, source, &Face::queryables);
  for (const auto& source : session.watched) declare(session, source, &Face::watched);
  for (const std::string& token : session.tokens) declare_token(session, token);
  for (const auto& [key, matching] : session.keys) declare_key(session, key);
}

// there, here: the times at which the router and the session learn it.
void lose_link(Net& session, Time there, Time here, Time back) {
  if (session.dead || session.closed) return;
  const uint64_t epoch = ++session.epoch;
  session.black = true;
  const auto if_same = [&session, epoch](void (*what)(Net&)) {
    return [&session, epoch, what] {
      if (session.epoch == epoch) what(session);
    };
  };
  at(there, if_same([](Net& it) {
       router_drop(it);
       end_what_it_owes(it);
     }));
  at(here, if_same(client_drop));
  const Time again = std::max(back, here) + session.draw.between(100 * millisecond, 400 * millisecond);
  session.trouble = std::max(session.trouble, again);
  at(again, if_same(link_up));
}

// ---- calls ----

// Each call may be the last one of a killed process.
int call(Net* session, uint64_t what) {
  digest(what * 0x9e3779b97f4a7c15 + session->id);
  if (session->dead || session->closed) return fail(TRANSPORT_CLOSED, "the session is closed");
  if (session->calls_left != UINT64_MAX && session->calls_left-- == 0) {
    kill(session, session->dies_at_once);
    return fail(TRANSPORT_CLOSED, "the session is closed");
  }
  return TRANSPORT_OK;
}

SourceHandle source(const char* expression, uint32_t depth, size_t longest, NetIsNewer is_newer = nullptr) {
  return std::make_shared<Source>(Source{expression, depth, longest, 0, {}, is_newer});
}

void take_query(Net& session, const SourceHandle& source, const AskingHandle& asking, const std::string& key,
                const Bytes& bytes) {
  const uint64_t ticket = ++session.tickets;
  const std::string answer_key = is_wild(source->expression) ? key : source->expression;
  awaiting.emplace(&session, asking);
  session.open_queries[ticket] = {asking, answer_key, now()};
  const bool too_long = bytes->size > source->longest || key.size() > key_most || key.find('\0') != std::string::npos;
  if (too_long) ++session.stats.oversized;
  if (too_long || !push(session, {NET_QUERY, false, key, bytes, ticket, source})) net_reply(&session, ticket, "refused", 7, 1);
}

int declare_key_once(Net* session, const char* key) {
  if (session->keys.contains(key)) return TRANSPORT_OK;
  if (session->keys.size() >= keys_most) return fail(TRANSPORT_DROPPED, "this session publishes on too many keys");
  session->keys.emplace(key, false);
  declare_key(*session, key);
  return TRANSPORT_OK;
}

}  // namespace

Bytes payload(const void* data, size_t size) {
  auto made = std::make_shared<Payload>();
  made->blocks.resize((size + 15) / 16);
  made->size = size;
  if (size > 0) std::memcpy(made->blocks.data(), data, size);
  return made;
}

void begin_network(const Climate& weather, uint64_t seed) {
  climate = weather;
  draws = Draw(seed);
  awaiting.clear();
  sessions.clear();
  lines.clear();
  recent.clear();
  sum = 0;
}

bool tracing() { return trace_on; }
void set_tracing(bool on) { trace_on = on; }
void trace(const std::string& text) {
  if (!trace_on) return;
  char time[32];
  std::snprintf(time, sizeof time, "%11.6f ", double(now()) * 1e-9);
  lines.push_back(time + text);
}
std::vector<std::string>& traced() { return lines; }
uint64_t digest() { return sum; }
void digest(uint64_t word) {
  sum = (sum ^ word ^ uint64_t(now())) * 0x9e3779b97f4a7c15;
  sum ^= sum >> 29;
}

std::string& name_of(Net* session) { return session->name; }

void set_latency(Net* session, Time latency, double jitter) {
  session->latency = latency;
  session->jitter = jitter;
}

void kill(Net* session, bool at_once) {
  if (session->dead || session->closed) return;
  trace(session->name + ": killed");
  session->dead = true;
  session->linked = false;
  session->trouble = now();
  const uint64_t epoch = ++session->epoch;
  at(now() + (at_once ? millisecond : lease), [session, epoch] {
    if (session->epoch != epoch) return;
    router_drop(*session);
    end_what_it_owes(*session);
  });
  wake(session->fiber);
}

void kill_after(Net* session, uint64_t calls, bool at_once) {
  session->calls_left = calls;
  session->dies_at_once = at_once;
}

bool is_dead(const Net* session) { return session->dead; }

void stall(Net* session, Time duration) {
  session->trouble = std::max(session->trouble, now() + duration);
  const auto soon = [&] { return session->draw.between(0, 20 * millisecond); };
  if (duration >= lease) return lose_link(*session, now() + lease + soon(), now() + lease + soon(), now() + duration);
  session->stalled_until = std::max(session->stalled_until, now() + duration);
}

void cut(Net* session, Time duration) {
  lose_link(*session, now() + session->draw.between(0, 20 * millisecond), now() + session->draw.between(0, 20 * millisecond),
            now() + duration);
}

void freeze(Net* session, Time duration) {
  const Time until = now() + duration;
  freeze(session->fiber, until);
  session->trouble = std::max(session->trouble, until);
  if (duration < lease) return;
  at(now() + lease, [=] { lose_link(*session, now(), until + session->draw.between(0, 50 * millisecond), until); });
}

void storm(Net* session, Time duration, double loss) {
  session->storm_until = now() + duration;
  session->loss = loss;
  session->trouble = std::max(session->trouble, session->storm_until);
}

bool is_linked(const Net* session) { return session->linked; }
Time trouble_until(const Net* session) { return session->trouble; }
const std::multiset<std::string>& tokens_of(const Net* session) { return session->tokens; }
size_t keys_of(const Net* session) { return session->keys.size(); }
Time oldest_query_of(const Net* session) {
  return session->open_queries.empty() ? now() : session->open_queries.begin()->second.since;
}
size_t waiting_of(const Net* session) { return session->waiting.size(); }
bool is_open(const Net* session) { return !session->dead && !session->closed; }
const std::deque<Seen>& seen() { return recent; }

}  // namespace crumple::weather

// ---- net.h ----

const char* transport_error(void) { return error.c_str(); }
const char* transport_version(void) { return "simulated"; }

int net_open(const char* mode, const char*, const char* connect, const char*, uint32_t, Net** out) {
  if (std::string_view(mode) != "client" || !connect) return fail(TRANSPORT_BAD_ARGUMENT, "all are clients of one router here");
  auto made = std::make_unique<Net>();
  made->id = sessions.size() + 1;
  made->draw = Draw(draws.word());
  made->latency = Time(double(climate.latency) * (0.5 + made->draw.share()));
  made->jitter = climate.jitter;
  made->fiber = running();
  made->name = connect;  // the actor's name, passed as the endpoint
  Net* session = sessions.emplace_back(std::move(made)).get();
  note_opened(session);
  if (running()) wait_until(now() + 4 * session->latency);
  const Time trouble = session->trouble;  // the first link is no trouble
  link_up(*session);
  session->trouble = trouble;
  *out = session;
  return TRANSPORT_OK;
}

int net_check(const char*) { return TRANSPORT_OK; }
const char* net_endpoint(const Net*) { return ""; }

void net_close(Net* session) {
  if (session->dead || session->closed) return;
  trace(session->name + ": closes");
  up(*session, declaring, [] {});
  session->closed = true;
  session->linked = false;
  Time last = now() + way(*session);
  for (const Time each : session->up_last) last = std::max(last, each);
  at(last, [session] {
    ++session->epoch;
    router_drop(*session);
    end_what_it_owes(*session);
  });
}

int net_put(Net* session, const char* key, const void* data, size_t size, enum NetPriority priority) {
  if (const int status = call(session, 1 + 16 * size)) return status;
  if (!is_expression(key)) return fail(TRANSPORT_BAD_ARGUMENT, "not a key expression");
  if (const int status = declare_key_once(session, key)) return status;
  ++session->stats.put;
  session->stats.put_bytes += size;
  const Bytes bytes = payload(data, size);
  if (!session->name.starts_with("stranger")) {
    recent.emplace_back(key, bytes);
    if (recent.size() > seen_most) recent.pop_front();
  }
  if (tracing()) trace(session->name + ": puts " + key + ", " + std::to_string(size) + " bytes");
  if (is_lost(*session, key)) return TRANSPORT_OK;
  up(*session, lane_of(key, priority),
     [session, name = std::string(key), bytes, priority] { route_sample(*session, name, bytes, priority); });
  return TRANSPORT_OK;
}

int net_withdraw(Net* session, const char* prefix) {
  if (const int status = call(session, 2)) return status;
  std::erase_if(session->keys, [&](const auto& each) { return each.first.starts_with(prefix); });
  up(*session, asking_lane, [session, name = std::string(prefix)] {
    if (session->face) std::erase_if(session->face->keys, [&](const auto& each) { return each.first.starts_with(name); });
  });
  return TRANSPORT_OK;
}

int subscribe(Net* session, const SourceHandle& to) {
  if (const int status = call(session, 3)) return status;
  session->subscribed.push_back(to);
  declare(*session, to, &Face::subscribed);
  return TRANSPORT_OK;
}

int net_subscribe(Net* session, const char* expression, uint32_t depth, size_t longest) {
  return subscribe(session, source(expression, depth, longest));
}

int net_subscribe_newest(Net* session, const char* expression, size_t longest, NetIsNewer is_newer) {
  return subscribe(session, source(expression, 0, longest, is_newer));
}

// The simulation never reaches the bounds of waiting data.
int net_prefer(Net*, const char*) { return TRANSPORT_OK; }

int net_unsubscribe(Net* session, const char* expression) {
  if (const int status = call(session, 4)) return status;
  const auto same = [name = std::string(expression)](const SourceHandle& each) { return each->expression == name; };
  std::erase_if(session->subscribed, same);
  up(*session, asking_lane, [session, same] {
    if (session->face) std::erase_if(session->face->subscribed, same);
    tell_matching();
  });
  return TRANSPORT_OK;
}

int net_queryable(Net* session, const char* expression, uint32_t depth, size_t longest) {
  if (const int status = call(session, 5)) return status;
  session->queryables.push_back(source(expression, std::max(1u, depth), longest));
  declare(*session, session->queryables.back(), &Face::queryables);
  return TRANSPORT_OK;
}

int net_get(Net* session, const char* key, const void* data, size_t size, uint32_t timeout_ms, uint64_t* ticket) {
  if (const int status = call(session, 6 + 16 * size)) return status;
  if (!is_expression(key)) return fail(TRANSPORT_BAD_ARGUMENT, "not a key expression");
  const uint64_t number = *ticket = ++session->tickets;
  session->asked[number] = {key, session->epoch};
  if (tracing()) trace(session->name + ": asks " + key + ", " + std::to_string(size) + " bytes");
  if (!session->linked) {
    at(now() + (climate.ends_at_cut ? 0 : Time(timeout_ms) * millisecond), [=] { end_question(*session, number, nullptr); });
    return TRANSPORT_OK;
  }
  up(*session, asking_lane,
     [session, number, name = std::string(key), bytes = payload(data, size)] { route_query(*session, number, name, bytes); });
  at(now() + Time(timeout_ms) * millisecond, [=] { end_question(*session, number, "Timeout"); });
  return TRANSPORT_OK;
}

int net_reply(Net* session, uint64_t ticket, const void* data, size_t size, int failed) {
  if (const int status = call(session, 7 + 16 * size)) return status;
  const auto found = session->open_queries.find(ticket);
  if (found == session->open_queries.end()) return fail(TRANSPORT_BAD_ARGUMENT, "no query waits under this ticket");
  const OpenQuery query = std::move(found->second);
  session->open_queries.erase(found);
  up(*session, asking_lane, [session, query, failed, bytes = payload(data, size)] {
    Net& asker = *query.asking->asker;
    if (asker.epoch == query.asking->epoch)
      down(asker, asking_lane, [query, failed, bytes] {
        Net& to = *query.asking->asker;
        if (to.asked.contains(query.asking->ticket))
          push(to, {NET_REPLY, failed != 0, query.answer_key, bytes, query.asking->ticket, to.replies});
      });
    finish(query.asking, session);
  });
  return TRANSPORT_OK;
}

int net_announce(Net* session, const char* key) {
  if (const int status = call(session, 8)) return status;
  trace(session->name + ": announces " + key);
  note_announced(session, key);
  session->tokens.insert(key);
  report_to_all(*session, key, true);
  declare_token(*session, key);
  return TRANSPORT_OK;
}

int net_retract(Net* session, const char* key) {
  if (const int status = call(session, 9)) return status;
  trace(session->name + ": retracts " + key);
  session->tokens.erase(key);
  report_to_all(*session, key, false);
  up(*session, asking_lane, [session, name = std::string(key)] {
    if (!session->face) return;
    session->face->tokens.erase(name);
    token_changed(name);
  });
  return TRANSPORT_OK;
}

int net_watch(Net* session, const char* expression) {
  if (const int status = call(session, 10)) return status;
  session->watched.push_back(source(expression, 1 << 16, 0));
  declare(*session, session->watched.back(), &Face::watched);
  return TRANSPORT_OK;
}

int net_matching(Net* session, const char* key) {
  if (const int status = call(session, 11)) return status;
  if (const int status = declare_key_once(session, key)) return status;
  return session->keys.at(key);
}

int net_connected(Net* session) { return session->linked; }

int net_poll(Net* session, NetEvent* events, uint32_t capacity, uint64_t timeout_us) {
  if (const int status = call(session, 12)) return status;
  session->polled.clear();
  const Time end = now() + Time(timeout_us) * 1000;
  while (running() && session->waiting.empty() && now() < end && !session->dead) wait_until(end);
  if (session->dead) return fail(TRANSPORT_CLOSED, "the session is closed");
  while (session->polled.size() < capacity && !session->waiting.empty()) {
    Arrived& first = session->waiting.begin()->second;
    --first.source->waiting;
    if (first.kind == NET_SAMPLE && first.source->depth == 0) first.source->latest.erase(first.key);
    if (first.bytes) session->waiting_bytes -= first.bytes->size;
    session->polled.push_back(std::move(first));
    session->waiting.erase(session->waiting.begin());
  }
  for (size_t i = 0; i < session->polled.size(); ++i) {
    const Arrived& each = session->polled[i];
    digest(each.kind + 256 * (each.bytes ? each.bytes->size : 0));
    events[i] = {
        each.kind,  each.failed, each.key.c_str(), each.bytes ? each.bytes->data() : nullptr, each.bytes ? each.bytes->size : 0,
        each.ticket};
  }
  return int(session->polled.size());
}

void net_stats(const Net* session, NetStats* out) {
  *out = session->stats;
  out->keys = session->keys.size();
}

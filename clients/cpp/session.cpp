// Opens a session, takes in messages, and has the viewer's side. It checks a message before it uses a field of it. A malformed
// message counts as refused and changes nothing.
#include "cpp/session.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstring>
#include <memory>
#include <mutex>
#include <shared_mutex>
#include <unordered_map>
#include <utility>

#include "protocol/asset.h"
#include "protocol/key.h"
#include "protocol/message.h"
#include "schema/car_generated.h"
#include "schema/message_generated.h"

namespace crumple::client {
namespace {

thread_local std::string last_error;

void copy(const schema::Vec3& from, float (&to)[3]) {
  to[0] = from.x();
  to[1] = from.y();
  to[2] = from.z();
}

CrumplePose pose_of(const schema::Pose& pose) {
  const auto& p = pose.position();
  const auto& q = pose.orientation();
  return {{p.x(), p.y(), p.z()}, {q.x(), q.y(), q.z(), q.w()}};
}

void refuse(Crumple& session, std::string why) {
  ++session.statistics.refused;
  fail(CRUMPLE_BAD_ARGUMENT, std::move(why));
}

void ask_for_keyframe(Crumple& session, const std::string& id, FollowedCar& car) {
  if (car.asking) return;
  const std::string key = session.root + "car/" + id + "/key/" + std::to_string(car.level);
  car.asked = Clock::now();
  car.owed = true;
  if (session.net) {
    if (net_get(session.net, key.c_str(), nullptr, 0, keyframe_ms, &car.asking) != 0) return;
    session.key_tickets[car.asking] = id;
  }
  car.unsure = false;
  ++session.statistics.asked;
}

// Forgets an earlier query: its answer, if one comes, says nothing about now.
void forget_question(Crumple& session, FollowedCar& car) {
  session.key_tickets.erase(car.asking);
  car.asking = 0;
}

void ask_for_asset(Crumple& session, const std::string& hash, Asset& asset) {
  const std::string key = std::string(asset_root) + hash;
  const uint64_t offset = asset.size;
  const auto timeout = static_cast<uint32_t>(std::max(session.timeout, asset_patience).count());
  if (net_get(session.net, key.c_str(), &offset, sizeof offset, timeout, &asset.asking) != 0)
    asset.trouble = transport_error();
  else
    session.asset_tickets[asset.asking] = hash;
}

// Gives the car of this id if the session follows it; a session that follows all takes any.
FollowedCar* followed(Crumple& session, std::string_view id) {
  auto at = session.cars.find(id);
  if (at == session.cars.end()) {
    if (session.level == none || session.cars.size() >= cars_limit) return nullptr;
    at = session.cars.try_emplace(std::string(id)).first;
    at->second.level = session.level;
  }
  return &at->second;
}

void take_surface(Crumple& session, const std::string& id, FollowedCar& car, bool keyframe, bool asked_for,
                  std::span<const uint8_t> bytes) {
  ++session.statistics.surface;
  session.statistics.surface_bytes += bytes.size();
  // Ticks of an earlier car of this id, of an earlier server or of another level cannot be compared with those of this one.
  Surface& surface = car.fresh && keyframe ? car.coming : car.surface;
  if (asked_for) surface.key_parts = {};
  const Outcome outcome = keyframe ? apply_keyframe(bytes, surface) : apply_delta(bytes, surface);
  car.unsure = !asked_for;
  car.owed &= !asked_for || outcome.applied == Applied::refused;
  switch (outcome.applied) {
    case Applied::whole:
      if (&surface == &car.coming) car.surface = std::exchange(car.coming, {});
      car.fresh &= !keyframe;
      car.dirty = true;
      if (!asked_for) session.clock.take(car.surface.tick);
      if (!car.past.empty()) remember(car, session.clock.rate);
      break;
    case Applied::part:
      break;
    case Applied::old:
      ++session.statistics.older;
      break;
    case Applied::missing_keyframe:
      ask_for_keyframe(session, id, car);
      break;
    case Applied::refused:
      refuse(session, outcome.why);
      break;
  }
}

void take_reactions(Crumple& session, std::span<const uint8_t> bytes) {
  const auto* message = verified<schema::Reactions>(bytes);
  if (!message) return refuse(session, "reactions are not a well-formed FlatBuffers table");
  session.clock.take(message->tick());
  for (const auto* from : *message->cars()) {
    if (!crumple::is_id(from->car()->string_view()) || session.names.size() > 100'000) {
      refuse(session, "a reaction names a car that can have no such id, or there are over 100000 cars");
      continue;
    }
    CrumpleReaction to{};
    to.car = session.names.insert(from->car()->str()).first->c_str();
    to.tick = message->tick();
    to.time = message->time();
    copy(*from->impulse(), to.impulse);
    copy(*from->angular_impulse(), to.angular_impulse);
    to.pose = pose_of(*from->pose());
    copy(*from->velocity(), to.velocity);
    copy(*from->angular_velocity(), to.angular_velocity);
    to.energy_absorbed = from->energy_absorbed();
    to.energy_stored = from->energy_stored();
    to.deepest = from->deepest();
    to.contacts = from->contacts();
    session.reactions.push_back(to);
  }
  while (session.reactions.size() > reactions_kept) session.reactions.pop_front();
}

// Asks for the keyframe of each car of which the server has sent something newer than the session holds, unless that may still
// be on its way.
void ask_for_the_lost(Crumple& session, const schema::Health& message) {
  if (!message.told()) return;
  for (const auto* told : *message.told()) {
    const auto at = session.cars.find(told->car()->str());
    if (at == session.cars.end() || told->ticks()->size() <= static_cast<uint32_t>(at->second.level)) continue;
    FollowedCar& car = at->second;
    const bool older = car.surface.quanta.empty() || car.surface.tick < told->ticks()->Get(static_cast<uint32_t>(car.level));
    if (older && Clock::now() - car.last > on_its_way) ask_for_keyframe(session, at->first, car);
  }
}

void take_health(Crumple& session, std::span<const uint8_t> bytes) {
  const auto* message = verified<schema::Health>(bytes);
  if (!message) return refuse(session, "health is not a well-formed FlatBuffers table");
  ask_for_the_lost(session, *message);
  if (message->rate() >= 1 && message->rate() <= 1000 && static_cast<double>(message->rate()) != session.clock.rate) {
    session.clock = {};
    session.clock.rate = message->rate();
  }
  session.clock.take(message->tick());
  CrumpleHealth& health = session.health;
  health = {message->tick(), message->late(), message->rate(), 0, 0, 0};
  if (message->rooms())
    for (const auto* room : *message->rooms())
      if (room->name()->string_view() == "tick") {
        health.tick_ms = room->milliseconds();
        health.worst_ms = room->worst();
      }
  if (message->refusals())
    for (const auto* count : *message->refusals()) health.refusals += count->value();
}

// failed: the reply is an error, which is a sentence of the transport (a timeout) and no Answer.
void take_answer(Crumple& session, CommandAnswer& answer, std::span<const uint8_t> bytes, bool failed) {
  if (const auto* message = verified<schema::Answer>(bytes)) {
    answer.ok = message->ok();
    answer.tick = message->tick();
    if (message->sentence()) answer.sentence = message->sentence()->str();
    if (message->state()) answer.state.assign(message->state()->begin(), message->state()->end());
  } else if (failed) {
    answer.sentence.assign(reinterpret_cast<const char*>(bytes.data()), std::min<size_t>(bytes.size(), 500));
  } else {
    answer.sentence = "the answer is not a well-formed FlatBuffers table";
    ++session.statistics.refused;
  }
  answer.arrived = true;
}

// Numbers the nodes of the skin in ascending order, as keyframes and deltas do. False: the skin names a node that is missing.
bool read_skin(const schema::Car& car, Asset& asset) {
  const uint32_t none = UINT32_MAX, nodes = car.node()->size();
  const auto weights = [](const schema::Skin& skin) { return std::array{skin.wa(), skin.wb(), skin.wc(), skin.wd()}; };
  const auto corners = [](const schema::Skin& skin) { return std::array{skin.a(), skin.b(), skin.c(), skin.d()}; };
  std::vector<uint32_t> number(nodes, none);
  for (const schema::Skin* skin : *car.skin()) {
    for (size_t k = 0; k < 4; ++k) {
      if (corners(*skin)[k] >= nodes) return false;
      if (weights(*skin)[k] > 0) number[corners(*skin)[k]] = 0;
    }
  }
  asset.skin_nodes = 0;
  for (uint32_t& one : number)
    if (one != none) one = asset.skin_nodes++;
  asset.skin.clear();
  for (const schema::Skin* skin : *car.skin()) {
    SkinVertex vertex{};
    for (size_t k = 0; k < 4; ++k) {
      if (!(weights(*skin)[k] > 0)) continue;
      vertex.at[k] = number[corners(*skin)[k]];
      vertex.weight[k] = weights(*skin)[k];
    }
    asset.skin.push_back(vertex);
  }
  return asset.skin.size() == car.vertex()->size() && asset.skin_nodes > 0;
}

// Sets the pointers of a mesh, after every piece has come and the bytes have the hash.
std::string read_mesh(const std::string& hash, Asset& asset) {
  const auto* bytes = reinterpret_cast<const uint8_t*>(asset.words.data());
  if (const std::string digits = hash_of(asset.words.data(), asset.size); hash != digits)
    return "the bytes of asset " + hash + " have the hash " + digits + ": ask again";
  flatbuffers::Verifier verifier(bytes, asset.size);
  if (!schema::VerifyCarBuffer(verifier)) return "asset " + hash + " is not a baked car";
  const schema::Car& car = *schema::GetCar(bytes);
  const auto& triangle = *car.triangle();
  const uint32_t vertices = car.vertex()->size();
  const bool fits = triangle.size() % 3 == 0 &&
                    std::all_of(triangle.begin(), triangle.end(), [&](uint32_t vertex) { return vertex < vertices; });
  if (!fits) return "triangles of asset " + hash + " name vertices that it does not have";
  if (!read_skin(car, asset)) return "the skin of asset " + hash + " names nodes that it does not have";
  asset.mesh.vertex_count = vertices;
  asset.mesh.triangle_count = triangle.size() / 3;
  asset.mesh.vertex = reinterpret_cast<const float*>(car.vertex()->Data());
  asset.mesh.triangle = triangle.data();
  asset.mesh.mass = car.mass();
  if (car.center_of_mass()) copy(*car.center_of_mass(), asset.mesh.center_of_mass);
  asset.mesh.name = car.name()->c_str();
  asset.mesh.attribution = car.attribution()->c_str();
  return {};
}

void take_asset(Crumple& session, const std::string& hash, Asset& asset, std::span<const uint8_t> bytes, bool failed) {
  asset.asking = 0;
  if (failed || asset.size + bytes.size() > asset_limit) {
    asset.trouble = failed ? std::string(reinterpret_cast<const char*>(bytes.data()), std::min<size_t>(bytes.size(), 500))
                           : "asset " + hash + " is over 256 MiB";
    return;
  }
  asset.words.resize((asset.size + bytes.size() + 7) / 8);
  if (!bytes.empty()) std::memcpy(reinterpret_cast<uint8_t*>(asset.words.data()) + asset.size, bytes.data(), bytes.size());
  asset.size += bytes.size();
  if (bytes.size() == asset_piece) return ask_for_asset(session, hash, asset);
  asset.trouble = read_mesh(hash, asset);
  asset.whole = asset.trouble.empty();
}

void take_sample(Crumple& session, const Key& key, std::span<const uint8_t> bytes) {
  if (key.channel == Channel::health) return take_health(session, bytes);
  if (key.channel == Channel::reactions) return take_reactions(session, bytes);
  if (key.channel != Channel::keyframe && key.channel != Channel::delta) return;
  FollowedCar* car = followed(session, key.id);
  if (!car || key.number != static_cast<uint64_t>(car->level)) return;  // of a level that the session left, or to all others
  car->last = Clock::now();
  take_surface(session, std::string(key.id), *car, key.channel == Channel::keyframe, false, bytes);
}

void take_reply(Crumple& session, uint64_t ticket, std::span<const uint8_t> bytes, bool failed) {
  if (const auto command = session.answers.find(ticket); command != session.answers.end()) {
    if (!command->second.arrived) take_answer(session, command->second, bytes, failed);
  } else if (const auto key = session.key_tickets.find(ticket); key != session.key_tickets.end()) {
    const auto car = session.cars.find(key->second);
    if (car == session.cars.end() || failed) return;
    take_surface(session, key->second, car->second, true, true, bytes);
    car->second.doubtful = false;
  } else if (const auto part = session.asset_tickets.find(ticket); part != session.asset_tickets.end()) {
    const std::string hash = part->second;
    session.asset_tickets.erase(part);
    take_asset(session, hash, session.assets[hash], bytes, failed);
  }
}

// Ends a ticket: nothing more comes for it.
void end_ticket(Crumple& session, uint64_t ticket) {
  if (const auto command = session.answers.find(ticket); command != session.answers.end()) {
    if (!command->second.arrived) command->second.sentence = "the server did not answer within the timeout of the session";
    command->second.arrived = true;
  } else if (const auto key = session.key_tickets.find(ticket); key != session.key_tickets.end()) {
    if (const auto car = session.cars.find(key->second); car != session.cars.end()) car->second.asking = 0;
    session.key_tickets.erase(key);
  } else if (const auto part = session.asset_tickets.find(ticket); part != session.asset_tickets.end()) {
    Asset& asset = session.assets[part->second];
    asset.asking = 0;
    asset.trouble = "the server did not answer with asset " + part->second;
    session.asset_tickets.erase(part);
  }
}

// Sends obstacles again: they are sent only once, and the line may have been down. A server that has them drops them by their
// number.
void send_obstacles_again(Crumple& session) {
  if (session.obstacles.empty()) return;
  const std::string key = session.root + "host/" + session.host + "/obstacles";
  net_put(session.net, key.c_str(), session.obstacles.data(), session.obstacles.size(), NET_REAL_TIME);
}

// The session may hold surfaces of one owner and get messages of another. If both were there for a moment, no token of the
// scene or of its cars has gone, so it asks for everything anew.
void another_owner(Crumple& session) {
  send_obstacles_again(session);
  for (auto& [id, car] : session.cars) {
    if (!car.alive) continue;
    car.fresh = true;
    car.coming = {};
    forget_question(session, car);
    ask_for_keyframe(session, id, car);
  }
}

void take_liveliness(Crumple& session, const Key& key, bool alive) {
  if (key.channel == Channel::owner) return another_owner(session);
  if (key.channel == Channel::server) {
    session.server_alive = alive;
    if (!alive) session.clock = {};  // the ticks of the next server begin elsewhere
    if (alive) send_obstacles_again(session);
  }
  const std::string_view id = key.id;
  FollowedCar* car = key.channel == Channel::command ? followed(session, id) : nullptr;
  if (!car) return;
  const bool asked = alive && !car->alive && (car->asking || !car->fresh);  // the session asked before the token came
  car->alive = alive;
  car->gone = !alive;
  car->doubtful = false;  // the session asks a new car for its keyframe anyway
  if (asked) return;
  car->fresh = true;
  car->coming = {};
  if (alive)
    ask_for_keyframe(session, std::string(id), *car);
  else
    forget_question(session, *car);  // the next car of this id has not got the query
}

void ask_the_silent(Crumple& session) {
  const auto now = Clock::now();
  for (auto& [id, car] : session.cars) {
    const bool unanswered = (car.doubtful || car.owed || car.fresh) && car.alive && now - car.asked > silence;
    if (unanswered || (car.unsure && now - car.last > silence)) ask_for_keyframe(session, id, car);
  }
}

// After a pause, seconds of old messages wait. The answer to a query that is sent now comes after all of them.
void doubt_after_a_pause(Crumple& session) {
  const auto now = Clock::now();
  if (now - std::exchange(session.polled, now) < unpolled) return;
  for (auto& [id, car] : session.cars) {
    if (!car.alive || car.surface.quanta.empty()) continue;
    forget_question(session, car);
    car.asked = {};
    car.doubtful = true;
  }
  ask_the_silent(session);
}

// Changes the subscriptions for a car, or for "*", to this level, or to none.
int subscribe(Crumple& session, const std::string& cars, int level) {
  int& now = session.subscribed.try_emplace(cars, none).first->second;
  if (now == level || !session.net) return CRUMPLE_OK;
  for (const char* what : {"/key/", "/delta/"}) {
    const std::string key = session.root + "car/" + cars + what;
    if (level != none && net_subscribe(session.net, (key + std::to_string(level)).c_str(), 4096, sample_limit) != 0)
      return fail(CRUMPLE_CLOSED, transport_error());
    if (now != none && net_unsubscribe(session.net, (key + std::to_string(now)).c_str()) != 0)
      return fail(CRUMPLE_CLOSED, transport_error());
  }
  now = level;
  return CRUMPLE_OK;
}

void change_level(Crumple& session, const std::string& id, FollowedCar& car, int level) {
  if (car.level == level) return;
  car.level = level;
  car.surface.key.clear();  // because no delta of this level is against it
  car.fresh = true;
  car.coming = {};
  forget_question(session, car);
  if (car.alive) ask_for_keyframe(session, id, car);
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
      return fail(CRUMPLE_CLOSED, "no server of scene " +
                                      session.root.substr(key_root.size(), session.root.size() - key_root.size() - 1) +
                                      " answers at " + connect + ": start `crumple serve --scene ...`, or give its scene");
    if (const int got = poll(&session, static_cast<uint64_t>(left.count())); got < 0) return got;
  }
  return CRUMPLE_OK;
}

}  // namespace

void ServerClock::take(uint64_t at) {
  const auto arrived = Clock::now();
  if (arrived - begun > std::chrono::seconds(1)) {
    before = std::exchange(least, std::numeric_limits<double>::infinity());
    begun = arrived;
  }
  tick = std::max(tick, at);
  least = std::min(least, std::chrono::duration<double>(arrived.time_since_epoch()).count() - static_cast<double>(at) / rate);
}

double ServerClock::now() const {
  if (tick == 0) return 0;
  return std::chrono::duration<double>(Clock::now().time_since_epoch()).count() - std::min(least, before);
}

bool held(const FollowedCar& car) { return !car.surface.quanta.empty() && !(car.doubtful && car.alive); }

void take(Crumple& session, const NetEvent& event) {
  const std::span<const uint8_t> bytes(event.data, event.size);
  if (event.kind == NET_REPLY || event.kind == NET_REPLY_END) {
    if (event.kind == NET_REPLY_END) return end_ticket(session, event.ticket);
    session.statistics.received_bytes += bytes.size();
    return take_reply(session, event.ticket, bytes, event.failed != 0);
  }
  const auto key = parse_key(event.key, session.root);
  if (!key) return;
  if (event.kind == NET_SAMPLE) {
    ++session.statistics.received;
    session.statistics.received_bytes += bytes.size();
    take_sample(session, *key, bytes);
  } else if (event.kind == NET_ALIVE || event.kind == NET_GONE) {
    take_liveliness(session, *key, event.kind == NET_ALIVE);
  }
}

bool impair(Impaired& impaired, bool outgoing, std::string_view key, std::span<const uint8_t> bytes) {
  const CrumpleImpairment& line = impaired.line;
  if (line.delay == 0 && line.jitter == 0 && line.loss == 0 && line.repeat == 0) return false;
  const auto draw = [&] { return double(impaired.draw()) / 4294967296.0; };
  for (int copies = draw() < double(line.repeat) ? 2 : 1; copies > 0; --copies) {
    const bool lost = draw() < double(line.loss);
    const double late = double(line.delay) + double(line.jitter) * (2 * draw() - 1);
    if (lost) continue;
    Impaired::Message message{outgoing, std::string(key), std::vector<uint64_t>((bytes.size() + 7) / 8), bytes.size()};
    if (!bytes.empty()) std::memcpy(message.words.data(), bytes.data(), bytes.size());
    const auto wait = std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(std::max(0.0, late)));
    impaired.under_way.emplace(Clock::now() + wait, std::move(message));
  }
  return true;
}

namespace {

// Takes the messages that have come to the end of a bad line. Returns how many came to the session.
int take_impaired(Crumple& session) {
  auto& under_way = session.impaired.under_way;
  int came = 0;
  while (!under_way.empty() && under_way.begin()->first <= Clock::now()) {
    const Impaired::Message message = std::move(under_way.extract(under_way.begin()).mapped());
    const auto* bytes = reinterpret_cast<const uint8_t*>(message.words.data());
    if (message.outgoing) {
      net_put(session.net, message.key.c_str(), bytes, message.size, NET_REAL_TIME);
    } else {
      take(session, NetEvent{NET_SAMPLE, 0, message.key.c_str(), bytes, message.size, 0});
      ++came;
    }
  }
  return came;
}

uint64_t until_next(const Impaired& impaired, uint64_t timeout_us) {
  if (impaired.under_way.empty()) return timeout_us;
  const auto left = std::chrono::duration_cast<std::chrono::microseconds>(impaired.under_way.begin()->first - Clock::now());
  return std::min(timeout_us, uint64_t(std::max<int64_t>(0, left.count())));
}

}  // namespace

int fail(int status, std::string sentence) {
  last_error = std::move(sentence);
  return status;
}

bool is_id(const char* text) { return text && crumple::is_id(std::string_view(text, strnlen(text, id_length_limit + 1))); }

namespace {

struct Sessions {
  std::shared_mutex lock;
  std::unordered_map<const Crumple*, std::unique_ptr<Crumple>> all;
  uintptr_t last = 0;
};

// Never destroyed: a game may close its session after the end of main.
Sessions& sessions() {
  static auto* all = new Sessions;
  return *all;
}

}  // namespace

Crumple* find(const Crumple* handle) {
  Sessions& known = sessions();
  {
    const std::shared_lock hold(known.lock);
    if (const auto at = known.all.find(handle); at != known.all.end()) return at->second.get();
  }
  fail(CRUMPLE_BAD_ARGUMENT,
       handle ? "the session was closed, or is none: crumple_open gives one" : "session is NULL: crumple_open gives one");
  return nullptr;
}

bool given(std::initializer_list<Argument> needed) {
  for (const Argument& argument : needed) {
    if (argument.value) continue;
    fail(CRUMPLE_BAD_ARGUMENT, std::string(argument.name) + " is NULL: crumple_client.h says what to give");
    return false;
  }
  return true;
}

int fail_by(const std::exception* thrown) noexcept {
  if (!dynamic_cast<const std::bad_alloc*>(thrown) && !dynamic_cast<const std::length_error*>(thrown)) try {
      last_error = thrown ? thrown->what() : "something was thrown that is no exception of C++";
      return CRUMPLE_FAILED;
    } catch (const std::bad_alloc&) {  // there is no room for the sentence
    }
  last_error.assign("no memory");  // short enough to take none itself
  return CRUMPLE_NO_MEMORY;
}

}  // namespace crumple::client

using namespace crumple::client;

const char* crumple_error(void) { return last_error.c_str(); }

int crumple_open(const CrumpleOptions* options, Crumple** out) {
  return guarded({{"options", options}, {"out", out}}, [&]() -> int {
    *out = nullptr;
    if (options->version != CRUMPLE_CLIENT_VERSION)
      return fail(CRUMPLE_BAD_ARGUMENT, "options.version is not CRUMPLE_CLIENT_VERSION: rebuild with this library's header");
    if (!is_id(options->scene) || (options->host && !is_id(options->host)))
      return fail(CRUMPLE_BAD_ARGUMENT, "options.scene or .host is not an id: 1 to 32 characters of a-z A-Z 0-9 _ -");
    if (!crumple::is_scene(options->scene))
      return fail(CRUMPLE_BAD_ARGUMENT,
                  "options.scene is \"asset\", under which the keys of baked cars stand: give another name");
    const char* network = options->network && *options->network ? options->network : nullptr;
    if (network && net_check(network) != 0)
      return fail(CRUMPLE_BAD_ARGUMENT, std::string("options.network: ") + transport_error());
    auto session = std::make_unique<Crumple>();
    session->root = crumple::root_of(options->scene);
    session->host = options->host ? options->host : "";
    if (options->timeout_ms) session->timeout = std::chrono::milliseconds(options->timeout_ms);
    // Sequence numbers begin above those of an earlier session of this host; else the server would drop messages as old.
    session->sequence = static_cast<uint64_t>(
        std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::system_clock::now().time_since_epoch()).count());
    const int status = options->connect ? begin(*session, options->connect, network) : CRUMPLE_OK;
    if (status != CRUMPLE_OK) return status;
    Sessions& known = sessions();
    const std::unique_lock hold(known.lock);
    const auto handle = reinterpret_cast<Crumple*>(16 * ++known.last);
    known.all.emplace(handle, std::move(session));
    *out = handle;
    return CRUMPLE_OK;
  });
}

Crumple::~Crumple() {
  if (net) net_close(net);
}

void crumple_close(Crumple* handle) {
  if (!handle) return;
  with(handle, {}, [&](Crumple*) {
    Sessions& known = sessions();
    std::unique_lock hold(known.lock);
    const auto closed = known.all.extract(handle);
    hold.unlock();  // others need not wait until a line is closed
    return CRUMPLE_OK;
  });
}

int crumple::client::poll(Crumple* session, uint64_t timeout_us) {
  if (!session->net) return fail(CRUMPLE_CLOSED, no_network);
  doubt_after_a_pause(*session);
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
  ask_the_silent(*session);
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

int crumple_impair(Crumple* handle, const CrumpleImpairment* line) {
  return with(handle, {{"line", line}}, [&](Crumple* session) -> int {
    if (!session->net) return fail(CRUMPLE_CLOSED, no_network);
    const auto within = [](float value, float most) { return value >= 0 && value <= most; };
    if (!within(line->delay, 60) || !within(line->jitter, 60) || !within(line->loss, 1) || !within(line->repeat, 1))
      return fail(CRUMPLE_BAD_ARGUMENT, "an impairment's delay or jitter is not from 0 to 60 s, or a share not from 0 to 1");
    session->impaired.line = *line;
    session->impaired.draw.seed(line->seed);
    return CRUMPLE_OK;
  });
}

int crumple_feed(Crumple* handle, const char* key, const void* bytes, size_t size) {
  return with(handle, {{"key", key}}, [&](Crumple* session) -> int {
    if (size > 0 && !given({{"bytes", bytes}})) return CRUMPLE_BAD_ARGUMENT;
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
    if (id && !is_id(id)) return fail(CRUMPLE_BAD_ARGUMENT, "not the id of a car: 1 to 32 characters of a-z A-Z 0-9 _ -");
    if (level != 0 && level != 1) return fail(CRUMPLE_BAD_ARGUMENT, "level is neither 0 (near) nor 1 (far)");
    const bool watched = !session->net || session->level != none || (id && session->cars.count(id) > 0);
    if (!watched && net_watch(session->net, (session->root + "car/" + (id ? id : "*")).c_str()) != 0)
      return fail(CRUMPLE_CLOSED, transport_error());
    if (id) {
      // Messages that come for all cars need not come twice for this one.
      if (const int status = subscribe(*session, id, session->level == level ? none : level); status != CRUMPLE_OK)
        return status;
      FollowedCar& car = session->cars.try_emplace(id).first->second;
      change_level(*session, id, car, level);
      ask_for_keyframe(*session, id, car);  // before its token can come
      return CRUMPLE_OK;
    }
    if (const int status = subscribe(*session, "*", level); status != CRUMPLE_OK) return status;
    session->level = level;
    for (auto& [each, car] : session->cars) {
      if (const int status = subscribe(*session, each, none); status != CRUMPLE_OK) return status;
      change_level(*session, each, car, level);
    }
    return CRUMPLE_OK;
  });
}

size_t crumple_cars(const Crumple* handle, const char** ids, size_t capacity) {
  const int count = with(handle, {}, [&](Crumple* session) -> int {
    if (capacity > 0 && !given({{"ids", ids}})) return CRUMPLE_BAD_ARGUMENT;
    size_t next = 0;
    for (const auto& [id, car] : session->cars) {
      if (next == capacity) break;
      ids[next++] = id.c_str();
    }
    return static_cast<int>(session->cars.size());
  });
  return static_cast<size_t>(std::max(0, count));
}

int crumple_surface(Crumple* handle, const char* id, CrumpleSurface* out) {
  return with(handle, {{"car", id}, {"out", out}}, [&](Crumple* session) -> int {
    const auto at = session->cars.find(id);
    if (at == session->cars.end()) return fail(CRUMPLE_UNKNOWN, std::string("car ") + id + " is not followed: crumple_follow");
    const FollowedCar& car = at->second;
    if (!held(car)) return CRUMPLE_PENDING;
    *out = {car.surface.tick,
            car.surface.hash,
            static_cast<uint32_t>(car.surface.quanta.size() / 3),
            car.surface.quantum,
            car.surface.asset.c_str(),
            car.surface.quanta.data(),
            car.dirty,
            !car.gone};
    return CRUMPLE_OK;
  });
}

int crumple::client::mesh_of(Crumple* session, const char* hash, CrumpleMesh* out) {
  if (!crumple::is_hash(hash)) return fail(CRUMPLE_BAD_ARGUMENT, "not the hash of an asset: 16 hexadecimal digits");
  Asset& asset = session->assets[hash];
  if (asset.whole) {
    *out = asset.mesh;
    return CRUMPLE_OK;
  }
  if (!asset.trouble.empty()) {
    const std::string trouble = asset.trouble;
    asset = {};
    return fail(CRUMPLE_NO_ANSWER, trouble);
  }
  if (!session->net) return fail(CRUMPLE_UNKNOWN, "asset " + std::string(hash) + " was not given: crumple_add_asset");
  if (!asset.asking) ask_for_asset(*session, hash, asset);
  return CRUMPLE_PENDING;
}

int crumple_mesh(Crumple* handle, const char* asset, CrumpleMesh* out) {
  return with(handle, {{"asset", asset}, {"out", out}}, [&](Crumple* session) { return mesh_of(session, asset, out); });
}

int crumple_add_asset(Crumple* handle, const void* car, size_t size, char hash[17]) {
  return with(handle, {{"car", car}, {"hash", hash}}, [&](Crumple* session) -> int {
    if (size > crumple::asset_limit) return fail(CRUMPLE_BAD_ARGUMENT, "the baked car is over 256 MiB");
    Asset asset;
    asset.words.resize((size + 7) / 8);
    if (size > 0) std::memcpy(asset.words.data(), car, size);
    asset.size = size;
    const std::string name = crumple::hash_of(asset.words.data(), asset.size);
    if (const std::string trouble = read_mesh(name, asset); !trouble.empty()) return fail(CRUMPLE_BAD_ARGUMENT, trouble);
    asset.whole = true;
    Asset& known = session->assets[name];
    session->asset_tickets.erase(known.asking);  // further pieces of it are of no use
    if (!known.whole) known = std::move(asset);  // if a caller has pointers into the other one, they stay valid
    std::memcpy(hash, name.c_str(), 17);
    return CRUMPLE_OK;
  });
}

int crumple_health(const Crumple* handle, CrumpleHealth* out) {
  return with(handle, {{"out", out}}, [&](Crumple* session) -> int {
    *out = session->health;
    return session->health.rate > 0 ? CRUMPLE_OK : CRUMPLE_PENDING;
  });
}

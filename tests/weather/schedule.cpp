#include "schedule.h"

#include <algorithm>
#include <atomic>
#include <cstring>
#include <list>
#include <memory>
#include <optional>
#include <stdexcept>

#include "cpp/session.h"
#include "network.h"
#include "protocol/key.h"
#include "schema/message_generated.h"
#include "service/serve.h"
#include "service/standby.h"
#include "tick/hash.h"
#include "tick/state.h"

namespace crumple::weather {

namespace {

struct Actor {
  std::string name;
  Fiber* fiber = nullptr;
  std::atomic<bool> stop = false;
  bool doomed = false, ended = false;  // doomed: it will be killed, perhaps a little later
  std::string died_of;                 // the exception that ended it
  int code = 0;
  // Of a server.
  bool server = false, standby = false;
  bool held = false;    // it held the owner's world when it took over
  bool begins = false;  // it is the owner of the first epoch
  Time owns_since = 0;
  World* world = nullptr;               // since its first tick
  std::map<uint64_t, uint64_t> hashes;  // of the last ticks, during calm
  // Of a host or viewer.
  Crumple* session = nullptr;
  int level = 0;
  struct Wanted {
    bool there = true;
    Time asked = -10 * second;
    double x = 0;
    float speed = 0;
  };
  std::map<std::string, Wanted> cars;  // of a host
  uint32_t obstacles = 0;              // number that it sent last
  std::deque<std::pair<Time, uint64_t>> sequences;
  Net* net = nullptr;  // the last session that it opened

  explicit Actor(std::string n) : name(std::move(n)) {}
};

struct Schedule {
  uint64_t seed;
  const std::string& car_file;
  const std::string& asset;
  Draw draw;
  Climate climate;
  std::list<Actor> actors;
  std::string broken;
  double rate = 60;
  bool calm = false;
  Time end = 0;
  Net* stranger = nullptr;
  bool rogue = false;  // the stranger has declared itself the owner
  size_t named = 0;
  // The last owner of the scene, and its last tick.
  Actor* owner = nullptr;
  uint64_t owner_tick = 0;
  Time owner_trouble = 0;
  Schedule(uint64_t s, const std::string& f, const std::string& a) : seed(s), car_file(f), asset(a), draw(s) {}
};

Schedule* schedule = nullptr;

constexpr Time longest_calm = 200 * second;  // a standby pauses for at most 60 s, after an attempt that may take as long
const std::string root = "crumple/1/main/";

void broken(const std::string& law) {
  if (schedule->broken.empty()) schedule->broken = law;
  trace("BROKEN: " + law);
}

bool is_killed(const Actor& actor) { return actor.net && is_dead(actor.net); }

// The library's session of a handle.
const Crumple& inside(const Actor& actor) { return *client::find(actor.session); }

Actor* running_actor() {
  for (Actor& actor : schedule->actors)
    if (actor.fiber == running()) return &actor;
  return nullptr;
}

bool is_owner(const Actor& actor) {
  return actor.server && !actor.ended && actor.net && is_open(actor.net) && tokens_of(actor.net).contains(root + "server");
}

// Whether its token says that it owns the scene.
bool owns(const Actor& actor) {
  if (!actor.server || actor.ended || !actor.net || !is_open(actor.net)) return false;
  const auto& tokens = tokens_of(actor.net);
  return std::any_of(tokens.begin(), tokens.end(), [](const std::string& each) { return each.starts_with(root + "owner/"); });
}

bool untroubled(const Actor& actor) { return trouble_until(actor.net) < now() - 10 * second; }

bool holds_world(const Net* standby) {
  const auto& tokens = tokens_of(standby);
  return std::any_of(tokens.begin(), tokens.end(),
                     [](const std::string& each) { return each.starts_with(root + "standby/0-"); });
}

Actor* only_owner() {
  Actor* found = nullptr;
  for (Actor& actor : schedule->actors) {
    if (!is_owner(actor)) continue;
    if (found) return nullptr;
    found = &actor;
  }
  return found;
}

// ---- actors ----

Actor& add(const std::string& what) { return schedule->actors.emplace_back(what + std::to_string(++schedule->named)); }

void begin(Actor& actor, std::function<void(Actor&)> body) {
  trace(actor.name + ": begins");
  actor.fiber = start([&actor, body = std::move(body)] {
    try {
      body(actor);
    } catch (const std::exception& error) {
      actor.died_of = error.what();
      trace(actor.name + ": " + actor.died_of);
    }
    actor.ended = true;
    actor.world = nullptr;
    trace(actor.name + ": has ended");
  });
}

bool other_owner_was_there(const Actor& than) {
  return schedule->rogue || std::any_of(schedule->actors.begin(), schedule->actors.end(),
                                        [&](const Actor& each) { return &each != &than && each.server; });
}

void start_server(bool standby) {
  Actor& actor = add(standby ? "standby" : "server");
  actor.server = true;
  actor.standby = standby;
  begin(actor, [](Actor& self) {
    ServeOptions options;
    options.cars = {schedule->car_file};
    options.connect = self.name;
    options.standby = self.standby;
    options.rate = schedule->rate;
    options.threads = 1;
    options.budget_ms = 0;
    try {
      self.code = serve(options, self.stop);
    } catch (const std::runtime_error& error) {
      const bool refused = std::string_view(error.what()).find("has a server already") != std::string_view::npos;
      if (is_killed(self) || (refused && other_owner_was_there(self))) return;
      broken(self.name + " ended by an exception: " + error.what());
    } catch (const std::exception& error) {
      broken(self.name + " ended by an exception: " + error.what());
    }
    if (is_killed(self)) return;
    if (self.code == 1 ? !other_owner_was_there(self) : self.code != 0 || !self.stop)
      broken(self.name + " ended with " + std::to_string(self.code) + " though nobody stopped or replaced it");
  });
}

bool open(Actor& self, const char* host) {
  const CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 2000, self.name.c_str(), "main", host, nullptr};
  Crumple* session = nullptr;
  while (!self.stop && !is_killed(self)) {
    if (crumple_open(&options, &session) == CRUMPLE_OK) {
      self.session = session;
      return true;
    }
    if (is_killed(self)) return false;
    wait_until(now() + 200 * millisecond);
  }
  return false;
}

void close(Actor& self) {
  if (self.session) crumple_close(std::exchange(self.session, nullptr));
}

CrumplePose pose_at(double x, double y) { return {{x, y, 0}, {0, 0, 0, 1}}; }

void tell_obstacles(Actor& self, Draw& draw, double y) {
  CrumpleObstacle walls[2] = {};
  self.obstacles = uint32_t(1 + draw.below(2));
  for (uint32_t k = 0; k < self.obstacles; ++k) {
    walls[k].id = k;
    walls[k].shape = CRUMPLE_BOX;
    walls[k].size[0] = walls[k].size[1] = walls[k].size[2] = 2;
    walls[k].pose = pose_at(10, y + 20 * k);
  }
  crumple_publish_obstacles(self.session, walls, self.obstacles);
}

// Spawns cars that the scene lacks, and despawns cars that it should not have.
void keep_cars(Actor& self, double y) {
  for (auto& [id, car] : self.cars) {
    const auto held = inside(self).following.cars.find(id);
    const bool there = held != inside(self).following.cars.end() && held->second.alive;
    if (there == car.there || now() - car.asked < second) continue;
    car.asked = now();
    uint64_t ticket;
    if (car.there) {
      CrumpleSpawn spawn{};
      spawn.pose = pose_at(car.x, y);
      spawn.planar = 1;
      crumple_spawn(self.session, id.c_str(), schedule->asset.c_str(), &spawn, &ticket);
    } else {
      crumple_despawn(self.session, id.c_str(), &ticket);
    }
  }
}

void command(Actor& self, Draw& draw, double y) {
  auto& [id, car] = *std::next(self.cars.begin(), ptrdiff_t(draw.below(self.cars.size())));
  uint64_t ticket;
  switch (draw.below(7)) {
    case 0:
      car.there = !car.there;
      break;
    case 1:
      crumple_repair(self.session, id.c_str(), float(draw.share()), &ticket);
      break;
    case 2: {
      CrumpleParameters parameters = crumple_keep();
      parameters.yield_strain = float(0.001 + 0.05 * draw.share());
      crumple_set_parameters(self.session, id.c_str(), &parameters, &ticket);
      break;
    }
    case 3:
      tell_obstacles(self, draw, y);
      break;
    case 4:
      crumple_save(self.session, id.c_str(), &ticket);
      break;
    default:
      car.speed = car.speed == 0 ? float(10 + 10 * draw.share()) : 0;
      car.x = 0;
  }
}

// Drives its cars into its wall and back again.
void start_host() {
  Actor& actor = add("host");
  begin(actor, [draw = Draw(schedule->draw.word())](Actor& self) mutable {
    const double y = 100 * double(self.name.back());
    for (uint64_t k = 1 + draw.below(2); k > 0; --k) self.cars[self.name + "-" + std::to_string(k)];
    const Time period = draw.between(16 * millisecond, 100 * millisecond);
    while (open(self, self.name.c_str())) {
      crumple_follow(self.session, nullptr, 0);
      tell_obstacles(self, draw, y);
      Time posed = 0;
      while (!self.stop && crumple_poll(self.session, uint64_t(period / 1000)) >= 0) {
        if (now() - posed < period) continue;
        const double passed = double(now() - posed) * 1e-9;
        posed = now();
        keep_cars(self, y);
        if (!schedule->calm && draw.chance(0.03)) command(self, draw, y);
        std::vector<CrumpleCarPose> poses;
        for (auto& [id, car] : self.cars) {
          if (!car.there) continue;
          if (schedule->calm) car.speed = 0, car.x = 0;
          car.x = std::min(6.5, car.x + double(car.speed) * std::min(passed, 0.1));
          if (car.x == 6.5) car.speed = 0;
          CrumpleCarPose pose{};
          pose.car = id.c_str();
          pose.pose = pose_at(car.x, y + 4 * (id.back() - '1'));
          pose.velocity[0] = car.speed;
          poses.push_back(pose);
        }
        if (poses.empty()) continue;
        crumple_publish_poses(self.session, double(now()) * 1e-9, poses.data(), poses.size());
        self.sequences.emplace_back(now(), inside(self).sequence);
        while (self.sequences.size() > 2 && self.sequences[1].first < now() - second / 2) self.sequences.pop_front();
      }
      close(self);
    }
  });
}

void start_viewer() {
  Actor& actor = add("viewer");
  begin(actor, [draw = Draw(schedule->draw.word())](Actor& self) mutable {
    const Time period = draw.between(5 * millisecond, 100 * millisecond);
    self.level = int(draw.below(2));
    while (open(self, nullptr)) {
      crumple_follow(self.session, nullptr, self.level);
      while (!self.stop && crumple_poll(self.session, uint64_t(period / 1000)) >= 0) {
        if (schedule->calm) continue;
        if (draw.chance(0.003)) wait_until(now() + draw.between(0, 4 * second));
        if (is_killed(self)) break;
        if (draw.chance(0.003)) {
          self.level = 1 - self.level;
          crumple_follow(self.session, nullptr, self.level);
        }
      }
      close(self);
    }
  });
}

// ---- strangers ----

std::vector<std::string> strange_keys() {
  std::vector<std::string> keys = {"**",
                                   "*",
                                   "crumple/**",
                                   "crumple/*/main/**",
                                   "crumple/1/**",
                                   "crumple/1/*/owner/**",
                                   "@/**",
                                   "@a/b",
                                   "crumple/1/asset/*",
                                   "crumple/1/asset/**",
                                   "crumple/1/asset/0123456789abcdef",
                                   "crumple/1/asset/0123456789ABCDEF",
                                   "crumple/1/asset/" + std::string(200, 'x')};
  for (const char* below : {"**",
                            "*",
                            "car/**",
                            "car/*",
                            "car/$*",
                            "car/a$*b/key/0",
                            "car/*/key/0",
                            "car/x/key/*",
                            "car/x/key/0",
                            "car/x/key/9",
                            "car/x",
                            "car/x/delta/0",
                            "car/x/answer",
                            "car/@x",
                            "host/*/poses",
                            "host/**/obstacles",
                            "host/$*/poses",
                            "host/x/reactions",
                            "host/x",
                            "host/@x/poses",
                            "host/x/y/poses",
                            "host/x/poses",
                            "host/x/obstacles",
                            "owner/*",
                            "owner/18446744073709551616-x",
                            "owner/18446744073709551615-x",
                            "owner/-1-x",
                            "owner/1000000001-x",
                            "owner/2-",
                            "owner/x",
                            "standby/*",
                            "standby/9-x",
                            "standby/0-",
                            "server/x",
                            "health",
                            "tick",
                            "budget",
                            "asset",
                            "asset/*",
                            "inputs",
                            "inputs/*",
                            "replica/*",
                            "replica/**",
                            "replica/world",
                            "replica/inputs",
                            "@x/car/y",
                            "replica/inputs/x"})
    keys.push_back(root + below);
  return keys;
}

// The inputs of the next tick as the owner would send them, but empty.
void put_false_inputs(Net* net) {
  for (auto at = seen().rbegin(); at != seen().rend(); ++at) {
    if (!at->first.ends_with("replica/inputs")) continue;
    const auto bytes = std::as_bytes(std::span(at->second->data(), at->second->size));
    const auto inputs = read_inputs(bytes);
    if (!inputs) return;
    Message message = inputs_message(inputs->tick + 1 + schedule->draw.below(3), {}, inputs->hash);
    if (schedule->draw.chance(0.3)) message = inputs_message(UINT64_MAX, {}, 0);
    net_put(net, (root + message.key).c_str(), message.bytes.data(), message.bytes.size(), NET_REAL_TIME);
    return;
  }
}

void act_strangely() {
  static const std::vector<std::string> keys = strange_keys();
  Draw& draw = schedule->draw;
  Net* net = schedule->stranger;
  NetEvent events[64];
  while (net_poll(net, events, 64, 0) == 64) {
  }
  std::string key = keys[draw.below(keys.size())];
  std::vector<uint8_t> bytes(draw.below(3) == 0 ? draw.below(2000) : draw.below(20));
  for (uint8_t& each : bytes) each = uint8_t(draw.word());
  uint64_t ticket;
  if (draw.chance(0.01)) {  // with the highest tick number
    schedule->rogue = true;
    const std::string token = root + owner_key(epoch_limit, "0");
    net_announce(net, token.c_str());
    at(now() + draw.between(second / 10, 3 * second), [net, token] { net_retract(net, token.c_str()); });
  }
  switch (draw.below(6)) {
    case 0:
      net_put(net, key.c_str(), bytes.data(), bytes.size(), NET_DATA);
      break;
    case 1:
      net_get(net, key.c_str(), bytes.data(), bytes.size(), 5000, &ticket);
      break;
    case 2: {
      if (tokens_of(net).size() > 8) net_retract(net, std::string(*tokens_of(net).begin()).c_str());
      net_announce(net, key.c_str());
      break;
    }
    case 3:
      put_false_inputs(net);
      break;
    default: {  // repeats or damages a message
      if (seen().empty()) break;
      const auto& [name, payload] = seen()[draw.below(seen().size())];
      std::vector<uint8_t> copy(payload->data(), payload->data() + payload->size);
      const bool surface = name.find("/car/") != std::string::npos || name.ends_with("/health") || name.ends_with("/reactions");
      // A sender with the right to publish surfaces can publish wrong ones, and a sender with the rights of a host can silence
      // the host; the router's rules prevent both. So the stranger sends at most half of a surface, and no obstacles of a host.
      if (name.ends_with("/obstacles")) break;
      if (surface) copy.resize(draw.below(copy.size() / 2 + 1));
      if (!surface && !copy.empty() && draw.chance(0.5)) {
        copy.resize(1 + draw.below(copy.size()));
        copy[draw.below(copy.size())] ^= uint8_t(1 + draw.below(255));
      }
      net_put(net, name.c_str(), copy.data(), copy.size(), NET_DATA);
    }
  }
  if (!schedule->calm)
    at(now() + draw.between(millisecond, 400 * millisecond), [] {
      if (!schedule->calm) act_strangely();
    });
}

void stranger_comes() {
  if (!schedule->stranger && !schedule->calm && net_open("client", nullptr, "stranger", nullptr, 0, &schedule->stranger) == 0)
    act_strangely();
}

// ---- what befalls them ----

Actor* pick(bool servers) {
  std::vector<Actor*> all;
  for (Actor& actor : schedule->actors)
    if (!is_killed(actor) && !actor.ended && actor.net && is_open(actor.net) && actor.server == servers) all.push_back(&actor);
  return all.empty() ? nullptr : all[schedule->draw.below(all.size())];
}

void strike() {
  Draw& draw = schedule->draw;
  const uint64_t what = draw.below(20);
  if (what == 0) return start_server(false);
  if (what <= 2) return start_server(true);
  if (what == 3) return start_viewer();
  if (what == 4) return stranger_comes();
  Actor* actor = pick(draw.chance(0.6));
  if (!actor) return;
  switch (what) {
    case 5:
    case 6:
    case 7: {
      const bool at_once = draw.chance(0.6);
      const uint64_t calls = draw.chance(0.5) ? 0 : draw.below(200);
      actor->doomed = true;
      trace(actor->name + ": is to be killed after " + std::to_string(calls) + " calls");
      if (calls > 0)
        kill_after(actor->net, calls, at_once);
      else
        kill(actor->net, at_once);
      if (draw.chance(0.6)) {
        const bool server = actor->server, host = !actor->cars.empty(), standby = draw.chance(0.7);
        at(now() + draw.between(0, 4 * second), [=] { server ? start_server(standby) : host ? start_host() : start_viewer(); });
      }
      break;
    }
    case 8:
      trace(actor->name + ": is told to end");
      actor->stop = true;
      break;
    case 9:
    case 10:
    case 11: {
      const Time duration = draw.chance(0.5) ? draw.between(0, 3 * second) : draw.between(3 * second, 10 * second);
      trace(actor->name + ": frozen for " + std::to_string(duration / millisecond) + " ms");
      freeze(actor->net, duration);
      break;
    }
    case 12:
    case 13:
    case 14:
      trace(actor->name + ": cut");
      cut(actor->net, draw.chance(0.5) ? 0 : draw.between(0, 5 * second));
      break;
    case 15:
    case 16: {
      const Time duration = draw.chance(0.5) ? draw.between(0, 3 * second) : draw.between(3 * second, 8 * second);
      trace(actor->name + ": nothing comes through for " + std::to_string(duration / millisecond) + " ms");
      stall(actor->net, duration);
      break;
    }
    default:
      trace(actor->name + ": loses samples");
      storm(actor->net, draw.between(second / 5, 3 * second), 0.05 + 0.75 * draw.share());
  }
}

// ---- laws ----

// The laws that must hold in calm. Each function returns the first broken law, or an empty string.
std::string surfaces_differ(const Actor& viewer, const World& world) {
  const Crumple& session = inside(viewer);
  for (const auto& [id, car] : world.cars) {
    CrumpleSurface held{};
    if (!session.following.cars.contains(id) || crumple_surface(viewer.session, id.c_str(), &held) != CRUMPLE_OK)
      return viewer.name + " holds nothing of car " + id;
    const auto& told = car.told[size_t(viewer.level)].latest;
    if (!held.alive) return viewer.name + " takes car " + id + " for gone";
    if (told.size() != 3 * size_t(held.node_count) || std::memcmp(told.data(), held.quanta, 2 * told.size()) != 0)
      return viewer.name + " holds another surface of car " + id + " than the owner";
  }
  for (const auto& [id, car] : session.following.cars)
    if (car.alive && !world.cars.contains(id)) return viewer.name + " takes car " + id + " for alive";
  return {};
}

std::string session_grows(const Actor& actor) {
  const Crumple& session = inside(actor);
  const auto& following = session.following.questions;
  const auto& fetching = session.fetching.tickets;
  if (following.size() > session.following.cars.size() + viewer::questions_limit ||
      session.answers.size() > client::answers_kept || session.reactions.size() > client::reactions_kept ||
      fetching.size() > session.fetching.assets.size())
    return actor.name + " keeps questions that have ended: " + std::to_string(following.size());
  if (keys_of(actor.net) > 4) return actor.name + " publishes on " + std::to_string(keys_of(actor.net)) + " keys";
  return {};
}

std::string host_unheard(const Actor& host, const World& world) {
  for (const auto& [id, car] : host.cars)
    if (car.there != world.cars.contains(id)) return "car " + id + (car.there ? " is not there" : " is still there");
  const auto found = world.hosts.find(host.name);
  if ((found == world.hosts.end() ? 0 : found->second.obstacles) != host.obstacles)
    return "the owner has other obstacles than " + host.name + " told";
  const bool drives = std::any_of(host.cars.begin(), host.cars.end(), [](const auto& each) { return each.second.there; });
  if (!drives || host.sequences.empty() || host.sequences.front().first > now() - second / 2) return {};
  if (found->second.poses_sequence.value_or(0) < host.sequences.front().second)
    return host.name + " has not been heard for half a second";
  return {};
}

std::string standby_differs(const Actor& standby, const Actor& owner) {
  if (!holds_world(standby.net) || !standby.world) return standby.name + " does not hold the owner's world";
  if (standby.hashes.empty() || owner.hashes.empty()) return standby.name + " makes no ticks";
  const auto& [tick, hash] = *standby.hashes.rbegin();
  if (tick + uint64_t(schedule->rate) + 1 < owner.hashes.rbegin()->first) return standby.name + " is behind the owner";
  const auto same = owner.hashes.find(tick);
  if (same != owner.hashes.end() && same->second != hash)
    return standby.name + " holds another world than the owner, at tick " + std::to_string(tick);
  return {};
}

std::string owner_grows(const Actor& owner) {
  const World& world = *owner.world;
  const size_t keys = keys_of(owner.net), allowed = 2 + 4 * world.cars.size() + world.hosts.size();
  if (keys > allowed)
    return owner.name + " publishes on " + std::to_string(keys) + " keys, with " + std::to_string(world.cars.size()) +
           " cars and " + std::to_string(world.hosts.size()) + " hosts";
  if (oldest_query_of(owner.net) < now() - 3 * second) return owner.name + " leaves a question without an answer";
  return {};
}

std::string unsettled() {
  const Actor* owner = only_owner();
  if (!owner) {
    std::string all;
    for (const Actor& actor : schedule->actors)
      if (is_owner(actor)) all += " " + actor.name;
    return all.empty() ? "nobody owns the scene" : "more than one own the scene:" + all;
  }
  if (!owner->world) return owner->name + " makes no ticks";
  if (std::string law = owner_grows(*owner); !law.empty()) return law;
  for (const Actor& actor : schedule->actors) {
    if (actor.ended || is_killed(actor) || &actor == owner) continue;
    std::string law;
    if (actor.server) {
      law = actor.net ? standby_differs(actor, *owner) : actor.name + " has not begun";
    } else if (!actor.session) {
      law = actor.name + " has no session";
    } else {
      if (!actor.cars.empty()) law = host_unheard(actor, *owner->world);
      if (law.empty()) law = surfaces_differ(actor, *owner->world);
      if (law.empty()) law = session_grows(actor);
    }
    if (!law.empty()) return law;
  }
  return {};
}

void ticked(World& world) {
  Actor* actor = running_actor();
  if (!actor) return;
  actor->world = &world;
  const bool serves = is_owner(*actor);
  if (serves && schedule->owner != actor) {
    const Actor* before = schedule->owner;
    // If an owner was killed while its link and the standby's link were good, no tick may be lost.
    if (before && is_killed(*before) && schedule->owner_trouble < now() - 10 * second && actor->held && untroubled(*actor) &&
        world.tick + uint64_t(schedule->rate) < schedule->owner_tick)
      broken("the scene went back from tick " + std::to_string(schedule->owner_tick) + " to " + std::to_string(world.tick));
    schedule->owner = actor;
  }
  if (serves) {
    schedule->owner_tick = world.tick;
    schedule->owner_trouble = trouble_until(actor->net);
  }
  if (!schedule->calm) return;
  actor->hashes[world.tick] = hash(world);
  while (actor->hashes.size() > 256) actor->hashes.erase(actor->hashes.begin());
}

// ---- a schedule ----

void keep_served() {
  const bool served = std::any_of(schedule->actors.begin(), schedule->actors.end(), [](const Actor& each) {
    return each.server && !is_killed(each) && !each.ended && !each.stop;
  });
  if (!served) start_server(true);
}

bool step_calm(Time until) {
  while (now() < until) {
    keep_served();
    run_until(now() + second / 4);
    if (!schedule->broken.empty()) return true;
    if (unsettled().empty()) return true;
  }
  return false;
}

void set_up() {
  Draw& draw = schedule->draw;
  schedule->rate = std::array<double, 4>{10, 20, 30, 60}[draw.below(4)];
  Climate& climate = schedule->climate;
  climate.latency =
      draw.chance(0.7) ? draw.between(100'000, 3 * millisecond) : draw.between(3 * millisecond, 100 * millisecond);
  climate.jitter = draw.chance(0.5) ? 0 : 2 * draw.share();
  climate.repeat = draw.chance(0.5) ? 0 : 0.1 * draw.share();
  climate.by_key = draw.chance(0.4);
  climate.ends_at_cut = draw.chance(0.7);
  begin_network(climate, draw.word());
  start_server(draw.chance(0.2));
  for (uint64_t k = draw.below(3); k > 0; --k) at(draw.between(0, 4 * second), [] { start_server(true); });
  for (uint64_t k = 1 + draw.below(2); k > 0; --k) start_host();
  for (uint64_t k = 1 + draw.below(2); k > 0; --k) start_viewer();
  if (draw.chance(0.4)) at(draw.between(0, 6 * second), stranger_comes);
  schedule->end = draw.between(4 * second, 15 * second);
  for (uint64_t k = 1 + draw.below(8); k > 0; --k) at(draw.between(second, schedule->end), strike);
}

void come_to_calm() {
  run_until(schedule->end);
  schedule->calm = true;
  trace("calm");
  if (schedule->stranger) net_close(schedule->stranger);
  for (Actor& actor : schedule->actors)
    if (actor.doomed) kill(actor.net, true);
  const bool served = std::any_of(schedule->actors.begin(), schedule->actors.end(), [](const Actor& each) {
    return each.server && !is_killed(each) && !each.ended && !each.stop;
  });
  if (!served) start_server(true);
  // Waits until pending events are over. Then the laws must hold, and must keep holding.
  run_until(now() + 10 * second);
  const Time until = now() + longest_calm;
  if (!step_calm(until)) return broken(unsettled());
  run_until(now() + second);
  if (!step_calm(until)) return broken(unsettled() + ", again");
}

void end_all() {
  for (Actor& actor : schedule->actors) {
    actor.stop = true;
    if (actor.net) kill(actor.net, true);
  }
  for (const Time until = now() + 60 * second; now() < until;) run_until(now() + second);
  for (Actor& actor : schedule->actors) {
    if (!has_ended(actor.fiber)) broken(actor.name + " does not end");
    if (has_ended(actor.fiber)) release(actor.fiber);
  }
}

}  // namespace

void note_opened(Net* net) {
  if (Actor* actor = running_actor()) actor->net = net;
}

void note_announced(Net* net, const std::string& key) {
  Actor* actor = running_actor();
  if (!actor || !key.starts_with(root + "owner/")) return;
  if (!is_linked(net)) broken(actor->name + " announces itself as the owner while its own line is cut");
  // Owners that start may not know of each other yet. Standbys know each other and take turns.
  const uint64_t epoch = std::stoull(key.substr(root.size() + 6));
  actor->begins = epoch == 1;
  if (epoch == 0 || epoch > epoch_limit) broken(actor->name + " takes over with epoch " + std::to_string(epoch));
  for (const Actor& other : schedule->actors) {
    const bool unseen = (actor->begins || other.begins) && now() - other.owns_since < second;
    if (&other != actor && owns(other) && untroubled(other) && untroubled(*actor) && !unseen)
      broken(actor->name + " takes over from " + other.name + ", which lives, and nothing has befallen the line of either");
  }
  actor->owns_since = now();
  actor->held = holds_world(net);
}

Ended run_schedule(uint64_t seed, const std::string& car_file, const std::string& asset) {
  Schedule made(seed, car_file, asset);
  schedule = &made;
  begin(seed);
  set_up();
  come_to_calm();
  const double seconds = double(now()) * 1e-9;
  const uint64_t sum = digest();
  end_all();
  schedule = nullptr;
  return {made.broken, sum, seconds};
}

// Wraps the real tick (--wrap of the linker) and records its result.
TickResult real_tick(World&, const Inbox&, Outbox&, int) __asm__("__real_" CRUMPLE_TICK);
TickResult wrapped_tick(World&, const Inbox&, Outbox&, int) __asm__("__wrap_" CRUMPLE_TICK);
TickResult wrapped_tick(World& world, const Inbox& inbox, Outbox& outbox, int threads) {
  TickResult result = real_tick(world, inbox, outbox, threads);
  ticked(world);
  return result;
}

}  // namespace crumple::weather

// What zenoh brings is passed on as it is; decided here is only what a browser needs so that the latest message under each key
// tells all: deltas whose keyframe it has, reactions by car, and keyframes asked for where one is missing.
#include "gateway/view.h"

#include <cctype>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <exception>
#include <filesystem>
#include <fstream>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <stdexcept>
#include <string_view>
#include <thread>
#include <utility>

#include "gateway/control.h"
#include "io/files.h"
#include "io/transport.h"
#include "protocol/asset.h"
#include "protocol/key.h"
#include "protocol/message.h"
#include "recording/answer.h"
#include "recording/film.h"
#include "recording/recording.h"
#include "schema/message_generated.h"

namespace crumple {
namespace {

using Clock = std::chrono::steady_clock;

constexpr uint32_t connect_ms = 5'000, keyframe_ms = 3'000, asset_ms = 5'000;
constexpr std::chrono::milliseconds ask_again{500};
constexpr std::chrono::milliseconds hit_ends{1000};  // without a contact
// What health says of a car that spoke so lately may still be on its way.
constexpr std::chrono::milliseconds on_its_way{100};
// Whoever may publish here can invent keys: so many are passed on.
constexpr size_t car_limit = 4'096, host_limit = 512;
constexpr size_t sample_limit = size_t{1} << 20;     // bytes
constexpr size_t parts_limit = 64;                   // of a car's surface: one of 640,000 nodes has as many
constexpr size_t recording_limit = size_t{1} << 30;  // bytes: a page holds it whole
// Assets: those of the cars that live, and of those before them the newest few, for pages that are behind. Together they have
// so many bytes (one of 10,000 nodes has 4 MB), with control twice.
constexpr size_t spare_limit = 8, assets_limit = size_t{1} << 30;

struct WatchedCar {
  uint64_t life = 0;                // so that browsers know it from the next of its id
  uint64_t key_tick = 0, tick = 0;  // of the keyframe, and of the newest message, that were passed on
  std::string asset;                // of its keyframe
  std::set<uint32_t> parts = {};    // their first nodes: browsers keep the latest of each
  bool wanted = true;               // its keyframe
  uint64_t asking = 0;              // ticket; 0: none
  Clock::time_point asked{}, heard{};
  float peak = 0;           // impulse of the last hit, N s: the greatest of a tick
  Clock::time_point hit{};  // when the last contact was told
};

struct Fetched {
  uint64_t number = 0;  // in the order in which they were wanted
  size_t size = 0;
  std::shared_ptr<std::vector<uint8_t>> bytes;  // what has come; of a whole one only where it may be painted
  bool done = false;                            // whole, or there is no room for it
  uint64_t asking = 0;
  Clock::time_point asked{};
};

struct Gateway {
  Net* net = nullptr;
  Web* web = nullptr;
  std::string root;
  bool server = false;
  uint64_t lives = 0;  // the last one; browsers stay when a gateway is started again, so it counts from the time
  std::map<std::string, WatchedCar, std::less<>> cars;
  std::map<std::string, Fetched, std::less<>> assets;  // by hash
  uint64_t wanted = 0;                                 // assets so far
  Clock::time_point looked{};                          // for cars whose asset did not come
  std::set<std::string, std::less<>> hosts;            // keys of what they told
  bool late = false;                                   // what hosts told before is wanted
  uint64_t asking = 0;                                 // ticket of the question for it; 0: none
  Clock::time_point asked{};
  std::optional<Control> control;
  std::map<uint64_t, std::string> tickets;  // of questions: the id of a car, or the hash of an asset

  ~Gateway() {
    if (net) net_close(net);
    web_close(web);
  }
};

void need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
}

void set(Gateway& gateway, const std::string& key, std::span<const uint8_t> bytes) {
  need(web_set(gateway.web, key.c_str(), bytes.data(), bytes.size()));
}

void tell_alive(Gateway& gateway) {
  std::string lines = gateway.server ? "server\n" : "";
  for (const auto& [id, car] : gateway.cars) lines += "car " + id + " " + std::to_string(car.life) + "\n";
  set(gateway, "alive", {reinterpret_cast<const uint8_t*>(lines.data()), lines.size()});
}

void take_liveliness(Gateway& gateway, const Key& key, bool alive) {
  if (key.channel == Channel::server) {
    gateway.server = alive;
    gateway.hosts.clear();
    need(web_forget(gateway.web, "host/"));
    gateway.late = alive;
    gateway.asking = 0;
  } else if (key.channel == Channel::command) {
    const std::string id(key.id);
    gateway.cars.erase(id);
    need(web_forget(gateway.web, ("car/" + id + "/").c_str()));
    if (alive && gateway.cars.size() < car_limit) gateway.cars[id].life = ++gateway.lives;
  }
  tell_alive(gateway);
}

void ask_for_piece(Gateway& gateway, const std::string& hash, Fetched& asset) {
  const uint64_t offset = asset.size;
  asset.asked = Clock::now();
  if (net_get(gateway.net, (std::string(asset_root) + hash).c_str(), &offset, sizeof offset, asset_ms, &asset.asking) == 0)
    gateway.tickets[asset.asking] = hash;
}

// The oldest that no car is of.
void forget_assets(Gateway& gateway) {
  std::set<std::string_view> of_cars;
  for (const auto& [id, car] : gateway.cars) of_cars.insert(car.asset);
  std::map<uint64_t, std::string> spare;
  for (const auto& [hash, asset] : gateway.assets)
    if (!of_cars.contains(hash)) spare[asset.number] = hash;
  for (; spare.size() > spare_limit; spare.erase(spare.begin())) {
    const std::string& oldest = spare.begin()->second;
    gateway.assets.erase(oldest);
    need(web_forget(gateway.web, ("/asset/" + oldest).c_str()));
  }
}

Fetched& find_or_add_asset(Gateway& gateway, const std::string& hash) {
  const auto [at, is_new] = gateway.assets.try_emplace(hash);
  if (is_new) {
    at->second.number = ++gateway.wanted;
    forget_assets(gateway);
  }
  return at->second;
}

void want_asset(Gateway& gateway, const std::string& hash) {
  Fetched& asset = find_or_add_asset(gateway, hash);
  if (asset.done || asset.asking || Clock::now() - asset.asked < ask_again) return;
  asset.size = 0;
  asset.bytes = std::make_shared<std::vector<uint8_t>>();
  ask_for_piece(gateway, hash, asset);
}

bool has_room(const Gateway& gateway, size_t more) {
  for (const auto& [hash, asset] : gateway.assets) more += asset.size;
  return more <= assets_limit;
}

void show_asset(Gateway& gateway, const std::string& hash, Fetched& asset) {
  asset.size = asset.bytes->size();
  asset.done = true;
  need(web_page(gateway.web, ("/asset/" + hash).c_str(), "application/octet-stream", asset.bytes->data(), asset.size));
  if (!gateway.control) asset.bytes.reset();
}

// Painted here: browsers ask for it as soon as a car is made of it.
void take_painted(Gateway& gateway, const Car& car) {
  Fetched& asset = find_or_add_asset(gateway, car.hash);
  if (asset.done || !has_room(gateway, car.bytes.size())) return;
  const auto* bytes = reinterpret_cast<const uint8_t*>(car.bytes.data());
  asset.bytes = std::make_shared<std::vector<uint8_t>>(bytes, bytes + car.bytes.size());
  asset.asking = 0;
  show_asset(gateway, car.hash, asset);
}

void take_piece(Gateway& gateway, const std::string& hash, Fetched& asset, std::span<const uint8_t> piece) {
  asset.asking = 0;
  if (!has_room(gateway, piece.size())) {
    std::fprintf(stderr, "crumple view: asset %s is not shown: the cars of this scene have more than %zu MiB together\n",
                 hash.c_str(), assets_limit >> 20);
    asset.done = true;
    asset.size = 0;
    return asset.bytes.reset();
  }
  asset.bytes->insert(asset.bytes->end(), piece.begin(), piece.end());
  asset.size = asset.bytes->size();
  if (piece.size() == asset_piece) return ask_for_piece(gateway, hash, asset);
  const std::string digits = hash_of(asset.bytes->data(), asset.size);
  if (hash == digits) return show_asset(gateway, hash, asset);
  std::fprintf(stderr, "crumple view: the bytes of asset %s have the hash %s; it is asked for again\n", hash.c_str(),
               digits.c_str());
}

// Whoever may publish can invent parts, and each is kept.
bool is_part(WatchedCar& car, uint32_t first) {
  if (car.parts.size() < parts_limit) car.parts.insert(first);
  return car.parts.contains(first);
}

void take_keyframe(Gateway& gateway, const std::string& id, WatchedCar& car, std::span<const uint8_t> bytes) {
  const auto* message = verified<schema::Keyframe>(bytes);
  if (!message || message->tick() < car.key_tick || !is_part(car, message->first())) return;
  car.key_tick = message->tick();
  car.tick = std::max(car.tick, car.key_tick);
  if (message->count() == message->node_count()) car.wanted = false;
  const uint32_t first = message->first();
  set(gateway, "car/" + id + "/key/0" + (first > 0 ? "/" + std::to_string(first) : ""), bytes);
  if (!is_hash(message->asset()->string_view())) return;
  car.asset = message->asset()->str();
  want_asset(gateway, car.asset);
}

void take_delta(Gateway& gateway, const std::string& id, WatchedCar& car, std::span<const uint8_t> bytes) {
  const auto* message = verified<schema::Delta>(bytes);
  if (!message || !is_part(car, message->first())) return;
  if (message->keyframe() > car.key_tick) car.wanted = true;
  if (message->keyframe() != car.key_tick || message->tick() < car.tick) return;
  car.tick = message->tick();
  const uint32_t first = message->first();
  set(gateway, "car/" + id + "/delta/0" + (first > 0 ? "/" + std::to_string(first) : ""), bytes);
}

// A message a car: of one with many cars, the next, with others, would replace it. The strongest of a hit is kept beside the
// last: it says what the hit was, and is over before a slow browser looks.
void take_reactions(Gateway& gateway, std::span<const uint8_t> bytes) {
  const auto* message = verified<schema::Reactions>(bytes);
  if (!message) return;
  for (const auto* from : *message->cars()) {
    const auto at = gateway.cars.find(from->car()->string_view());
    if (at == gateway.cars.end()) continue;
    auto& [id, car] = *at;
    schema::ReactionsT one;
    one.tick = message->tick();
    one.time = message->time();
    one.cars.emplace_back(from->UnPack());
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(schema::Reactions::Pack(builder, &one));
    const std::span<const uint8_t> packed(builder.GetBufferPointer(), builder.GetSize());
    set(gateway, "car/" + id + "/reactions", packed);
    if (from->contacts() == 0) continue;
    if (Clock::now() - std::exchange(car.hit, Clock::now()) > hit_ends) car.peak = 0;
    const float impulse = std::hypot(from->impulse()->x(), from->impulse()->y(), from->impulse()->z());
    if (impulse <= car.peak) continue;
    car.peak = impulse;
    set(gateway, "car/" + id + "/peak", packed);
  }
}

void take_health(Gateway& gateway, std::span<const uint8_t> bytes) {
  const auto* message = verified<schema::Health>(bytes);
  if (!message) return;
  set(gateway, "health", bytes);
  if (!message->told()) return;
  for (const auto* told : *message->told()) {
    const auto at = gateway.cars.find(told->car()->string_view());
    if (at == gateway.cars.end() || told->ticks()->size() == 0) continue;
    WatchedCar& car = at->second;
    if (car.tick < told->ticks()->Get(0) && Clock::now() - car.heard > on_its_way) car.wanted = true;
  }
}

// Poses or obstacles: what browsers read without a check of their own is checked here.
void take_told(Gateway& gateway, Channel channel, std::string_view below, std::span<const uint8_t> bytes) {
  if (bytes.size() > sample_limit || (gateway.hosts.size() >= host_limit && !gateway.hosts.contains(below))) return;
  const bool good =
      channel == Channel::poses ? verified<schema::Poses>(bytes) != nullptr : verified<schema::Obstacles>(bytes) != nullptr;
  if (!good) return;
  gateway.hosts.emplace(below);
  set(gateway, std::string(below), bytes);
}

// below: the key below the scene's root, which `key` was parsed of.
void take_sample(Gateway& gateway, const Key& key, std::string_view below, std::span<const uint8_t> bytes) {
  if (key.channel == Channel::health) return take_health(gateway, bytes);
  if (key.channel == Channel::reactions) return take_reactions(gateway, bytes);
  if (key.channel == Channel::poses || key.channel == Channel::obstacles) return take_told(gateway, key.channel, below, bytes);
  if ((key.channel != Channel::keyframe && key.channel != Channel::delta) || key.number != 0) return;
  const auto at = gateway.cars.find(key.id);
  if (at == gateway.cars.end()) return;  // its token brings it, and the question for its keyframe
  at->second.heard = Clock::now();
  if (key.channel == Channel::keyframe)
    take_keyframe(gateway, at->first, at->second, bytes);
  else
    take_delta(gateway, at->first, at->second, bytes);
}

// Where hosts had cars and obstacles before this gateway began; what they have told since then stands.
void take_latest(Gateway& gateway, std::span<const uint8_t> bytes) {
  const auto* message = verified<schema::Inputs>(bytes);
  if (!message) return;
  gateway.late = false;
  for (const auto* input : *message->inputs()) {
    const std::string_view below = input->key()->string_view();
    const Channel channel = parse_key(below).value_or(Key{}).channel;
    if ((channel == Channel::poses || channel == Channel::obstacles) && !gateway.hosts.contains(below))
      take_told(gateway, channel, below, {input->payload()->data(), input->payload()->size()});
  }
}

void take_reply(Gateway& gateway, const NetEvent& event, std::span<const uint8_t> bytes) {
  if (gateway.control && gateway.control->take_reply(event)) return;
  if (event.ticket == gateway.asking) {
    if (event.kind == NET_REPLY_END) gateway.asking = 0;
    if (event.kind == NET_REPLY && !event.failed) take_latest(gateway, bytes);
    return;
  }
  const auto at = gateway.tickets.find(event.ticket);
  if (at == gateway.tickets.end()) return;
  const std::string name = at->second;
  const bool end = event.kind == NET_REPLY_END;
  if (end) gateway.tickets.erase(at);
  if (const auto asset = gateway.assets.find(name); asset != gateway.assets.end() && asset->second.asking == event.ticket) {
    if (end || event.failed)
      asset->second.asking = 0;
    else
      take_piece(gateway, name, asset->second, bytes);
  } else if (const auto car = gateway.cars.find(name); car != gateway.cars.end() && car->second.asking == event.ticket) {
    if (end)
      car->second.asking = 0;
    else if (!event.failed)
      take_keyframe(gateway, name, car->second, bytes);
  }
}

void take(Gateway& gateway, const NetEvent& event) {
  const std::span<const uint8_t> bytes(event.data, event.size);
  if (event.kind == NET_REPLY || event.kind == NET_REPLY_END) return take_reply(gateway, event, bytes);
  const std::string_view whole = event.key;
  const auto key = parse_key(whole, gateway.root);
  if (!key || key->channel == Channel::piece) return;
  if (event.kind == NET_SAMPLE)
    take_sample(gateway, *key, whole.substr(gateway.root.size()), bytes);
  else
    take_liveliness(gateway, *key, event.kind == NET_ALIVE);
}

void ask(Gateway& gateway) {
  const auto now = Clock::now();
  if (gateway.late && !gateway.asking && now - gateway.asked >= ask_again) {
    gateway.asked = now;
    need(net_get(gateway.net, (gateway.root + "inputs").c_str(), nullptr, 0, keyframe_ms, &gateway.asking));
  }
  const bool looks = now - gateway.looked >= ask_again;
  if (looks) gateway.looked = now;
  for (auto& [id, car] : gateway.cars) {
    if (looks && !car.asset.empty()) want_asset(gateway, car.asset);
    if (!car.wanted || car.asking || now - car.asked < ask_again) continue;
    car.asked = now;
    if (net_get(gateway.net, (gateway.root + "car/" + id + "/key/0").c_str(), nullptr, 0, keyframe_ms, &car.asking) == 0)
      gateway.tickets[car.asking] = id;
  }
}

// Once: who runs it sees that it is crowded, or attacked.
void tell_refused(const Web* web, bool& told) {
  if (told || web_refused(web) == 0) return;
  told = true;
  std::fprintf(stderr, "crumple view: connections are refused: at most 512 are let in at a time, 256 of one address\n");
}

void run(Gateway& gateway, const std::atomic<bool>& stop) {
  NetEvent events[64];
  bool told = false;
  while (!stop) {
    const int got = net_poll(gateway.net, events, 64, gateway.control ? 10'000 : 50'000);
    need(got);
    for (int i = 0; i < got; ++i) take(gateway, events[i]);
    ask(gateway);
    if (gateway.control) gateway.control->work();
    tell_refused(gateway.web, told);
  }
}

std::string read_page(std::string path) {
  if (path.empty()) path = std::filesystem::read_symlink("/proc/self/exe").parent_path() / "web" / "index.html";
  return read_file(path, text_limit, "`server/setup web` makes the page in build/web; --page FILE names another");
}

bool is_public(std::string_view address) {
  return !address.starts_with("127.") && !address.starts_with("localhost:") && !address.starts_with("[::1]");
}

// A server of its own for a recording.
struct Player {
  Net* net = nullptr;
  std::atomic<bool> stop{false};
  std::thread thread;

  void start(const ViewOptions& options) {
    need(net_open("peer", "tcp/127.0.0.1:0", nullptr, nullptr, 0, &net));
    thread = std::thread([this, &options] {
      try {
        ReplayOptions replay;
        replay.files = options.files;
        replay.speed = options.speed;
        replay.loop = true;
        play_films(net, replay, stop);
      } catch (const std::exception& error) {
        std::fprintf(stderr, "crumple view: %s\n", error.what());
      }
    });
  }
  ~Player() {
    stop = true;
    if (thread.joinable()) thread.join();
    if (net) net_close(net);
  }
};

// As a part of a URL.
std::string encoded(const std::string& text) {
  std::string out;
  for (const char c : text) {
    char digits[4];
    std::snprintf(digits, sizeof digits, "%%%02X", static_cast<unsigned char>(c));
    out += std::isalnum(static_cast<unsigned char>(c)) || std::strchr("-._", c) ? std::string(1, c) : digits;
  }
  return out;
}

// No server, no zenoh: the page reads both by itself.
void hand_out(Web* web, const ViewOptions& options, const std::atomic<bool>& stop) {
  std::string query;
  for (size_t i = 0; i < options.files.size(); ++i) {
    RecordingReader{options.files[i]};  // throws if it is none
    const std::string bytes = read_file(options.files[i], recording_limit, "a page shows shorter ones"),
                      path = "/recording/" + std::to_string(i);
    need(web_page(web, path.c_str(), "application/octet-stream", reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()));
    query += (i ? "&recording=" : "?recording=") + encoded(std::filesystem::path(options.files[i]).filename());
  }
  std::printf("%s and %s: open http://%s/%s in a browser\n", options.files[0].c_str(), options.files[1].c_str(),
              web_address(web), query.c_str());
  std::fflush(stdout);
  for (bool told = false; !stop; std::this_thread::sleep_for(std::chrono::milliseconds(50))) tell_refused(web, told);
}

}  // namespace

int view(const ViewOptions& options, const std::atomic<bool>& stop) {
  std::signal(SIGPIPE, SIG_IGN);  // a line that goes while something is written to it does not end the gateway
  const std::string page = read_page(options.page);
  Player player;
  Gateway gateway;
  gateway.lives = static_cast<uint64_t>(std::chrono::system_clock::now().time_since_epoch() / std::chrono::microseconds(1));
  std::string scene = options.scene, connect = options.connect;
  need(web_open(options.listen.c_str(), &gateway.web));
  need(web_page(gateway.web, "/", "text/html; charset=utf-8", page.data(), page.size()));
  const std::string parameters = parameters_json(options.control);
  need(web_page(gateway.web, "/parameters", "application/json", parameters.data(), parameters.size()));
  tell_alive(gateway);
  const std::string address = web_address(gateway.web);
  if (is_public(address))
    std::fprintf(stderr, "crumple view: whoever reaches %s %s this scene; --listen 127.0.0.1:8080 is for this machine only\n",
                 address.c_str(), options.control ? "commands" : "sees");
  if (options.files.size() > 1) return hand_out(gateway.web, options, stop), 0;
  if (!options.files.empty()) {
    scene = RecordingReader(options.files[0]).head().scene;
    player.start(options);
    connect = net_endpoint(player.net);
  }
  gateway.root = root_of(scene);
  const char* network = options.network.empty() ? nullptr : options.network.c_str();
  need(net_open("client", nullptr, connect.c_str(), network, connect_ms, &gateway.net));
  if (options.control) {
    const auto shown = [&gateway](const std::string& hash) -> Control::Bytes {
      const auto asset = gateway.assets.find(hash);
      return asset != gateway.assets.end() && asset->second.done ? asset->second.bytes : nullptr;
    };
    const auto painted = [&gateway](const Car& car) { take_painted(gateway, car); };
    gateway.control.emplace(gateway.net, gateway.web, gateway.root, shown, painted);
  }
  for (const char* key : {"car/*/key/0", "car/*/delta/0", "host/*/reactions"})
    need(net_subscribe(gateway.net, (gateway.root + key).c_str(), 4'096, sample_limit));
  for (const char* key : {"host/*/poses", "host/*/obstacles", "health"})
    need(net_subscribe(gateway.net, (gateway.root + key).c_str(), 0, sample_limit));
  for (const char* key : {"server", "car/*"}) need(net_watch(gateway.net, (gateway.root + key).c_str()));
  std::printf("scene %s of %s: open http://%s/ in a browser\n", scene.c_str(),
              options.files.empty() ? connect.c_str() : options.files[0].c_str(), address.c_str());
  std::fflush(stdout);
  run(gateway, stop);
  return 0;
}

}  // namespace crumple

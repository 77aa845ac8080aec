#include "gateway/hub.h"

#include <chrono>
#include <cmath>
#include <utility>

#include "gateway/need.h"
#include "protocol/message.h"
#include "protocol/surface_codec.h"
#include "schema/message_generated.h"

namespace crumple {
namespace {

constexpr std::chrono::milliseconds hit_ends{1000};  // after this long without a contact
// Anyone who may publish here can invent hosts and parts, and the hub keeps each.
constexpr size_t host_limit = 512;  // keys of hosts' messages that are passed on: a scene's 64 hosts have 128
constexpr size_t parts_limit = 64;  // parts of a car's surface: one of 640,000 nodes has this many

}  // namespace

Hub::Hub(Net* net, Web* web, std::string root, bool keeps_assets)
    : net_(net),
      web_(web),
      root_(std::move(root)),
      lives_(static_cast<uint64_t>(std::chrono::system_clock::now().time_since_epoch() / std::chrono::microseconds(1))),
      following_{root_, [this](const auto&... question) { return get(question...); }},
      assets_(
          web, [this](const auto&... question) { return get(question...); },
          [this] {
            ShownAssets::Hashes hashes;
            for (const auto& [id, car] : cars_) hashes.insert(car.asset);
            return hashes;
          },
          keeps_assets) {
  following_.level = 0;
}

void Hub::begin() {
  for (const char* key : {"car/*/key/0", "car/*/delta/0", "host/*/reactions"})
    need(net_subscribe(net_, (root_ + key).c_str(), viewer::samples_waiting, viewer::sample_limit));
  for (const char* key : {"host/*/poses", "host/*/obstacles"})
    need(net_subscribe_newest(net_, (root_ + key).c_str(), viewer::sample_limit, has_later_sequence));
  need(net_subscribe(net_, (root_ + "health").c_str(), 0, viewer::sample_limit));
  for (const char* key : {"server", "owner/*", "car/*"}) need(net_watch(net_, (root_ + key).c_str()));
}

uint64_t Hub::get(const std::string& key, std::span<const uint8_t> payload, std::chrono::milliseconds patience) const {
  uint64_t ticket = 0;
  const auto timeout = static_cast<uint32_t>(patience.count());
  return net_get(net_, key.c_str(), payload.data(), payload.size(), timeout, &ticket) == 0 ? ticket : 0;
}

void Hub::set(const std::string& key, std::span<const uint8_t> bytes) {
  need(web_set(web_, key.c_str(), bytes.data(), bytes.size()));
}

void Hub::tell_alive() {
  std::string lines = server_ ? "server\n" : "";
  for (const auto& [id, car] : cars_) lines += "car " + id + " " + std::to_string(car.life) + "\n";
  set("alive", {reinterpret_cast<const uint8_t*>(lines.data()), lines.size()});
}

void Hub::take_token(const Key& key, bool alive, viewer::Time now) {
  if (key.channel == Channel::server) {
    server_ = alive;
    hosts_.clear();
    need(web_forget(web_, "host/"));
    late_ = alive;
    asking_ = 0;
  } else if (key.channel == Channel::command) {
    const std::string id(key.id);
    cars_.erase(id);
    following_.forget(id);
    need(web_forget(web_, ("car/" + id + "/").c_str()));
    if (alive) following_.take_token(key, alive, now);
    if (following_.cars.contains(id)) cars_[id].life = ++lives_;
  } else {
    return following_.take_token(key, alive, now);
  }
  tell_alive();
}

void Hub::take_surface(const viewer::SurfaceNews& news, bool keyframe, std::span<const uint8_t> bytes, viewer::Time now) {
  if (!news.counts) return;
  const viewer::Surface& surface = news.car->surface;
  const std::string& id = *news.id;
  ShownCar& car = cars_.at(id);
  Bytes whole;
  if (keyframe && news.outcome.applied == viewer::Applied::whole && surface.key_tick < car.key_tick) {
    // Another owner lags behind the previous one. Browsers drop older ticks of a car, so it gets a new life.
    need(web_forget(web_, ("car/" + id + "/").c_str()));
    car = {++lives_};
    tell_alive();
    whole = encode_keyframe({surface.key_tick, surface.asset, surface.quantum}, surface.key, surface_node_limit).front();
    bytes = {reinterpret_cast<const uint8_t*>(whole.data()), whole.size()};
  }
  // Following has verified the bytes.
  const uint32_t first = keyframe ? flatbuffers::GetRoot<schema::Keyframe>(bytes.data())->first()
                                  : flatbuffers::GetRoot<schema::Delta>(bytes.data())->first();
  if (car.parts.size() < parts_limit) car.parts.insert(first);
  if (!car.parts.contains(first)) return;
  car.key_tick = surface.key_tick;
  set("car/" + id + (keyframe ? "/key/0" : "/delta/0") + (first > 0 ? "/" + std::to_string(first) : ""), bytes);
  if (!keyframe || !is_hash(surface.asset)) return;
  car.asset = surface.asset;
  assets_.want(car.asset, now);
}

// Each car gets a message of its own, because the next message, with other cars, would replace one with many cars. The
// strongest reaction of a hit is kept beside the last one: it shows what the hit was, and may be over before a slow browser
// looks.
void Hub::take_reactions(std::span<const uint8_t> bytes, viewer::Time now) {
  const auto* message = verified<schema::Reactions>(bytes);
  if (!message) return;
  for (const auto* from : *message->cars()) {
    const auto at = cars_.find(from->car()->string_view());
    if (at == cars_.end()) continue;
    auto& [id, car] = *at;
    schema::ReactionsT one;
    one.tick = message->tick();
    one.time = message->time();
    one.cars.emplace_back(from->UnPack());
    flatbuffers::FlatBufferBuilder builder;
    builder.Finish(schema::Reactions::Pack(builder, &one));
    const std::span<const uint8_t> packed(builder.GetBufferPointer(), builder.GetSize());
    set("car/" + id + "/reactions", packed);
    if (from->contacts() == 0) continue;
    if (now - std::exchange(car.hit, now) > hit_ends) car.peak = 0;
    const float impulse = std::hypot(from->impulse()->x(), from->impulse()->y(), from->impulse()->z());
    if (impulse <= car.peak) continue;
    car.peak = impulse;
    set("car/" + id + "/peak", packed);
  }
}

void Hub::take_health(std::span<const uint8_t> bytes, viewer::Time now) {
  const auto* message = verified<schema::Health>(bytes);
  if (!message) return;
  set("health", bytes);
  following_.take_health(*message, now);
}

// Takes poses or obstacles. Checks them, because browsers read them without checking.
void Hub::take_told(Channel channel, std::string_view below, std::span<const uint8_t> bytes) {
  if (bytes.size() > viewer::sample_limit || (hosts_.size() >= host_limit && !hosts_.contains(below))) return;
  const bool good =
      channel == Channel::poses ? verified<schema::Poses>(bytes) != nullptr : verified<schema::Obstacles>(bytes) != nullptr;
  if (!good) return;
  hosts_.emplace(below);
  set(std::string(below), bytes);
}

// below: the key below the scene's root, from which `key` was parsed.
void Hub::take_sample(const Key& key, std::string_view below, std::span<const uint8_t> bytes, viewer::Time now) {
  if (key.channel == Channel::health) return take_health(bytes, now);
  if (key.channel == Channel::reactions) return take_reactions(bytes, now);
  if (key.channel == Channel::poses || key.channel == Channel::obstacles) return take_told(key.channel, below, bytes);
  if (!cars_.contains(key.id)) return;  // wait for its token, after which its keyframe is asked for
  take_surface(following_.take_sample(key, bytes, now), key.channel == Channel::keyframe, bytes, now);
}

// Takes the hosts' messages from before this gateway started. Messages received since then stay.
void Hub::take_latest(std::span<const uint8_t> bytes) {
  const auto* message = verified<schema::Inputs>(bytes);
  if (!message) return;
  late_ = false;
  for (const auto* input : *message->inputs()) {
    const std::string_view below = input->key()->string_view();
    const Channel channel = parse_key(below).value_or(Key{}).channel;
    if ((channel == Channel::poses || channel == Channel::obstacles) && !hosts_.contains(below))
      take_told(channel, below, {input->payload()->data(), input->payload()->size()});
  }
}

void Hub::take_reply(const NetEvent& event, viewer::Time now) {
  const std::span<const uint8_t> bytes(event.data, event.size);
  const bool end = event.kind == NET_REPLY_END;
  if (event.ticket == asking_) {
    if (end) asking_ = 0;
    if (!end && !event.failed) take_latest(bytes);
  } else if (!assets_.take_reply(event, now)) {
    if (end) return following_.end(event.ticket);
    take_surface(following_.take_reply(event.ticket, bytes, event.failed != 0, now), true, bytes, now);
  }
}

void Hub::take(const NetEvent& event, viewer::Time now) {
  if (event.kind == NET_REPLY || event.kind == NET_REPLY_END) return take_reply(event, now);
  const std::string_view whole = event.key;
  const auto key = parse_key(whole, root_);
  if (!key || key->channel == Channel::piece) return;
  if (event.kind == NET_SAMPLE)
    take_sample(*key, whole.substr(root_.size()), {event.data, event.size}, now);
  else
    take_token(*key, event.kind == NET_ALIVE, now);
}

void Hub::ask(viewer::Time now) {
  if (late_ && !asking_ && now - asked_ >= viewer::ask_again) {
    asked_ = now;
    asking_ = get(root_ + "inputs", {}, viewer::keyframe_patience);
  }
  following_.ask_due(now);
  if (now - looked_ < viewer::ask_again) return;
  looked_ = now;
  for (const auto& [id, car] : cars_)
    if (!car.asset.empty()) assets_.want(car.asset, now);
}

}  // namespace crumple

#include "recording/playback.h"

#include <chrono>
#include <cstdio>
#include <map>
#include <optional>
#include <stdexcept>

#include "protocol/surface_codec.h"
#include "recording/answer.h"
#include "recording/recording.h"
#include "schema/message_generated.h"
#include "viewer/surface.h"

namespace crumple {
namespace {

using Clock = std::chrono::steady_clock;

struct Playback {
  Playback(const std::string& path, Net* session) : file(path), net(session), root(root_of(file.head().scene)) {
    net_announce(net, (root + "server").c_str());
  }
  // To viewers the next showing looks like another server: its ticks start again.
  ~Playback() {
    for (const auto& [car, surfaces] : cars) net_retract(net, (root + car).c_str());
    net_retract(net, (root + "server").c_str());
  }
  Playback(const Playback&) = delete;
  Playback& operator=(const Playback&) = delete;

  RecordingReader file;
  Net* net;
  std::string root;
  // By "car/{id}": the surface that viewers hold now, per surface level.
  std::map<std::string, std::array<viewer::Surface, surface_levels.size()>, std::less<>> cars;
  std::string despawning;  // car with a Despawn command that has no Answer yet
  LatestInputs latest;
};

void refuse(Playback& playback, const NetEvent& query, const std::string& sentence) {
  net_reply(playback.net, query.ticket, sentence.data(), sentence.size(), 1);
}

// Answers with the keyframe to which the next deltas refer, in one part.
void answer_keyframe(Playback& playback, const NetEvent& query, const Key& key) {
  const auto car = playback.cars.find("car/" + std::string(key.id));
  if (car == playback.cars.end() || car->second[key.number].key.empty())
    return refuse(playback, query, "car " + std::string(key.id) + " does not live at this point of the recording");
  const viewer::Surface& surface = car->second[key.number];
  const auto parts = encode_keyframe({surface.key_tick, surface.asset, surface.quantum}, surface.key,
                                     static_cast<uint32_t>(surface.key.size() / 3));
  net_reply(playback.net, query.ticket, parts.front().data(), parts.front().size(), 0);
}

void answer_until(Playback& playback, Clock::time_point due, const std::atomic<bool>& stop) {
  NetEvent events[64];
  for (;;) {
    const auto left = std::chrono::duration_cast<std::chrono::microseconds>(due - Clock::now());
    if (left.count() <= 0 || stop) return;
    const int got = net_poll(playback.net, events, 64, static_cast<uint64_t>(left.count()));
    if (got < 0) throw std::runtime_error(transport_error());
    for (int i = 0; i < got; ++i) {
      if (events[i].kind != NET_QUERY) continue;
      const Key key = parse_key(events[i].key, playback.root).value_or(Key{});
      if (key.channel == Channel::piece)
        answer_asset(playback.net, events[i], key.id, playback.file.cars());
      else if (key.channel == Channel::latest)
        playback.latest.answer(playback.net, events[i].ticket);
      else if (key.channel == Channel::keyframe)
        answer_keyframe(playback, events[i], key);
      else
        refuse(playback, events[i],
               "the recording of scene " + playback.file.head().scene + " does not answer key " + printable(events[i].key));
    }
  }
}

// Follows the state of the cars, and announces to viewers which cars live.
void follow(Playback& playback, const RecordingReader::Item& item) {
  if (item.channel == Channel::keyframe || item.channel == Channel::delta) {
    const std::string car(item.key.substr(0, item.key.find('/', 4)));
    const auto [at, fresh] = playback.cars.try_emplace(car);
    viewer::Surface& surface = at->second[item.level];
    static_cast<void>(item.channel == Channel::keyframe ? viewer::apply_keyframe(item.bytes, surface)
                                                        : viewer::apply_delta(item.bytes, surface));
    if (fresh) net_announce(playback.net, (playback.root + car).c_str());
  } else if (item.channel == Channel::command) {
    flatbuffers::Verifier verifier(item.bytes.data(), item.bytes.size());
    if (verifier.VerifyBuffer<schema::Command>(nullptr) &&
        flatbuffers::GetRoot<schema::Command>(item.bytes.data())->order_type() == schema::Order::Despawn)
      playback.despawning = item.key;
  } else if (item.channel == Channel::answer && item.key == playback.despawning + "/answer") {
    flatbuffers::Verifier verifier(item.bytes.data(), item.bytes.size());
    if (verifier.VerifyBuffer<schema::Answer>(nullptr) && flatbuffers::GetRoot<schema::Answer>(item.bytes.data())->ok() &&
        playback.cars.erase(playback.despawning) > 0)
      net_retract(playback.net, (playback.root + playback.despawning).c_str());
    playback.despawning.clear();
  }
}

void show(const std::string& path, const ReplayOptions& options, Net* net, const std::atomic<bool>& stop) {
  Playback playback(path, net);
  const auto begun = Clock::now();
  std::optional<uint64_t> first;
  for (RecordingReader::Item item; !stop && playback.file.next(item);) {
    if (!first) first = item.time_ns;
    const double at = 1e-9 * static_cast<double>(item.time_ns - std::min(item.time_ns, *first));
    follow(playback, item);
    // Obstacles stay until the next ones come, so earlier ones are published too.
    const bool shown = item.channel == Channel::reactions || item.channel == Channel::keyframe ||
                       item.channel == Channel::delta || item.channel == Channel::health || item.channel == Channel::poses;
    if (item.channel != Channel::obstacles && (!shown || at < options.from)) continue;
    const double wait = std::max(0.0, at - options.from) / options.speed;
    answer_until(playback, begun + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(wait)), stop);
    net_put(net, (playback.root + std::string(item.key)).c_str(), item.bytes.data(), item.bytes.size(), NET_DATA);
    const auto bytes = std::as_bytes(item.bytes);
    if (item.channel == Channel::poses || item.channel == Channel::obstacles)
      playback.latest.keep({std::string(item.key), {bytes.begin(), bytes.end()}});
  }
}

}  // namespace

void play_recordings(Net* net, const ReplayOptions& options, const std::atomic<bool>& stop) {
  net_queryable(net, "crumple/1/*/car/*/key/*", 1'000, question_limit);
  net_queryable(net, "crumple/1/asset/*", 1'000, question_limit);
  net_queryable(net, "crumple/1/*/inputs", 1'000, question_limit);
  do
    for (const std::string& path : options.files) show(path, options, net, stop);
  while (options.loop && !stop);
}

void serve_playback(const ReplayOptions& options, const std::atomic<bool>& stop) {
  Net* net = nullptr;
  const char* network = options.network.empty() ? nullptr : options.network.c_str();
  if (net_open("peer", options.listen.c_str(), nullptr, network, 0, &net) < 0) throw std::runtime_error(transport_error());
  const std::unique_ptr<Net, void (*)(Net*)> close(net, net_close);
  for (const std::string& path : options.files)
    std::printf("%s: scene %s at %s, speed %g\n", path.c_str(), RecordingReader(path).head().scene.c_str(), net_endpoint(net),
                options.speed);
  std::fflush(stdout);
  play_recordings(net, options, stop);
}

}  // namespace crumple

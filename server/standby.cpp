#include "standby.h"

#include <charconv>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <deque>
#include <random>
#include <stdexcept>

#include "answer.h"
#include "recording.h"
#include "schema/message_generated.h"
#include "snapshot.h"

namespace crumple {
namespace {

using Clock = std::chrono::steady_clock;

constexpr uint32_t inputs_depth = 4096;                // ticks that may wait while the world is fetched: a minute
constexpr std::chrono::milliseconds first_look{1000};  // at the start: no owner is seen within this, so there is none
constexpr std::chrono::milliseconds precedence{2000};  // that another, whose id is lower, has to take over before this one
constexpr std::chrono::milliseconds ask_again{500};    // after an answer that did not come
constexpr uint32_t answer_ms = 2000;

void need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
}

struct Standby {
  Net* net;
  const StandbyOptions& options;
  World& world;
  std::set<Owner> owners;
  std::set<std::string> others;                     // that stand by as well
  std::deque<std::vector<std::byte>> waiting = {};  // Inputs
  bool same = false;                                // the world is the owner's, as of its tick
  uint64_t epoch = 0;                               // the latest seen
  Clock::time_point alone = Clock::now();           // since when no owner is seen
  uint64_t asking = 0;                              // ticket; 0: none
  Clock::time_point ask_at{};
  std::vector<std::byte> pieces = {};
  uint64_t followed = 0;  // ticks
};

const schema::Inputs* inputs_of(const std::vector<std::byte>& bytes) {
  flatbuffers::Verifier verifier(reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size());
  return verifier.VerifyBuffer<schema::Inputs>(nullptr) ? flatbuffers::GetRoot<schema::Inputs>(bytes.data()) : nullptr;
}

void ask_for_world(Standby& standby, uint64_t offset) {
  if (offset == 0) standby.pieces.clear();
  need(net_get(standby.net, (standby.options.root + "replica/world").c_str(), &offset, sizeof offset, answer_ms,
               &standby.asking));
}

void take_world(Standby& standby, const NetEvent& event) {
  if (event.failed) return;
  const auto* bytes = reinterpret_cast<const std::byte*>(event.data);
  standby.pieces.insert(standby.pieces.end(), bytes, bytes + event.size);
  if (event.size == asset_piece) return ask_for_world(standby, standby.pieces.size());
  load_world(standby.pieces, standby.world);
  standby.pieces = {};
  standby.asking = 0;
  standby.same = true;
  std::printf("stands by: holds the world of tick %llu, %zu cars\n", static_cast<unsigned long long>(tick_count(standby.world)),
              cars(standby.world).size());
  std::fflush(stdout);
}

// Makes the ticks whose inputs are there. One that is missing, or that comes out otherwise, means to begin anew.
void follow(Standby& standby) {
  Outbox unheard;
  while (standby.same && !standby.waiting.empty()) {
    const schema::Inputs* inputs = inputs_of(standby.waiting.front());
    const uint64_t next = tick_count(standby.world) + 1;
    if (inputs && inputs->tick() >= next) {
      bool same = inputs->tick() == next;
      if (same) {
        Inbox inbox;
        for (const auto* input : *inputs->inputs()) {
          const auto* data = reinterpret_cast<const std::byte*>(input->payload()->data());
          // Any ticket will do: it only asks for an answer.
          inbox.push_back({input->key()->str(), {data, data + input->payload()->size()}, input->is_query() ? 1u : 0u});
        }
        tick(standby.world, inbox, unheard, standby.options.threads);
        same = hash(standby.world) == inputs->hash();
      }
      if (!same) {
        std::fprintf(stderr, "crumple serve: out of step with the owner at its tick %llu: asks for its world again\n",
                     static_cast<unsigned long long>(inputs->tick()));
        standby.same = false;
      } else {
        ++standby.followed;
      }
    }
    standby.waiting.pop_front();
  }
}

void take_token(Standby& standby, std::string_view key, bool alive) {
  if (const auto owner = owner_of(key)) {
    if (alive) {
      standby.owners.insert(*owner);
      standby.epoch = std::max(standby.epoch, owner->epoch);
      standby.same = false;  // of an owner that is new nothing is known
    } else {
      standby.owners.erase(*owner);
    }
    if (standby.owners.empty()) standby.alone = Clock::now();
  } else if (key.starts_with("standby/")) {
    const std::string id(key.substr(8));
    alive ? (void)standby.others.insert(id) : (void)standby.others.erase(id);
  }
}

void take(Standby& standby, const NetEvent& event) {
  std::string_view key = event.key ? event.key : "";
  if (event.kind == NET_REPLY && event.ticket == standby.asking) return take_world(standby, event);
  if (event.kind == NET_REPLY_END && event.ticket == standby.asking) {
    standby.asking = 0;
    standby.ask_at = Clock::now() + ask_again;
  }
  if (!key.starts_with(standby.options.root)) return;
  key.remove_prefix(standby.options.root.size());
  if (event.kind == NET_SAMPLE) {
    const auto* bytes = reinterpret_cast<const std::byte*>(event.data);
    standby.waiting.emplace_back(bytes, bytes + event.size);
  } else if (event.kind == NET_ALIVE || event.kind == NET_GONE) {
    take_token(standby, key, event.kind == NET_ALIVE);
  }
}

bool takes_over(const Standby& standby) {
  if (!standby.owners.empty()) return false;
  const auto alone = Clock::now() - standby.alone;
  const bool first = standby.others.empty() || standby.options.id <= *standby.others.begin();
  return alone >=
         (first ? std::chrono::milliseconds(0) : precedence) + (standby.epoch == 0 ? first_look : std::chrono::milliseconds(0));
}

}  // namespace

std::string token_of(const Owner& owner) { return "owner/" + std::to_string(owner.epoch) + "-" + owner.id; }

std::optional<Owner> owner_of(std::string_view key) {
  if (!key.starts_with("owner/")) return std::nullopt;
  key.remove_prefix(6);
  Owner owner;
  const auto [end, error] = std::from_chars(key.data(), key.data() + key.size(), owner.epoch);
  if (error != std::errc() || end == key.data() + key.size() || *end != '-') return std::nullopt;
  owner.id = key.substr(size_t(end - key.data()) + 1);
  return owner;
}

std::string random_id() {
  std::random_device device;
  char digits[17];
  std::snprintf(digits, sizeof digits, "%08x%08x", device(), device());
  return digits;
}

Message inputs_message(uint64_t tick, const Inbox& inbox, uint64_t hash) {
  flatbuffers::FlatBufferBuilder builder;
  std::vector<flatbuffers::Offset<schema::Input>> list;
  for (const Message& message : inbox) {
    if (!is_input(channel_of(message.key))) continue;
    const auto payload = builder.CreateVector(reinterpret_cast<const uint8_t*>(message.bytes.data()), message.bytes.size());
    list.push_back(schema::CreateInput(builder, builder.CreateString(message.key), payload, message.ticket != 0));
  }
  builder.Finish(schema::CreateInputsDirect(builder, tick, &list, hash));
  const auto* data = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return {"replica/inputs", {data, data + builder.GetSize()}};
}

void WorldAnswers::answer(Net* net, const NetEvent& query, const World& world) {
  uint64_t offset = 0;
  if (query.size == sizeof offset) std::memcpy(&offset, query.data, sizeof offset);
  if (offset == 0) snapshot_ = save_world(world);
  const std::span rest = std::span(snapshot_).subspan(std::min<size_t>(offset, snapshot_.size()));
  const auto piece = rest.first(std::min(rest.size(), asset_piece));
  net_reply(net, query.ticket, piece.data(), piece.size(), 0);
  if (piece.size() < asset_piece) snapshot_ = {};
}

std::optional<uint64_t> stand_by(Net* net, const StandbyOptions& options, World& world, const std::atomic<bool>& stop) {
  Standby standby{net, options, world, {}, {}};
  need(net_subscribe(net, (options.root + "replica/inputs").c_str(), inputs_depth));
  for (const char* what : {"owner/*", "standby/*"}) need(net_watch(net, (options.root + what).c_str()));
  need(net_announce(net, (options.root + "standby/" + options.id).c_str()));
  while (!stop) {
    NetEvent events[64];
    const int got = net_poll(net, events, 64, 50'000);
    need(got);
    for (int k = 0; k < got; ++k) take(standby, events[k]);
    follow(standby);
    if (takes_over(standby)) break;
    if (!standby.same && !standby.asking && !standby.owners.empty() && Clock::now() >= standby.ask_at)
      ask_for_world(standby, 0);
  }
  if (stop) return std::nullopt;
  need(net_retract(net, (options.root + "standby/" + options.id).c_str()));
  if (standby.epoch > 0) {
    std::printf("takes over at tick %llu, %zu cars, after %llu ticks beside the owner%s\n",
                static_cast<unsigned long long>(tick_count(world)), cars(world).size(),
                static_cast<unsigned long long>(standby.followed),
                standby.same ? "" : "; it did not hold the owner's last ticks");
    std::fflush(stdout);
  }
  return standby.epoch + 1;
}

}  // namespace crumple

#include "service/standby.h"

#include <algorithm>
#include <charconv>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <deque>
#include <set>
#include <stdexcept>
#include <utility>

#include "protocol/key.h"
#include "recording/answer.h"
#include "recording/recording.h"
#include "schema/message_generated.h"
#include "service/owner.h"
#include "tick/hash.h"
#include "tick/snapshot.h"

namespace crumple {
namespace {

using Clock = std::chrono::steady_clock;

constexpr uint32_t inputs_depth = 4096;                 // ticks that may wait while the world is fetched: one minute
constexpr size_t inputs_size_limit = size_t{64} << 20;  // bytes of one tick's inputs: the most that a message may have
constexpr size_t ticks_at_once = 256;                   // ticks computed between two looks at the network while catching up
constexpr std::chrono::seconds first_look{2};           // if no owner is seen this long after the link comes up, there is none
constexpr std::chrono::seconds precedence{2};           // time that each standby before this one has to take over
constexpr ptrdiff_t turns_most = 3;                     // most turns to wait: strangers' tokens must not delay it for long
constexpr std::chrono::milliseconds settling{200};      // until it is clear whether the owner or the own link is gone
constexpr std::chrono::seconds pause_least{1}, pause_most{60};  // before it asks for the world again
constexpr uint64_t calm_ticks = 600;                            // after this many ticks in step the pause is short again
// Bytes of the waiting ticks, and of the fetched world: 1,000 damaged cars of 4,642 nodes have 1 GB.
constexpr size_t waiting_limit = size_t{256} << 20, world_limit = size_t{2} << 30;
// Bytes: half of the 16 batches that zenoh queues per link. A router with TLS sends and receives on one thread: while it waits
// for room in a queue it cannot send, and it closes a link after a second without messages.
constexpr size_t world_piece = size_t{512} << 10;
constexpr size_t servers_limit = 64;    // tokens of owners, and of standbys, in one scene
constexpr uint32_t answer_ms = 30'000;  // for one piece: needs 1.2 Mb/s
// For the owner:
constexpr std::chrono::seconds snapshot_kept{60}, snapshot_pause{1};
constexpr size_t snapshots_most = 4;

void need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
}

struct Standby {
  Net* net;
  const StandbyOptions& options;
  World& world;
  std::set<Owner> owners = {};
  std::set<std::string> tokens = {};                // tokens of all standbys, including this one
  std::string token = {};                           // rank 0 if it holds the owner's world, else 1; the lowest token takes over
  std::deque<std::vector<std::byte>> waiting = {};  // Inputs
  size_t waiting_bytes = 0;                         // total size of `waiting`
  bool same = false;                                // the world is the owner's, at the tick it has
  uint64_t epoch = 0;                               // latest epoch seen
  bool linked = false;                              // an owner was seen over the present link
  Clock::time_point alone = Clock::now();           // since then no owner is seen
  uint64_t asking = 0;                              // ticket of the question; 0: none
  uint64_t asker = 0;
  Clock::time_point ask_at{};
  Clock::duration pause = pause_least;
  std::vector<std::byte> pieces = {};
  uint64_t followed = 0;  // ticks computed since the world arrived
};

// The token says whether this server holds the world: servers with the world come before servers without it.
void announce(Standby& standby) {
  const std::string token = standby_key(standby.same ? 0 : 1, standby.options.id);
  if (token == standby.token) return;
  const std::string& root = standby.options.root;
  if (!standby.token.empty()) need(net_retract(standby.net, (root + standby.token).c_str()));
  standby.token = token;
  need(net_announce(standby.net, (root + token).c_str()));
}

void ask_for_world(Standby& standby, uint64_t offset) {
  if (offset == 0) {
    standby.pieces.clear();
    standby.waiting.clear();  // the snapshot contains them
    standby.waiting_bytes = 0;
    ++standby.asker;
  }
  const auto question = world_question(offset, standby.asker);
  need(net_get(standby.net, (standby.options.root + "replica/world").c_str(), question.data(), question.size(), answer_ms,
               &standby.asking));
}

void ask_later(Standby& standby) {
  standby.ask_at = Clock::now() + standby.pause;
  standby.pause = std::min<Clock::duration>(2 * standby.pause, pause_most);
}

void give_up_fetching(Standby& standby, const std::string& why) {
  std::fprintf(stderr, "crumple serve: this standby cannot load the owner's world: %s; it will ask again\n", why.c_str());
  standby.asking = 0;
  standby.pieces = {};
  ask_later(standby);
}

void take_world(Standby& standby, const NetEvent& event) {
  if (event.failed)
    return give_up_fetching(standby, {reinterpret_cast<const char*>(event.data), std::min<size_t>(event.size, 500)});
  if (standby.pieces.size() + event.size > world_limit) return give_up_fetching(standby, "it has more than 2 GiB");
  const auto* bytes = reinterpret_cast<const std::byte*>(event.data);
  standby.pieces.insert(standby.pieces.end(), bytes, bytes + event.size);
  if (event.size == world_piece) return ask_for_world(standby, standby.pieces.size());
  try {
    load_world(standby.pieces, standby.world);
  } catch (const std::runtime_error& error) {
    return give_up_fetching(standby, error.what());
  }
  standby.pieces = {};
  standby.asking = 0;
  standby.same = true;
  standby.followed = 0;
  std::printf("stands by: holds the world of tick %llu, %zu cars\n", static_cast<unsigned long long>(tick_count(standby.world)),
              cars(standby.world).size());
  std::fflush(stdout);
}

// If the standby has not computed this tick, it later finds it missing and asks for the world again.
void forget_oldest(Standby& standby) {
  standby.waiting_bytes -= standby.waiting.front().size();
  standby.waiting.pop_front();
}

// Computes the ticks whose inputs have arrived. If a tick is missing or its hash differs, asks for the whole world again.
void follow(Standby& standby) {
  Outbox unheard;
  for (size_t k = 0; k < ticks_at_once && standby.same && !standby.waiting.empty(); ++k) {
    const auto inputs = read_inputs(standby.waiting.front());
    const uint64_t next = tick_count(standby.world) + 1;
    if (inputs && inputs->tick >= next) {
      bool same = inputs->tick == next;
      if (same) {
        tick(standby.world, inputs->inbox, unheard, standby.options.threads);
        same = hash(standby.world) == inputs->hash;
      }
      if (!same) {
        std::fprintf(stderr,
                     "crumple serve: this standby differs from the owner at tick %llu: it asks for the owner's world again\n",
                     static_cast<unsigned long long>(inputs->tick));
        standby.same = false;
        ask_later(standby);
      } else if (++standby.followed == calm_ticks) {
        standby.pause = pause_least;
      }
    }
    forget_oldest(standby);
  }
}

void take_token(Standby& standby, const Key& key, bool alive) {
  if (key.channel == Channel::owner) {
    const Owner owner{key.number, std::string(key.id)};
    if (!alive) {
      standby.owners.erase(owner);
    } else if (standby.owners.size() < servers_limit && standby.owners.insert(owner).second) {
      standby.epoch = std::max(standby.epoch, owner.epoch);
      standby.same = false;  // nothing is known of a new owner's world
    }
    if (standby.owners.empty()) standby.alone = Clock::now();
  } else if (key.channel == Channel::standby) {
    const std::string token = standby_key(key.number, key.id);
    if (!alive)
      standby.tokens.erase(token);
    else if (standby.tokens.size() < servers_limit)
      standby.tokens.insert(token);
  }
}

void take(Standby& standby, const NetEvent& event) {
  if (event.kind == NET_REPLY && event.ticket == standby.asking) return take_world(standby, event);
  if (event.kind == NET_REPLY_END && event.ticket == standby.asking) {
    standby.asking = 0;  // the question ended without an answer
    ask_later(standby);
  }
  const Key key = parse_key(event.key, standby.options.root).value_or(Key{});
  if (event.kind == NET_SAMPLE && key.channel == Channel::replica_inputs) {
    const auto* bytes = reinterpret_cast<const std::byte*>(event.data);
    standby.waiting.emplace_back(bytes, bytes + event.size);
    standby.waiting_bytes += event.size;
    while (standby.waiting_bytes > waiting_limit || (!standby.same && standby.waiting.size() > inputs_depth))
      forget_oldest(standby);
  } else if (event.kind == NET_ALIVE || event.kind == NET_GONE) {
    take_token(standby, key, event.kind == NET_ALIVE);
  }
}

bool takes_over(Standby& standby) {
  if (!standby.owners.empty()) {
    standby.linked = true;
    return false;
  }
  // While this server's link is down, everybody seems gone: start over when it is up.
  if (net_connected(standby.net) != 1) {
    standby.alone = Clock::now();
    standby.linked = false;
    return false;
  }
  const auto before = std::distance(standby.tokens.begin(), standby.tokens.lower_bound(standby.token));
  Clock::duration wait = settling + precedence * std::min<ptrdiff_t>(before, turns_most);
  if (!standby.linked) wait += first_look;
  if (standby.epoch > 0 && !standby.same) wait += precedence;
  return Clock::now() - standby.alone >= wait;
}

}  // namespace

std::vector<std::byte> world_question(uint64_t offset, uint64_t asker) {
  std::vector<std::byte> out(2 * sizeof(uint64_t) + std::strlen(program_name));
  std::memcpy(out.data(), &offset, sizeof offset);
  std::memcpy(out.data() + sizeof offset, &asker, sizeof asker);
  std::memcpy(out.data() + 2 * sizeof(uint64_t), program_name, std::strlen(program_name));
  return out;
}

void WorldAnswers::answer(Net* net, const NetEvent& query, const World& world) {
  const auto refuse = [&](const std::string& sentence) { net_reply(net, query.ticket, sentence.data(), sentence.size(), 1); };
  const auto now = Clock::now();
  uint64_t offset = 0, asker = 0;
  if (query.size < sizeof offset + sizeof asker) return refuse("this query for the owner's world is too short");
  std::memcpy(&offset, query.data, sizeof offset);
  std::memcpy(&asker, query.data + sizeof offset, sizeof asker);
  const std::string program(reinterpret_cast<const char*>(query.data) + 2 * sizeof(uint64_t),
                            query.size - 2 * sizeof(uint64_t));
  if (program != program_name)
    return refuse(std::string("the owner runs ") + program_name + ": start the standby with the same program");
  std::erase_if(snapshots_, [&](const auto& each) { return now - each.second.asked > snapshot_kept; });
  if (offset == 0) {
    if (now - last_ < snapshot_pause || snapshots_.size() >= snapshots_most)
      return refuse("the owner was asked for its world just now: ask again later");
    last_ = now;
    snapshots_[asker] = {now, save_world(world)};
  }
  const auto found = snapshots_.find(asker);
  if (found == snapshots_.end() || offset > found->second.bytes.size())
    return refuse("the owner no longer has this snapshot of its world: ask for a new one");
  found->second.asked = now;
  const std::span rest = std::span(found->second.bytes).subspan(offset);
  const auto piece = rest.first(std::min(rest.size(), world_piece));
  net_reply(net, query.ticket, piece.data(), piece.size(), 0);
  if (piece.size() < world_piece) snapshots_.erase(found);
}

std::optional<uint64_t> stand_by(Net* net, const StandbyOptions& options, World& world, const std::atomic<bool>& stop) {
  Standby standby{net, options, world};
  standby.asker = std::hash<std::string>()(options.id);
  need(net_subscribe(net, (options.root + "replica/inputs").c_str(), inputs_depth, inputs_size_limit));
  for (const char* what : {"owner/*", "standby/*"}) need(net_watch(net, (options.root + what).c_str()));
  for (auto looked = Clock::now(); !stop;) {
    announce(standby);
    NetEvent events[64];
    const int got = net_poll(net, events, 64, standby.same && !standby.waiting.empty() ? 0 : 50'000);
    need(got);
    if (const auto before = std::exchange(looked, Clock::now()); looked - before > longest_blink) standby.alone = looked;
    for (int k = 0; k < got; ++k) take(standby, events[k]);
    follow(standby);
    if (takes_over(standby)) break;
    if (!standby.same && !standby.asking && !standby.owners.empty() && Clock::now() >= standby.ask_at)
      ask_for_world(standby, 0);
  }
  if (stop) return std::nullopt;
  // Announce first: as soon as this standby's token is gone, the next standby would take over.
  const uint64_t epoch = std::min(standby.epoch, epoch_limit - 1) + 1;
  need(net_announce(net, (options.root + owner_key(epoch, options.id)).c_str()));
  need(net_retract(net, (options.root + standby.token).c_str()));
  if (standby.epoch > 0) {
    std::printf("takes over at tick %llu, %zu cars, after %llu ticks beside the owner%s\n",
                static_cast<unsigned long long>(tick_count(world)), cars(world).size(),
                static_cast<unsigned long long>(standby.followed),
                standby.same ? "" : "; it did not hold the owner's last ticks");
    std::fflush(stdout);
  }
  return epoch;
}

}  // namespace crumple

#include "tick/inbox.h"

#include <algorithm>
#include <stdexcept>

#include "protocol/asset.h"
#include "tick/commands.h"
#include "tick/health.h"
#include "tick/state.h"
#include "tick/uploads.h"
#include "wire/encode.h"

namespace crumple {
namespace {

Refusal stale(const char* what, uint64_t sequence, uint64_t last) {
  return {Reason::stale_sequence, std::string(what) + ": sequence is " + std::to_string(sequence) + "; above " +
                                      std::to_string(last) +
                                      " is allowed (a host that starts anew may count from the time in microseconds)"};
}

// Checks the host before it decodes anything: a message from an invented host costs only a look-up of its name.
std::optional<Refusal> take_poses(World& world, const std::string& host_id, const Bytes& bytes) {
  const auto found = world.hosts.find(host_id);
  if (found == world.hosts.end()) {
    return Refusal{Reason::unknown_host, "poses: host " + host_id + " has no car here; spawn one that names it first"};
  }
  Intents intents;
  if (std::optional<Refusal> refusal = decode(bytes, world.limits, intents)) return refusal;
  Host& host = found->second;
  if (host.poses_sequence && intents.sequence <= *host.poses_sequence) {
    return stale("poses", intents.sequence, *host.poses_sequence);
  }
  host.poses_sequence = intents.sequence;
  for (Intent& intent : intents.cars) {
    const auto car = world.cars.find(intent.car);
    if (car == world.cars.end()) {
      count(world,
            {Reason::unknown_car, "poses: car " + intent.car + " of host " + host_id + " does not live here; spawn it first"});
    } else if (car->second.host != host_id) {
      count(world, {Reason::not_owner,
                    "poses: car " + intent.car + " belongs to host " + car->second.host + ", not to host " + host_id});
    } else {
      car->second.idle = false;
      car->second.importance = intent.importance;
      car->second.intent = std::move(intent);
    }
  }
  return std::nullopt;
}

// Replaces the host's part of the list of all obstacles.
void replace_obstacles(World& world, const Host& of, std::vector<Obstacle>&& obstacles) {
  ptrdiff_t first = 0;
  for (const auto& [id, host] : world.hosts) {
    if (&host == &of) break;
    first += host.obstacles;
  }
  const auto begin = world.obstacles.begin() + first;
  const auto at = world.obstacles.erase(begin, begin + ptrdiff_t(of.obstacles));
  world.obstacles.insert(at, std::make_move_iterator(obstacles.begin()), std::make_move_iterator(obstacles.end()));
}

std::optional<Refusal> take_obstacles(World& world, const std::string& host_id, const Bytes& bytes) {
  if (world.hosts.size() >= world.limits.hosts && !world.hosts.contains(host_id)) {
    return Refusal{Reason::too_many_hosts, "obstacles: host " + host_id + " would be one more than the " +
                                               std::to_string(world.limits.hosts) + " hosts that are allowed"};
  }
  ObstacleList list;
  if (std::optional<Refusal> refusal = decode(bytes, world.limits, list)) return refusal;
  Host* host = find_or_add_host(world, host_id);
  if (host->obstacles_sequence && list.sequence <= *host->obstacles_sequence) {
    return stale("obstacles", list.sequence, *host->obstacles_sequence);
  }
  host->obstacles_sequence = list.sequence;
  world.obstacles_changed = true;
  const uint32_t count = uint32_t(list.obstacles.size());
  replace_obstacles(world, *host, std::move(list.obstacles));
  host->obstacles = count;
  release_host(world, host_id);
  return std::nullopt;
}

std::optional<Refusal> take_budget(World& world, const Bytes& bytes) {
  Budget budget;
  if (std::optional<Refusal> refusal = decode(bytes, world.limits, budget)) return refusal;
  world.budget = budget.work;
  return std::nullopt;
}

// Tests size and hash first, because the full check of an asset takes long.
std::optional<Refusal> take_asset(World& world, const Bytes& bytes) {
  UploadedAsset asset;
  if (std::optional<Refusal> refusal = decode(bytes, world.limits, asset)) return refusal;
  if (asset.car.size() > largest_upload) {
    return Refusal{Reason::too_large, "asset: a baked car of " + std::to_string(asset.car.size()) + " bytes is more than the " +
                                          std::to_string(largest_upload) +
                                          " that may be given while the scene runs; give its file to `crumple serve --car`"};
  }
  if (find_asset(world, hash_of(asset.car.data(), asset.car.size()))) return std::nullopt;
  try {
    return upload(world, read_car(asset.car, "asset"));
  } catch (const std::runtime_error& error) {
    return Refusal{Reason::malformed, error.what()};
  }
}

std::optional<Refusal> take_command(World& world, const std::string& car, const Bytes& bytes, Bytes& state) {
  Order order;
  if (std::optional<Refusal> refusal = decode(bytes, world.limits, order)) return refusal;
  return obey(world, car, std::move(order), state);
}

}  // namespace

void read(World& world, const Inbox& inbox, Outbox& outbox, std::vector<Asked>& asked) {
  for (size_t k = 0; k < inbox.size(); ++k) {
    const Message& message = inbox[k];
    ++world.tally.messages;
    const Key key = parse_key(message.key).value_or(Key{});
    const std::string id(key.id);
    Bytes state;
    std::optional<Refusal> refusal;
    bool command = false;
    switch (key.channel) {
      case Channel::poses:
        refusal = take_poses(world, id, message.bytes);
        break;
      case Channel::obstacles:
        refusal = take_obstacles(world, id, message.bytes);
        break;
      case Channel::keyframe:
        asked.push_back({message.key, id, size_t(key.number), message.ticket});
        continue;
      case Channel::budget:
        refusal = take_budget(world, message.bytes);
        break;
      case Channel::asset:
        refusal = take_asset(world, message.bytes);
        command = true;
        break;
      case Channel::command:
        refusal = take_command(world, id, message.bytes, state);
        command = true;
        break;
      default:
        refusal = Refusal{Reason::bad_key, "key " + printable(message.key) + key_rule};
    }
    if (refusal) count(world, *refusal);
    if (!refusal && (key.channel == Channel::poses || key.channel == Channel::obstacles)) world.result.latest.push_back(k);
    answer(world, message.key, message.ticket, refusal, state, refusal && !command, outbox);
  }
}

Host* find_or_add_host(World& world, const std::string& id) {
  const auto found = world.hosts.find(id);
  if (found != world.hosts.end()) return &found->second;
  return world.hosts.size() < world.limits.hosts ? &world.hosts[id] : nullptr;
}

void release_host(World& world, const std::string& id) {
  const Host& host = world.hosts.at(id);
  if (host.cars == 0 && host.obstacles == 0) world.hosts.erase(id);
}

void answer(const World& world, const std::string& key, uint64_t ticket, const std::optional<Refusal>& refusal,
            const Bytes& state, bool failed, Outbox& outbox) {
  if (ticket != 0) outbox.push_back({key, encode_answer(world.tick, refusal, state), ticket, failed});
}

}  // namespace crumple

#include "tick/commands.h"

#include <algorithm>

#include "tick/inbox.h"
#include "tick/state.h"
#include "tick/uploads.h"
#include "wire/encode.h"

namespace crumple {
namespace {

// The car that a command is for.
struct Target {
  const std::string& id;
  Instance& car;
};

Mass mass_of(const SpawnOrder& order, const Model& model) {
  Mass mass;
  const double share = order.mass > 0 ? order.mass / double(model.mass) : 1;
  mass.mass = order.mass > 0 ? order.mass : double(model.mass);
  mass.inertia = order.inertia ? *order.inertia : Eigen::Vector3d(share * model.inertia.cast<double>());
  mass.center = order.center_of_mass ? *order.center_of_mass : Eigen::Vector3d(model.center_of_mass.cast<double>());
  mass.planar = order.planar;
  return mass;
}

Refusal unknown_asset(const std::string& order, const std::string& asset) {
  return {Reason::unknown_asset,
          order + ": asset " + asset +
              " is not one of this server's baked cars; `crumple info CAR` prints the hash of a baked car"};
}

std::optional<Refusal> spawn(World& world, const std::string& id, const SpawnOrder& order) {
  if (world.cars.contains(id)) return Refusal{Reason::already_there, "spawn: car " + id + " lives already; despawn it first"};
  if (world.cars.size() >= world.limits.cars) {
    return Refusal{Reason::too_many_cars, "spawn: car " + id + " would be one more than the " +
                                              std::to_string(world.limits.cars) +
                                              " cars that are allowed; despawn another first"};
  }
  const Levels* levels = find_asset(world, order.asset);
  if (!levels) return unknown_asset("spawn", order.asset);
  Host* host = find_or_add_host(world, order.host);
  if (!host) {
    return Refusal{Reason::too_many_hosts, "spawn: host " + order.host + " would be one more than the " +
                                               std::to_string(world.limits.hosts) + " hosts that are allowed"};
  }
  ++host->cars;
  Instance& car = world.cars[id];
  car.levels = levels;
  car.car = car.levels->front();
  car.host = order.host;
  car.mass = mass_of(order, car.car->model);
  car.body = make_body(car.car->model);
  car.hashes.log = hash(car.log);
  car.motion.pose = order.pose;
  car.placed = true;
  world.result.spawned.push_back(id);
  return std::nullopt;
}

std::optional<Refusal> obey_order(World& world, const Target& target, DespawnOrder&&, Bytes&) {
  const std::string host = target.car.host, id = target.id;
  if (std::erase(world.result.spawned, id) == 0) world.result.despawned.push_back(id);
  std::erase(world.result.replaced, id);
  world.cars.erase(world.cars.find(id));
  --world.hosts.at(host).cars;
  release_host(world, host);
  return std::nullopt;
}

std::optional<Refusal> obey_order(World&, const Target& target, RepairOrder&& order, Bytes&) {
  repair(target.car.car->model, order.amount, target.car.body);
  target.car.placed = true;
  renew(target.car);
  return std::nullopt;
}

std::optional<Refusal> obey_order(World&, const Target& target, ParametersOrder&& order, Bytes&) {
  const auto regions = int(target.car.car->regions.size());
  if (order.region >= regions) {
    return Refusal{Reason::out_of_range, "parameters.region is " + std::to_string(order.region) +
                                             "; this car's regions are 0 to " + std::to_string(regions - 1) +
                                             ", or -1 for all"};
  }
  Parameters parameters = target.car.parameters;
  apply(order, parameters);
  if (auto sentence = out_of_range(parameters)) return Refusal{Reason::out_of_range, "parameters." + *sentence};
  if (parameters.solver != target.car.parameters.solver) target.car.placed = true;  // `classic` touches no cars
  target.car.parameters = parameters;
  target.car.body.step_seconds = 0;  // the whole body is solved next: its stresses may have changed
  target.car.hashes.body = hash(target.car.body);
  return std::nullopt;
}

std::optional<Refusal> obey_order(World&, const Target& target, SaveOrder&&, Bytes& state) {
  state = encode_state(target.car.car->hash, target.car.body);
  return std::nullopt;
}

std::optional<Refusal> obey_order(World& world, const Target& target, LoadOrder&& order, Bytes&) {
  const Levels& levels = *target.car.levels;
  const auto level = std::find_if(levels.begin(), levels.end(), [&](const auto& car) { return car->hash == order.asset; });
  if (level == levels.end()) {
    return Refusal{Reason::bad_state, "load.state.asset is " + order.asset + "; car " + target.id + " has asset " +
                                          levels.front()->hash +
                                          (levels.size() > 1 ? ", and the two are not levels of one car" : "")};
  }
  const Model& model = (*level)->model;
  if (auto sentence = refuse_state(model, order.state)) return Refusal{Reason::bad_state, "load.state: " + *sentence};
  target.car.car = *level;
  target.car.level_tick = world.tick;
  DeformableState& body = target.car.body;
  body = std::move(order.state);
  body.step.assign(body.node.size(), Vec3::Zero());
  measure_reach(model, body);
  target.car.placed = true;
  renew(target.car);
  return std::nullopt;
}

std::optional<Refusal> obey_order(World& world, const Target& target, ReplaceOrder&& order, Bytes&) {
  const Levels* levels = find_asset(world, order.asset);
  if (!levels) return unknown_asset("replace", order.asset);
  Instance& car = target.car;
  car.levels = levels;
  car.car = levels->front();
  car.level_tick = 0;
  car.body = make_body(car.car->model);
  car.result = {};
  car.placed = true;
  renew(car);
  if (std::find(world.result.replaced.begin(), world.result.replaced.end(), target.id) == world.result.replaced.end())
    world.result.replaced.push_back(target.id);
  return std::nullopt;
}

std::optional<Refusal> obey_order(World&, const Target&, SpawnOrder&&, Bytes&) { return std::nullopt; }

}  // namespace

std::optional<Refusal> obey(World& world, const std::string& id, Order&& order, Bytes& state) {
  if (const auto* spawn_order = std::get_if<SpawnOrder>(&order)) return spawn(world, id, *spawn_order);
  const auto found = world.cars.find(id);
  if (found == world.cars.end()) {
    return Refusal{Reason::unknown_car, "car " + id + " does not live here; spawn it first"};
  }
  const Target target{found->first, found->second};
  target.car.idle = false;
  return std::visit([&](auto&& which) { return obey_order(world, target, std::move(which), state); }, std::move(order));
}

}  // namespace crumple

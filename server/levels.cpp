// Levels: which of the baked meshes of a car its body is on. Chosen by the importance that the host gives, and only when
// something comes near the car: until then no level costs anything, and a dent that is left alone loses no detail.
#include <algorithm>

#include "asset/map_level.h"
#include "state.h"

namespace crumple {
namespace {

constexpr double notice = 0.5;       // s before something can touch the car that it changes its level
constexpr double shortest_stay = 1;  // s on one level
constexpr double reluctance = 0.8;   // of the nodes that would call for this level, below which it is left for a coarser one

size_t nodes(const Car& car) { return car.model.node.size(); }

const std::shared_ptr<const Car>& wanted(const Instance& car) {
  const Levels& levels = *car.levels;
  const double share = double(car.importance) * double(nodes(*levels.front()));
  if (share < double(nodes(*car.car)) && share >= reluctance * double(nodes(*car.car))) return car.car;
  const auto fits = [&](const auto& level) { return double(nodes(*level)) <= share; };
  const auto found = std::find_if(levels.begin(), levels.end(), fits);
  return found != levels.end() ? *found : levels.back();
}

void add_level(const std::shared_ptr<const Car>& car, Levels& levels) {
  const auto at = std::find_if(levels.begin(), levels.end(), [&](const auto& level) { return nodes(*level) < nodes(*car); });
  levels.insert(at, car);
}

}  // namespace

void add_asset(World& world, std::shared_ptr<const Car> car) {
  const auto [own, added] = world.assets.try_emplace(car->hash, Levels{car});
  if (!added) return;
  for (auto& [hash, levels] : world.assets) {
    const std::shared_ptr<const Car> other = levels.front();
    if (other == car || nodes(*other) == nodes(*car) || !same_surface(*other, *car)) continue;
    world.level_maps[{hash, car->hash}] = map_level(other->model, car->model);
    world.level_maps[{car->hash, hash}] = map_level(car->model, other->model);
    if (nodes(*other) < nodes(*car)) {
      add_level(other, own->second);
    } else {
      add_level(car, levels);
    }
  }
}

size_t coarser_levels(const World& world, const std::string& asset) { return world.assets.at(asset).size() - 1; }

bool change_level(const World& world, Instance& car, Worker& worker) {
  if (car.levels->size() == 1) return false;
  const std::shared_ptr<const Car>& to = wanted(car);
  if (to == car.car || car.body.touching || car.parameters.solver != Solver::nodal) return false;
  if (car.level_tick > 0 && double(world.tick - car.level_tick) < shortest_stay * world.rate) return false;
  find_candidates(car.car->model, car.body, car.motion, car.mass, world.obstacles, notice, worker.near);
  if (worker.near.empty()) return false;
  car.body = transfer(car.car->model, to->model, world.level_maps.at({car.car->hash, to->hash}), car.body);
  car.car = to;
  car.level_tick = world.tick;
  return true;
}

}  // namespace crumple

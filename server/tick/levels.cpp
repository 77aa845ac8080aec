// Chooses the level (one of a car's baked meshes) of each body. The level follows the importance that the host gives. It
// changes only when something comes near the car: until then no level costs anything, and a dent that is left alone loses no
// detail. If the cars that may be hit would exceed the tick's budget, cars go to still coarser levels, costliest per importance
// first: a coarse mesh that is solved is nearer to the truth than a fine mesh that is not.
#include "tick/levels.h"

#include <algorithm>

#include "car/map_level.h"
#include "tick/budget.h"
#include "tick/state.h"

namespace crumple {
namespace {

constexpr double shortest_stay = 1;  // s on one level
constexpr double reluctance = 0.8;   // a car leaves its level for a coarser one if it wants less than this share of its nodes
constexpr double spare = 0.2;        // share of the budget that must remain free before a car goes to a finer level

size_t nodes(const Car& car) { return car.model.node.size(); }

// One past the coarsest level that can see the nearest obstacle. An obstacle narrower than the edges would slip between the
// nodes and leave no dent.
Levels::const_iterator end_of_levels(const Instance& car) {
  const auto sees = [&](const auto& level) { return level->mean_edge <= car.width; };
  const auto blind = std::find_if_not(car.levels->begin(), car.levels->end(), sees);
  return std::max(blind, car.levels->begin() + 1);
}

Levels::const_iterator wanted(const Instance& car) {
  const auto begin = car.levels->begin(), end = end_of_levels(car);
  const auto now = std::find(begin, end, car.car);
  const double share = double(car.importance) * double(nodes(**begin));
  if (now != end && share < double(nodes(**now)) && share >= reluctance * double(nodes(**now))) return now;
  const auto found = std::find_if(begin, end, [&](const auto& level) { return double(nodes(*level)) <= share; });
  return found != end ? found : end - 1;
}

// Of two levels with equally many nodes, between which there is no map, the lower hash stays.
void add_level(const std::shared_ptr<const Car>& car, Levels& levels) {
  const auto at = std::find_if(levels.begin(), levels.end(), [&](const auto& level) { return nodes(*level) <= nodes(*car); });
  if (at == levels.end() || nodes(**at) < nodes(*car)) {
    levels.insert(at, car);
  } else if (car->hash < (*at)->hash) {
    *at = car;
  }
}

bool stays(const World& world, const Instance& car) {
  return car.level_tick > 0 && double(world.tick - car.level_tick) < shortest_stay * world.rate;
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

void look_ahead(const World& world, Instance& car, std::span<const Obstacle> obstacles, bool woken) {
  car.ahead = Ahead::nothing;
  const bool held = car.body.touching && !car.body.settled;
  if (held || (world.budget == 0 && car.levels->size() == 1)) return;
  const Encounter met = encounter({car.car->model, car.parameters, car.mass, obstacles, notice}, car.body, car.motion);
  car.width = met.width;
  if (woken || met.hit) {
    car.ahead = Ahead::hit;
  } else if (met.near) {
    car.ahead = Ahead::neighbour;
  }
}

std::vector<Instance*> choose_levels(const World& world, const std::vector<Instance*>& cars) {
  struct Choice {
    Instance* car;
    size_t order;  // breaks ties
    Levels::const_iterator level;
    double work;
  };
  const auto next = [](const Choice& a, const Choice& b) {
    const double first = a.work * double(b.car->importance), second = b.work * double(a.car->importance);
    return first != second ? first < second : a.order > b.order;
  };
  std::vector<Choice> choices;
  std::vector<Choice*> heap;
  double left = double(world.budget);
  for (size_t i = 0; i < cars.size(); ++i) {
    Instance& car = *cars[i];
    const bool may = car.ahead != Ahead::nothing && !car.body.touching && car.levels->size() > 1 && !stays(world, car) &&
                     car.parameters.solver == Solver::nodal;
    if (!may) {
      if (car.ahead == Ahead::hit && car.body.settled) {
        left -= crash_work(world, car, *car.car);
      } else if (!car.body.settled) {
        left -= work_of(car.car->model, car.result);
      }
      continue;
    }
    const auto level = wanted(car);
    choices.push_back({&car, i, level, car.ahead == Ahead::hit ? crash_work(world, car, **level) : 0});
    left -= choices.back().work;
  }
  for (Choice& choice : choices) {
    if (world.budget > 0 && choice.work > 0 && choice.level + 1 != end_of_levels(*choice.car)) heap.push_back(&choice);
  }
  const auto later = [&](const Choice* a, const Choice* b) { return next(*a, *b); };
  std::make_heap(heap.begin(), heap.end(), later);
  while (left < 0 && !heap.empty()) {
    std::pop_heap(heap.begin(), heap.end(), later);
    Choice& choice = *heap.back();
    left += choice.work;
    choice.work = crash_work(world, *choice.car, **++choice.level);
    left -= choice.work;
    if (choice.level + 1 != end_of_levels(*choice.car)) {
      std::push_heap(heap.begin(), heap.end(), later);
    } else {
      heap.pop_back();
    }
  }
  std::vector<Instance*> changing;
  const bool room = left >= spare * double(world.budget);
  for (const Choice& choice : choices) {
    Instance& car = *choice.car;
    const auto &from = car.car, &to = *choice.level;
    // No switching to and fro while the budget is nearly full: each change loses some detail of the dents.
    const bool blind = from->mean_edge > car.width;
    const bool worth_it = nodes(*to) < nodes(*from) || blind || world.budget == 0 || (car.ahead == Ahead::hit && room);
    if (to == from || !worth_it) continue;
    car.next_level = to;
    changing.push_back(&car);
  }
  return changing;
}

void change_level(const World& world, Instance& car) {
  const Car& to = *car.next_level;
  car.body = transfer(car.car->model, to.model, world.level_maps.at({car.car->hash, to.hash}), car.body);
  car.car = std::move(car.next_level);
  car.level_tick = world.tick;
  car.changed = true;
}

}  // namespace crumple

// The budget of a tick in tet visits. In: what each car's last tick took and left undone, and the importance from its host.
// Out: how many sub-steps, and how many sweeps in each, every island may make in this tick. If they ask for more than the
// budget, it takes work away where the least accuracy is lost: first sweeps, one solver step (two sweeps) at a time, then half
// of the sub-steps where the mesh is too coarse to show them. Law: below the budget every car makes what its parameters allow.
#include "tick/budget.h"

#include <algorithm>
#include <cmath>

#include "sim/nodal.h"
#include "tick/state.h"
#include "wire/encode.h"

namespace crumple {
namespace {

// What a sub-step takes besides its sweeps, in sweeps over what is awake; and what a tick takes besides, in sweeps over all
// tets.
constexpr double substep_costs = 5, tick_costs = 1;
// Share of the tets that a sweep visits in a car that something hits: 0.16 to 0.26 in walls, poles and taps at 5,000 nodes.
// Once the car is hit, its last tick says what is visited.
constexpr double crash_share = 0.3;

// Fewest sweeps of a sub-step. Acceleration begins with the second solver step. At 50 km/h, 4,642 nodes with 4 sweeps end 3.0
// (wall) and 2.7 % (pole) of the largest displacement away from the result with all sweeps, with 2 sweeps 14 and 10 %
// (bench/page.md). A longer sub-step needs more sweeps: 1,071 nodes in a wall end 13 % away with 2 sub-steps of 6 sweeps,
// but 2.4 % with 2 of 8, as good as 4 of 4. A mesh so small that a wave crosses it in that time needs no more: 335 nodes
// end 3.2 % away with 4 sub-steps of 4 sweeps, 3.4 with 2, 5.2 with one, 6.1 with one of 8 (bench/scene.cpp).
constexpr int step = sweeps_a_step, fewest = 2 * step, fewest_of_halved = 4 * step;
constexpr size_t few_nodes = 500;
constexpr double longest_way = 0.8;  // longest way of a sub-step against an obstacle, in edges of the mesh
constexpr int usual = 8;             // sweeps of a car that is just waking: about what the default tolerance needs
constexpr double worth = 2;          // the residual without the last step is this many times larger

struct Plan {
  int substeps, sweeps;  // substeps: in 1/60 s
};

// What the cars of an island ask for, and what remains of it. They are solved together, so they have one plan.
struct Share {
  struct Part {
    Instance* car;
    double halved;  // sub-steps that deform() makes of one by halving
    double awake, tets;
  };
  const Island* island;
  size_t order;    // breaks ties
  double seconds;  // of a tick
  Plan plan = {0, 0};
  std::vector<Part> part = {};  // cars that will be solved
  double loss = 0;              // importance * m of residual per tet visit saved by the next cut

  double work(const Plan& of) const {
    double sum = 0;
    for (const auto& [car, halved, awake, tets] : part) {
      sum += substep_count(of.substeps, seconds) * halved * (of.sweeps + substep_costs) * awake + tick_costs * tets;
    }
    return sum;
  }
};

// Cars that may touch one another need more: at 50 km/h head-on, 2,454 nodes each, 4 sweeps crush 3 % more than all sweeps and
// do not part (restitution 0 instead of 0.21), 8 sweeps crush 0.2 % more and part (0.13), 12 part at 0.18; with half of the
// sub-steps they crush 4 % more and do not part, with 8 sweeps or 12 (crumple_pairs --sweeps N --substeps N).
// In a crowd they do not: with 2 sub-steps of 4 sweeps ten cars of 1,048 nodes that run into a wall take a quarter of the time
// (--scene ten), crush 11 % less, do not part, and book 2 % more energy than they bring.
constexpr size_t crowd = 16;  // an island of more cars is one
bool meets_cars(const Instance& car, const Island& island) { return !car.body.pairs.near.empty() && island.size() <= crowd; }

int fewest_sweeps(const Instance& car, const Island& island, int substeps) {
  if (island.size() > crowd) return fewest;
  if (meets_cars(car, island)) return fewest_of_halved;
  const bool longer = substeps < int(car.parameters.substeps) && car.car->model.node.size() >= few_nodes;
  return longer ? fewest_of_halved : fewest;
}

bool may_halve(const Instance& car, const Island& island, int substeps, double seconds) {
  if (meets_cars(car, island)) return false;
  if (substeps % 2 != 0 || substep_count(substeps / 2, seconds) == substep_count(substeps, seconds)) return false;
  Parameters halved = car.parameters;
  halved.substeps = uint16_t(substeps / 2);
  return substep_travel * coarseness(halved) <= longest_way * double(car.car->mean_edge);
}

int fewest_sweeps(const Share& share, int substeps) {
  int most = 0;
  for (const Share::Part& part : share.part) most = std::max(most, fewest_sweeps(*part.car, *share.island, substeps));
  return most;
}

// Tets that a sweep of a car will visit when something hits it.
double crash_tets(const Parameters& parameters, const Model& model) {
  return std::ceil((parameters.tolerance > 0 ? crash_share : 1) * double(model.tet.size()));
}

bool may_halve(const Share& share) {
  return std::all_of(share.part.begin(), share.part.end(), [&](const Share::Part& part) {
    return may_halve(*part.car, *share.island, share.plan.substeps, share.seconds);
  });
}

int most_sweeps(const Share& share) {
  int most = 0;
  for (const Share::Part& part : share.part) most = std::max(most, int(part.car->parameters.iterations));
  return most;
}

// The plan after the next cut; the same plan if nothing can be cut.
Plan less(const Share& share) {
  const Plan now = share.plan;
  const int least = fewest_sweeps(share, now.substeps);
  if (now.sweeps > least) return {now.substeps, now.sweeps - std::min(step, now.sweeps - least)};
  if (!may_halve(share)) return now;
  const int sweeps = std::min(fewest_sweeps(share, now.substeps / 2), most_sweeps(share));
  return {now.substeps / 2, std::max(now.sweeps, sweeps)};
}

double saved(const Share& share) { return share.work(share.plan) - share.work(less(share)); }

// Adds a car to the share of its island, and the plan that it asks for. Returns its residual with this plan.
double ask(const World& world, Instance& car, double worst, Share& share) {
  const int most = car.parameters.iterations, substeps = car.parameters.substeps;
  const StepResult& last = car.result;
  const double tets = double(car.car->model.tet.size()), hit = crash_tets(car.parameters, car.car->model);
  const double halved =
      last.substeps > 0 && car.substeps > 0 ? double(last.substeps) / substep_count(car.substeps, 1 / world.rate) : 1;
  Share::Part& part = share.part.emplace_back(Share::Part{&car, std::max(1.0, halved), hit, tets});
  int sweeps = car.parameters.tolerance > 0 ? std::min(most, usual) : most;
  double residual = worst;
  if (last.sweeps > 0) {
    part.awake = std::min(tets, double(last.work) / last.sweeps);  // the car may have changed its mesh
    if (car.fresh > 0) part.awake = std::max(part.awake, hit);
    const int used = int((last.sweeps + last.substeps - 1) / last.substeps);
    // A car that used all its sweeps would have made more. Allowing twice as many shows how many more.
    sweeps = std::min(most, used >= car.sweeps ? 2 * used : used);
    if (car.fresh > 0) sweeps = std::max(sweeps, std::min(most, usual));
    residual = double(last.residual) * car.substeps / substeps;  // as if for the shorter way of a full sub-step
    for (int k = used; k < sweeps; k += step) residual /= worth;
  }
  share.plan = {std::max(share.plan.substeps, substeps), std::max(share.plan.sweeps, sweeps)};
  return residual;
}

// Also to cars at rest: what touches them may wake them within the tick.
void allow(const Share& share) {
  for (Instance* car : *share.island) {
    car->substeps = uint16_t(std::min(share.plan.substeps, int(car->parameters.substeps)));
    car->sweeps = uint16_t(std::min(share.plan.sweeps, int(car->parameters.iterations)));
  }
}

}  // namespace

double work_of(const Model& model, const StepResult& result) {
  const double awake = result.sweeps > 0 ? double(result.work) / result.sweeps : 0;
  return double(result.work) + substep_costs * result.substeps * awake + tick_costs * double(model.tet.size());
}

double crash_work(const World& world, const Instance& car, const Car& level) {
  const int sweeps = std::min<int>(car.parameters.iterations, usual);
  return substep_count(car.parameters.substeps, 1 / world.rate) * (sweeps + substep_costs) *
             crash_tets(car.parameters, level.model) +
         tick_costs * double(level.model.tet.size());
}

void ration(World& world, const std::vector<Island>& islands) {
  world.tally.shed = 0;
  std::vector<Share> shares;
  double asked = 0, worst = 0;
  for (const Island& island : islands) {
    for (const Instance* car : island) worst = std::max(worst, double(car->result.residual));
  }
  if (worst == 0) worst = 1;
  for (size_t i = 0; i < islands.size() && world.budget > 0; ++i) {
    Share share{&islands[i], i, 1 / world.rate};
    double loss = 0;
    for (Instance* car : islands[i]) {
      if (car->parameters.solver != Solver::nodal || (car->body.settled && car->fresh == 0)) continue;
      loss += double(car->importance) * ask(world, *car, worst, share);
    }
    if (share.part.empty()) continue;
    asked += share.work(share.plan);
    share.loss = loss * worth / std::max(1.0, saved(share));
    shares.push_back(std::move(share));
  }
  for (const Island& island : islands) {
    for (Instance* car : island) {
      car->substeps = car->parameters.substeps;
      car->sweeps = car->parameters.iterations;
    }
  }
  double left = asked - double(world.budget);
  if (left <= 0) return;
  const auto is_fresh = [](const Share::Part& part) { return part.car->fresh > 0; };
  for (const Share& share : shares) {
    if (std::any_of(share.part.begin(), share.part.end(), is_fresh)) allow(share);
  }
  std::erase_if(shares, [](const Share& share) { return saved(share) <= 0; });
  const auto later = [](const Share& a, const Share& b) { return a.loss != b.loss ? a.loss > b.loss : a.order > b.order; };
  std::make_heap(shares.begin(), shares.end(), later);
  while (left > 0 && !shares.empty()) {
    std::pop_heap(shares.begin(), shares.end(), later);
    Share& share = shares.back();
    const double taken = saved(share);
    share.plan = less(share);
    allow(share);
    left -= taken;
    world.tally.shed += uint64_t(taken);
    if (const double next = saved(share); next > 0) {
      share.loss *= worth * taken / next;
      std::push_heap(shares.begin(), shares.end(), later);
    } else {
      shares.pop_back();
    }
  }
}

Message budget_message(uint64_t visits) { return {"budget", encode_budget(visits)}; }

}  // namespace crumple

// The time budget of a tick: so many tet visits, and no more. In: what each car's last tick took and left undone, and the
// importance that its host gives it. Out: how many sweeps a sub-step each car may make in this one. Where they ask for more
// than there is, sweeps are taken away where the least is lost by it, one step of the mixing (two sweeps) at a time. Law: under
// the budget every car makes what sweeps it likes.
#include <algorithm>
#include <cmath>

#include "sim/nodal.h"
#include "state.h"
#include "wire/encode.h"

namespace crumple {
namespace {

// Sweeps a sub-step that every car is left: the second step is the first that can be mixed. At 50 km/h, 4,642 nodes end with 4
// sweeps 3.0 (wall) and 2.7 % (pole) of the largest displacement from all of them, with 2 sweeps 14 and 10 % (bench/page.md).
constexpr int step = sweeps_a_step, fewest = 2 * step;
constexpr int usual = 8;     // of a car that is only now woken: about what the default tolerance asks for
constexpr double worth = 2;  // how much larger the residual is without the last step

struct Share {
  Instance* car;
  size_t order;      // among equals
  int sweeps;        // that it asks for, then those it is left
  double per_sweep;  // tet visits in the tick
  double loss;       // importance * m of residual per tet visit saved, of the next step that is taken away
};

// What the car asks for: sweeps, and what one of them costs.
struct Wish {
  int sweeps;
  double per_sweep, residual;  // the latter with these sweeps
};
Wish wish(const World& world, const Instance& car, double worst) {
  const int most = car.parameters.iterations;
  const Response& last = car.response;
  const double substeps =
      std::max({1.0, std::round(1 / (world.rate * substep_seconds(car.parameters))), double(last.substeps)});
  const double tets = car.fresh > 0 ? double(car.car->model.tet.size()) : double(last.work) / last.sweeps;
  if (last.sweeps == 0) return {car.parameters.tolerance > 0 ? std::min(most, usual) : most, tets * substeps, worst};
  const int used = int((last.sweeps + last.substeps - 1) / last.substeps);
  // One that was kept short would have made more; how many more is seen by letting it.
  const int sweeps = used >= car.sweeps ? std::min(most, 2 * used) : used;
  double residual = double(last.residual);
  for (int k = used; k < sweeps; k += step) residual /= worth;
  return {sweeps, tets * substeps, residual};
}

}  // namespace

void ration(World& world, const std::vector<Instance*>& cars) {
  world.tally.shed = 0;
  std::vector<Share> shares;
  double asked = 0, worst = 0;
  for (const Instance* car : cars) worst = std::max(worst, double(car->response.residual));
  if (worst == 0) worst = 1;
  for (size_t i = 0; i < cars.size() && world.budget > 0; ++i) {
    Instance& car = *cars[i];
    if (car.parameters.solver != Solver::nodal || (car.body.settled && car.fresh == 0)) continue;
    const Wish now = wish(world, car, worst);
    asked += now.per_sweep * now.sweeps;
    const double loss = double(car.importance) * now.residual * worth / now.per_sweep;
    shares.push_back({&car, i, now.sweeps, now.per_sweep, loss});
  }
  for (Instance* car : cars) car->sweeps = car->parameters.iterations;
  double left = asked - double(world.budget);
  if (left <= 0) return;
  for (Share& share : shares) {
    if (share.car->fresh > 0) share.car->sweeps = uint16_t(share.sweeps);
  }
  std::erase_if(shares, [](const Share& share) { return share.sweeps <= fewest; });
  const auto later = [](const Share& a, const Share& b) { return a.loss != b.loss ? a.loss > b.loss : a.order > b.order; };
  std::make_heap(shares.begin(), shares.end(), later);
  while (left > 0 && !shares.empty()) {
    std::pop_heap(shares.begin(), shares.end(), later);
    Share& share = shares.back();
    const int taken = std::min(step, share.sweeps - fewest);
    share.sweeps -= taken;
    share.car->sweeps = uint16_t(share.sweeps);
    left -= taken * share.per_sweep;
    world.tally.shed += uint64_t(taken * share.per_sweep);
    share.loss *= worth;
    if (share.sweeps > fewest) {
      std::push_heap(shares.begin(), shares.end(), later);
    } else {
      shares.pop_back();
    }
  }
}

Work work(const World& world) { return {world.tally.work, world.tally.shed}; }

Message budget_message(uint64_t visits) { return {"budget", encode_budget(visits)}; }

}  // namespace crumple

// The tick: reads the messages, advances every car in parallel, then writes messages for viewers and hosts in the order of ids.
#include "tick/world.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <numeric>
#include <tuple>
#include <utility>

#include "sim/skin.h"
#include "sim/wakes.h"
#include "tick/budget.h"
#include "tick/health.h"
#include "tick/inbox.h"
#include "tick/islands.h"
#include "tick/levels.h"
#include "tick/state.h"
#include "wire/encode.h"

namespace crumple {
namespace {

constexpr uint64_t reaction_echo =
    30;  // a host receives reactions for this many ticks after the last touch, so losing one does no harm

constexpr uint8_t waking = 3;  // ticks that a touch takes to spread over the body

class StageClock final : public Timer {
 public:
  StageClock(const std::function<double()>& clock, StageTimes& times) : clock_(clock), times_(times) {}
  void enter(SolveStage stage) override {
    stage_ = stage;
    start_ = clock_();
  }
  void leave() override { times_[size_t(Stage::contacts) + size_t(stage_)] += clock_() - start_; }

 private:
  const std::function<double()>& clock_;
  StageTimes& times_;
  SolveStage stage_ = SolveStage::contacts;
  double start_ = 0;
};
static_assert(size_t(Stage::solve) == size_t(Stage::contacts) + size_t(SolveStage::solve));
static_assert(size_t(Stage::flow) == size_t(Stage::contacts) + size_t(SolveStage::flow));

bool touched(const StepResult& result) {
  return result.contacts > 0 || result.deepest > 0 || !result.impulse.isZero(0) || !result.angular_impulse.isZero(0);
}

// m/s^2: weight, engine and brakes give a car no more; what changes its velocity more is no steady force. And what changes it
// less is a host's rounding.
constexpr double strongest_pull = 30, weakest_pull = 0.01;

// Sets the motion from which the tick starts, from the host's intent.
void receive(const World& world, Instance& car) {
  if (!car.intent) return;
  // Beside another car too: if ticks are late, a host is ahead, and its pose would put the car into the other one.
  const PairMemory& pairs = car.body.pairs;
  const bool touching =
      (car.touched_tick != 0 && car.touched_tick + 1 == world.tick) || pairs.near.size() > pairs.passing.size();
  const Motion before = car.motion;
  car.motion = reconcile(before, *car.intent, car.log, world.tick, touching);
  if ((car.motion.pose.position - before.pose.position).norm() > teleport) {
    car.placed = true;
  } else if (touching) {
    const Eigen::Vector3d pull = world.rate * (car.motion.velocity - before.velocity);
    if (pull.norm() > weakest_pull && pull.norm() < strongest_pull) car.pull = pull;
  }
  car.intent.reset();
}

// Advances the rigid motions and the bodies of an island by one tick.
void move(const World& world, std::span<Instance* const> island, Worker& worker) {
  StageClock timer(world.clock, worker.times);
  std::vector<Parameters> parameters;
  std::vector<Motion> before;
  std::vector<Member> members;
  parameters.reserve(island.size());  // members point to them
  while (worker.scratch.size() < island.size()) worker.scratch.push_back(make_scratch());
  const std::vector<std::vector<uint32_t>> near = near_in(island);
  for (size_t k = 0; k < island.size(); ++k) {
    Instance& car = *island[k];
    parameters.push_back(car.parameters);
    parameters.back().iterations = car.sweeps;
    parameters.back().substeps = car.substeps;
    before.push_back(car.motion);
    const StepInput input{car.car->model, parameters.back(), car.mass, world.obstacles, 1 / world.rate, car.pull};
    members.push_back({input, car.key, *worker.scratch[k], {car.body, car.motion}, &near[k]});
  }
  deform(members, world.clock ? &timer : nullptr);
  for (size_t k = 0; k < island.size(); ++k) {
    Instance& car = *island[k];
    car.result = members[k].state.result;
    const ImpulseLog::Change change{world.tick, car.motion.velocity - before[k].velocity,
                                    car.motion.angular_velocity - before[k].angular_velocity};
    if (!change.velocity.isZero(0) || !change.angular_velocity.isZero(0)) {
      car.log.add(change);
      car.hashes.log = hash(car.log);
    }
    if (touched(car.result)) car.touched_tick = world.tick;
  }
}

// Displacements of the nodes that the spawned car's skin uses. If the body is on another level, that level's mesh carries them.
void displace_shown(const World& world, const Instance& car, std::vector<Vec3>& out) {
  const Car& shown = *car.levels->front();
  out.resize(shown.skin_node.size());
  if (car.car->hash == shown.hash) {
    displace(shown.model, car.body, shown.skin_node, out);
  } else {
    displace(car.car->model, world.level_maps.at({car.car->hash, shown.hash}), car.body, shown.skin_node, out);
  }
}

float quantum_of(const World& world, size_t level) { return world.quantum * float(surface_levels[level].quanta); }

// Prepares the messages for the car's viewers.
void show(const World& world, Instance& car, Worker& worker) {
  const Watch watch(world.clock, worker.times[size_t(Stage::surface)]);
  displace_shown(world, car, worker.displaced);
  worker.displacement.resize(3 * worker.displaced.size());
  for (size_t level = 0; level < surface_levels.size(); ++level) {
    ViewerState& told = car.told[level];
    // Cars take turns by their order. A car that has come to rest does not wait: its next turn may be long after.
    const bool its_turn = (world.tick + car.order) % surface_levels[level].ticks == 0;
    if (!its_turn && !car.body.settled && !told.due) continue;
    const float quantum = quantum_of(world, level);
    quantise(worker.displaced, quantum, worker.displacement);
    const SurfaceUpdate& news = car.news[level] =
        update_viewers({world.tick, car.levels->front()->hash, quantum}, car.body.settled, worker.displacement, told);
    if (news.kind == SurfaceUpdate::Kind::none) continue;
    car.hashes.latest[level] = surface_hash(told.latest);
    if (news.kind == SurfaceUpdate::Kind::keyframe) car.hashes.keyframe[level] = car.hashes.latest[level];
  }
}

// Finds the car's motion.
void receive_car(const World& world, Instance& car) {
  car.pull.setZero();
  car.idle = car.idle && !world.obstacles_changed;
  if (!car.idle) receive(world, car);
}

// Finds whether the car will be solved. The cars near it count as boxes that move as they do.
void prepare_car(const World& world, const std::vector<Instance*>& cars, Instance& car, Worker& worker) {
  if (car.idle) return;
  car.changed = false;
  std::span<const Obstacle> obstacles = world.obstacles;
  if (!car.near.empty()) {
    worker.obstacles = world.obstacles;
    add_boxes(cars, car, worker.obstacles);
    obstacles = worker.obstacles;
  }
  const bool woken = world.budget > 0 && car.body.settled &&
                     wakes({car.car->model, car.parameters, car.mass, obstacles, 1 / world.rate, car.pull},
                           *worker.scratch.front(), car.body, car.motion);
  look_ahead(world, car, obstacles, woken);
  if (!car.body.settled && car.result.sweeps > 0) {
    if (car.fresh > 0) --car.fresh;
  } else {
    car.fresh = !car.body.settled || woken ? waking : 0;
  }
}

// The fields that may change in a body that is not solved: what it rests against moves on or leaves, or a car comes near.
auto of_rest(const DeformableState& body) {
  return std::tuple(body.touching, body.settled, body.drift, body.owed, body.force, body.moment, body.pairs.push,
                    body.pairs.near, body.pairs.passing);
}

bool stands(const Motion& motion) { return motion.velocity.isZero(0) && motion.angular_velocity.isZero(0); }

void advance_island(const World& world, std::span<Instance* const> island, Worker& worker) {
  if (island.size() == 1 && island.front()->idle) return;
  std::vector<uint8_t> resting;
  std::vector<decltype(of_rest(island.front()->body))> before;
  for (const Instance* car : island) {
    const bool told =
        std::none_of(car->told.begin(), car->told.end(), [](const ViewerState& each) { return each.due || each.flowing; });
    resting.push_back(car->body.settled && told && !car->changed);
    before.push_back(of_rest(car->body));
  }
  move(world, island, worker);
  for (size_t k = 0; k < island.size(); ++k) {
    Instance& car = *island[k];
    car.news = {};
    const bool same_shape = resting[k] && car.result.substeps == 0 && !car.result.recovered;
    if (!same_shape) show(world, car, worker);
    if (!same_shape || of_rest(car.body) != before[k]) car.hashes.body = hash(car.body);
    car.idle =
        same_shape && !car.body.touching && car.body.pairs.near.empty() && car.ahead == Ahead::nothing && stands(car.motion);
  }
}

// Calls step(item, worker) for each item. Items do not affect each other within a tick, so any number of workers gives the same
// result.
template <class Item, class Step>
void for_each(World& world, const std::vector<Item>& items, size_t at_once, const Step& step) {
  world.arena->execute([&] {
    tbb::parallel_for(
        tbb::blocked_range<size_t>(0, items.size(), at_once),
        [&](const tbb::blocked_range<size_t>& range) {
          Worker& worker = world.workers.local();
          // While a car waits for its helpers, this thread must not start another car with the same memory.
          tbb::this_task_arena::isolate([&] {
            for (size_t i = range.begin(); i < range.end(); ++i) step(items[i], worker);
          });
        },
        tbb::simple_partitioner{});
  });
}

void tally_up(const std::vector<Instance*>& cars, Tally& tally) {
  tally.work = 0;
  for (const Instance* car : cars) {
    const StepResult& result = car->result;
    tally.contact_overflows += result.contact_overflow;
    tally.recoveries += result.recovered;
    if (result.substeps > 0) tally.work += uint64_t(work_of(car->car->model, result));
    if (result.sweeps == 0) continue;
    ++tally.solved;
    tally.residual_sum += double(result.residual);
    tally.residual_worst = std::max(tally.residual_worst, double(result.residual));
  }
  tally.most_work = std::max(tally.most_work, tally.work);
  tally.work_shed += tally.shed;
}

void count_islands(const std::vector<Island>& islands, Tally& tally) {
  uint64_t several = 0;
  for (const Island& island : islands) {
    if (island.size() < 2) continue;
    ++several;
    tally.largest_island = std::max(tally.largest_island, uint64_t(island.size()));
  }
  tally.most_islands = std::max(tally.most_islands, several);
}

void open_arena(World& world, int threads) {
  if (world.arena && world.arena_threads == threads) return;
  world.arena.emplace(threads);
  world.arena_threads = threads;
}

// One tick of an undamaged car with a wall at its nose. Returns the work.
uint64_t crash_once(const Car& car, double seconds, Worker& worker) {
  DeformableState body = make_body(car.model);
  Motion motion;
  motion.velocity.x() = 15;  // m/s
  float nose = 0;
  for (const Vec3& node : car.model.node) nose = std::max(nose, node.x());
  Obstacle wall;
  make_box({1, 10, 10}, wall);
  wall.pose.position.x() = double(nose) + 1;
  return uint64_t(work_of(car.model, deform({car.model, {}, {}, {&wall, 1}, seconds}, *worker.scratch.front(), body, motion)));
}

void advance_cars(World& world, int threads) {
  open_arena(world, threads);
  std::vector<Instance*> cars;
  for (auto& [id, car] : world.cars) {
    car.order = cars.size();
    car.key = key_of(id);
    cars.push_back(&car);
  }
  for_each(world, cars, 16, [&](Instance* car, Worker&) { receive_car(world, *car); });
  forget_placed(cars);
  find_neighbours(world, cars);
  for_each(world, cars, 16, [&](Instance* car, Worker& worker) { prepare_car(world, cars, *car, worker); });
  for_each(world, choose_levels(world, cars), 1, [&](Instance* car, Worker&) { change_level(world, *car); });
  const std::vector<Island> islands = find_islands(world, cars);
  count_islands(islands, world.tally);
  ration(world, islands);
  for_each(world, islands, 1, [&](const Island& island, Worker& worker) { advance_island(world, island, worker); });
  for (Worker& worker : world.workers) {
    for (size_t i = 0; i < worker.times.size(); ++i) world.tally.now[i] += worker.times[i];
    worker.times = {};
  }
  tally_up(cars, world.tally);
}

void move_obstacles(World& world) {
  world.obstacles_changed = false;
  for (Obstacle& obstacle : world.obstacles) {
    if (obstacle.velocity.isZero(0) && obstacle.angular_velocity.isZero(0)) continue;
    world.obstacles_changed = true;
    obstacle.pose = advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, 1 / world.rate);
  }
}

void tell_viewers(World& world, Outbox& outbox) {
  for (auto& [id, car] : world.cars) {
    for (size_t level = 0; level < surface_levels.size(); ++level) {
      const char* kind = car.news[level].kind == SurfaceUpdate::Kind::keyframe ? "/key/" : "/delta/";
      for (Bytes& part : car.news[level].parts) outbox.push_back({"car/" + id + kind + std::to_string(level), std::move(part)});
    }
    car.news = {};
  }
}

// Cars by their keys, if any car has touched another.
using Named = std::map<uint64_t, std::map<std::string, Instance>::const_iterator>;
Named name_partners(const World& world) {
  Named out;
  const auto met = [](const auto& each) { return !each.second.result.partners.empty(); };
  if (std::none_of(world.cars.begin(), world.cars.end(), met)) return out;
  for (auto car = world.cars.begin(); car != world.cars.end(); ++car) out.emplace(car->second.key, car);
  return out;
}

void tell_hosts(const World& world, Outbox& outbox) {
  const auto by_id = [](const CarReaction::Partner& a, const CarReaction::Partner& b) { return a.car < b.car; };
  std::map<std::string, std::vector<CarReaction>> reactions;
  const Named names = name_partners(world);
  for (const auto& [id, car] : world.cars) {
    const bool lately = car.touched_tick != 0 && world.tick - car.touched_tick <= reaction_echo;
    if (!lately && car.body.settled) continue;
    CarReaction& reaction =
        reactions[car.host].emplace_back(CarReaction{id, car.motion, car.result, car.body.absorbed, car.body.stored, {}});
    for (const PartnerResult& each : car.result.partners) {
      const auto found = names.find(each.key);
      if (found == names.end()) continue;
      reaction.partners.push_back({found->second->first, found->second->second.host, each.impulse, each.contacts});
    }
    std::sort(reaction.partners.begin(), reaction.partners.end(), by_id);
  }
  for (const auto& [host, cars] : reactions) {
    outbox.push_back({"host/" + host + "/reactions", encode_reactions(world.tick, double(world.tick) / world.rate, cars)});
  }
}

// Answers with the keyframe to which the deltas refer, in one part: an answer may be longer than a sample.
void answer_asked(World& world, const std::vector<Asked>& asked, Outbox& outbox) {
  for (const Asked& one : asked) {
    const auto found = world.cars.find(one.car);
    if (found == world.cars.end()) {
      const Refusal refusal{Reason::unknown_car, "car " + one.car + " does not live here; it has no keyframe"};
      count(world, refusal);
      answer(world, one.key, one.ticket, refusal, {}, true, outbox);
      continue;
    }
    if (one.ticket == 0) continue;
    const Instance& car = found->second;
    const ViewerState& told = car.told[one.level];
    auto parts = encode_keyframe({told.keyframe_tick, car.levels->front()->hash, quantum_of(world, one.level)}, told.keyframe,
                                 max_nodes);
    outbox.push_back({one.key, std::move(parts.at(0)), one.ticket});
  }
}

void close_tally(Tally& tally) {
  ++tally.ticks;
  for (size_t i = 0; i < tally.now.size(); ++i) {
    tally.sum[i] += tally.now[i];
    tally.worst[i] = std::max(tally.worst[i], tally.now[i]);
  }
  tally.now = {};
}

}  // namespace

uint64_t warm_up(World& world, int threads) {
  threads = std::max(1, threads);
  open_arena(world, threads);
  std::vector<uint64_t> work(size_t(threads), 0);  // one entry per thread
  world.arena->execute([&] {
    tbb::parallel_for(
        tbb::blocked_range<int>(0, threads, 1),
        [&](const tbb::blocked_range<int>& turn) {
          Worker& worker = world.workers.local();
          tbb::this_task_arena::isolate([&] {
            for (const auto& [hash, levels] : world.assets)
              work[size_t(turn.begin())] += crash_once(*levels.front(), 1 / world.rate, worker);
          });
        },
        tbb::static_partitioner{});
  });
  return std::accumulate(work.begin(), work.end(), uint64_t{0});
}

TickResult tick(World& world, const Inbox& inbox, Outbox& outbox, int threads) {
  StageTimes& times = world.tally.now;
  std::vector<Asked> asked;
  outbox.clear();
  ++world.tick;
  {
    const Watch whole(world.clock, times[size_t(Stage::tick)]);
    {
      const Watch watch(world.clock, times[size_t(Stage::decode)]);
      read(world, inbox, outbox, asked);
    }
    advance_cars(world, std::max(1, threads));
    move_obstacles(world);
    tell_viewers(world, outbox);
    tell_hosts(world, outbox);
    answer_asked(world, asked, outbox);
  }
  close_tally(world.tally);
  TickResult result = std::exchange(world.result, {});
  result.work = {world.tally.work, world.tally.shed};
  return result;
}

uint64_t tick_count(const World& world) { return world.tick; }

void renew(World& world) {
  for (auto& [id, car] : world.cars) renew(car);
}

void renew(Instance& car) {
  car.idle = false;
  for (ViewerState& told : car.told) told.due = true;
}

void shown(const World& world, Outbox& outbox) {
  for (const auto& [id, car] : world.cars) {
    for (size_t level = 0; level < surface_levels.size(); ++level) {
      const ViewerState& told = car.told[level];
      const SurfaceHead head{told.keyframe_tick, car.levels->front()->hash, quantum_of(world, level)};
      for (Bytes& part : encode_keyframe(head, told.keyframe))
        outbox.push_back({"car/" + id + "/key/" + std::to_string(level), std::move(part)});
    }
  }
}

std::vector<std::string> cars(const World& world) {
  std::vector<std::string> ids;
  for (const auto& [id, car] : world.cars) ids.push_back(id);
  return ids;
}

std::vector<std::string> hosts(const World& world) {
  std::vector<std::string> ids;
  for (const auto& [id, host] : world.hosts) ids.push_back(id);
  return ids;
}

void set_clock(World& world, std::function<double()> clock) { world.clock = std::move(clock); }

WorldHandle make_world(double rate, float quantum, const Limits& limits) {
  WorldHandle world(new World);
  world->rate = rate;
  world->quantum = quantum;
  world->limits = limits;
  return world;
}

void WorldDeleter::operator()(World* world) const { delete world; }

}  // namespace crumple

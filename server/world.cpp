// The tick. Messages in; every car one tick on, side by side; then, in the order of their ids, what viewers and hosts are told.
#include "world.h"

#include <tbb/parallel_for.h>

#include <algorithm>

#include "state.h"
#include "wire/encode.h"

namespace crumple {
namespace {

constexpr uint64_t reaction_echo =
    30;  // ticks after the last touch in which a host is still told: one lost reaction is no loss

class RoomTimer final : public Timer {
 public:
  RoomTimer(const std::function<double()>& clock, StageTimes& times) : clock_(clock), times_(times) {}
  void enter(Room room) override {
    room_ = room;
    start_ = clock_();
  }
  void leave() override { times_[size_t(Stage::contacts) + size_t(room_)] += clock_() - start_; }

 private:
  const std::function<double()>& clock_;
  StageTimes& times_;
  Room room_ = Room::contacts;
  double start_ = 0;
};
static_assert(size_t(Stage::solve) == size_t(Stage::contacts) + size_t(Room::solve));
static_assert(size_t(Stage::flow) == size_t(Stage::contacts) + size_t(Room::flow));

bool touched(const Response& response) {
  return response.contacts > 0 || response.deepest > 0 || !response.impulse.isZero(0) || !response.angular_impulse.isZero(0);
}

// Where the tick starts from: the motion after what the host has sent.
void receive(const World& world, Instance& car) {
  if (!car.intent) return;
  const bool touching = car.touched_tick != 0 && car.touched_tick + 1 == world.tick;
  car.motion = reconcile(car.motion, *car.intent, car.log, world.tick, touching);
  car.intent.reset();
}

// The rigid motion and the body, one tick on.
void move(const World& world, Instance& car, Worker& worker) {
  const Motion before = car.motion;
  RoomTimer timer(world.clock, worker.times);
  car.response = deform(car.car->model, car.parameters, car.mass, world.obstacles, 1 / world.rate, *worker.scratch, car.body,
                        car.motion, world.clock ? &timer : nullptr);
  const ImpulseLog::Change change{world.tick, car.motion.velocity - before.velocity,
                                  car.motion.angular_velocity - before.angular_velocity};
  if (!change.velocity.isZero(0) || !change.angular_velocity.isZero(0)) car.log.add(change);
  if (touched(car.response)) car.touched_tick = world.tick;
}

// What its viewers are to be told of the car.
void show(const World& world, Instance& car, Worker& worker) {
  const Watch watch(world.clock, worker.times[size_t(Stage::skin)]);
  const Model& model = car.car->model;
  worker.vertex.resize(model.vertex.size());
  worker.displacement.resize(3 * model.vertex.size());
  skin(model, car.body, worker.vertex);
  quantise(worker.vertex, model.vertex, world.quantum, worker.displacement);
  car.news = tell({world.tick, car.levels->front()->hash, world.quantum}, car.body.settled, worker.displacement, car.told);
}

void advance_car(const World& world, Instance& car, Worker& worker) {
  const bool idle = car.body.settled && !car.body.touching && !car.told.due && !car.told.flowing;
  receive(world, car);
  const bool changed = change_level(world, car, worker);
  move(world, car, worker);
  car.news = {};
  if (idle && !changed && car.response.substeps == 0) return;
  show(world, car, worker);
  car.hashes = {hash(car.body), hash(car.told.keyframe), hash(car.told.latest)};
}

// Cars know nothing of each other within a tick, so any number of workers gives the same.
void advance_cars(World& world, int threads) {
  if (!world.arena || world.arena_threads != threads) {
    world.arena.emplace(threads);
    world.arena_threads = threads;
  }
  std::vector<Instance*> cars;
  for (auto& [id, car] : world.cars) cars.push_back(&car);
  world.arena->execute([&] {
    tbb::parallel_for(
        tbb::blocked_range<size_t>(0, cars.size(), 1),
        [&](const tbb::blocked_range<size_t>& range) {
          Worker& worker = world.workers.local();
          // While a car waits for its helpers this thread must not begin another car with the same memory.
          tbb::this_task_arena::isolate([&] {
            for (size_t i = range.begin(); i < range.end(); ++i) advance_car(world, *cars[i], worker);
          });
        },
        tbb::simple_partitioner{});
  });
  for (Worker& worker : world.workers) {
    for (size_t i = 0; i < worker.times.size(); ++i) world.tally.now[i] += worker.times[i];
    worker.times = {};
  }
  for (const Instance* car : cars) {
    world.tally.contact_overflows += car->response.contact_overflow;
    world.tally.recoveries += car->response.recovered;
  }
}

void move_obstacles(World& world) {
  for (Obstacle& obstacle : world.obstacles) {
    if (obstacle.velocity.isZero(0) && obstacle.angular_velocity.isZero(0)) continue;
    obstacle.pose = advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, 1 / world.rate);
  }
}

void tell_viewers(World& world, Outbox& outbox) {
  for (auto& [id, car] : world.cars) {
    const char* kind = car.news.kind == News::Kind::keyframe ? "/key" : "/delta/0";
    for (Bytes& part : car.news.parts) outbox.push_back({"car/" + id + kind, std::move(part)});
    car.news = {};
  }
}

void tell_hosts(const World& world, Outbox& outbox) {
  std::map<std::string, std::vector<CarReaction>> reactions;
  for (const auto& [id, car] : world.cars) {
    const bool lately = car.touched_tick != 0 && world.tick - car.touched_tick <= reaction_echo;
    if (!lately && car.body.settled) continue;
    reactions[car.host].push_back({id, car.motion, car.response, car.body.absorbed, car.body.stored});
  }
  for (const auto& [host, cars] : reactions) {
    outbox.push_back({"host/" + host + "/reactions", encode_reactions(world.tick, double(world.tick) / world.rate, cars)});
  }
}

// The keyframe that the deltas refer to, whole: an answer may be longer than a sample.
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
    auto parts =
        encode_keyframe({car.told.keyframe_tick, car.levels->front()->hash, world.quantum}, car.told.keyframe, max_vertices);
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

void tick(World& world, const Inbox& inbox, Outbox& outbox, int threads) {
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
}

uint64_t tick_count(const World& world) { return world.tick; }

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

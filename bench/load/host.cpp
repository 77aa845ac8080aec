// A host of the load harness. Each crashing car starts 10 m before its own wall, or 10 m before the place where it meets cars
// that come from the other side, all at the same time, and again in each period. The other cars drive along free lanes, or
// stand at their place of spawn.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <crumple.hpp>
#include <map>
#include <thread>

#include "load.h"

namespace crumple::load {
namespace {

using Clock = std::chrono::steady_clock;

constexpr double rate = 60;    // poses a second
constexpr double lane = 8;     // m between cars
constexpr double run_up = 10;  // m from the start to the wall, or to the place of a meeting
constexpr double queue = 7;    // m from a car of a pile-up to the one behind it
constexpr double repair_at = 0.1,
                 go_at = 0.25;          // s into a period: the car is put at its start, then repaired, then it goes
constexpr double braking = 7;           // m/s^2
constexpr double turn_back = 500;       // m: a driving car then goes back to its start
constexpr size_t orders_at_once = 100;  // fewer than the 256 answers that a session keeps

struct Moving {
  std::string id;
  uint32_t number = 0;
  CrumplePose pose{{0, 0, 0}, {0, 0, 0, 1}};
  float velocity[3] = {}, turn[3] = {};
  uint64_t seen = 0;
  bool hit = false, crashes = false;
  CrumplePose start{};
  double heading = 1;  // 1: along x, -1: against it
};

struct Host {
  const HostTask& task;
  client::Session session;
  std::vector<Moving> cars;  // the moving cars
  std::map<std::string, size_t> at;
  uint64_t tick = 0;  // the newest known tick
};

// Places crashing cars on one side of the origin, driving cars on the other, and sleeping cars behind.
CrumplePose start_of(char kind, uint32_t number) {
  const double y = lane * number;
  return {{kind == 'a' ? -100.0 : 0.0, kind == 'd' ? -lane - y : y, 0}, {0, 0, 0, 1}};
}

// Cars that meet start in one lane on both sides of their place, in turn; the cars of a pile-up also behind one another.
void place(const Meeting& meeting, Moving& car) {
  car.start = start_of(car.crashes ? 'c' : 'd', car.number);
  if (!car.crashes || car.number >= meeting.cars) return;
  const uint32_t first = car.number < meeting.pile ? 0 : car.number - (car.number - meeting.pile) % 2, k = car.number - first;
  const double before = run_up + queue * (k / 2);
  car.start = start_of('c', first);
  if (k % 2 == 0) {
    car.start.position[0] = run_up - before;
    return;
  }
  car.heading = -1;
  car.start.position[0] = run_up + before;
  car.start.orientation[2] = 1, car.start.orientation[3] = 0;
}

void settle(Host& host, std::vector<uint64_t>& tickets) {
  for (uint64_t ticket : tickets) host.tick = std::max(host.tick, host.session.settle(ticket).tick);
  tickets.clear();
}

void spawn(Host& host) {
  std::vector<uint64_t> tickets;
  const auto add = [&](char kind, const std::vector<uint32_t>& numbers) {
    for (uint32_t number : numbers) {
      Moving moving;
      moving.number = number;
      moving.crashes = kind == 'c';
      place(host.task.meeting, moving);
      CrumpleSpawn spawn{};
      spawn.pose = kind == 'a' ? start_of(kind, number) : moving.start;
      spawn.planar = 1;
      const std::string id = car_id(kind, number);
      client::need(crumple_spawn(host.session, id.c_str(), host.task.asset.c_str(), &spawn, &tickets.emplace_back()));
      if (tickets.size() == orders_at_once) settle(host, tickets);
      if (kind == 'a') continue;
      host.at[id] = host.cars.size();
      Moving& car = host.cars.emplace_back(moving);
      car.id = id;
      car.pose = spawn.pose;
    }
  };
  add('c', host.task.crashing);
  add('d', host.task.driving);
  add('a', host.task.asleep);
  settle(host, tickets);
  for (Moving& car : host.cars) car.seen = host.tick;
}

void publish_walls(Host& host) {
  std::vector<CrumpleObstacle> walls;
  for (const Moving& car : host.cars) {
    if (!car.crashes || car.number < host.task.meeting.cars) continue;
    CrumpleObstacle wall{};
    wall.id = car.number;
    wall.shape = CRUMPLE_BOX;
    wall.size[0] = 0.5f, wall.size[1] = 3, wall.size[2] = 3;
    wall.pose = {{run_up + 0.5, lane * car.number, 0}, {0, 0, 0, 1}};
    wall.friction = 0.3f;
    walls.push_back(wall);
  }
  host.session.publish(walls);
}

void take_reactions(Host& host) {
  while (const auto next = host.session.next_reaction()) {
    const CrumpleReaction& reaction = *next;
    host.tick = std::max(host.tick, reaction.tick);
    const auto found = host.at.find(reaction.car);
    if (found == host.at.end()) continue;
    Moving& car = host.cars[found->second];
    if (reaction.tick <= car.seen) continue;
    car.seen = reaction.tick;
    const float* j = reaction.impulse;
    if (reaction.contacts == 0 && j[0] == 0 && j[1] == 0 && j[2] == 0) continue;
    car.hit = true;
    car.pose = reaction.pose;
    std::copy_n(reaction.velocity, 3, car.velocity);
    std::copy_n(reaction.angular_velocity, 3, car.turn);
  }
}

// Makes one host tick of one car. time: s since its last start.
void move(const HostTask& task, double time, bool first, uint64_t tick, Moving& car) {
  const double step = 1 / rate;
  if (!car.crashes) {
    car.velocity[0] = 20;
    car.pose.position[0] = std::fmod(car.pose.position[0] + 20 * step, turn_back);
    return;
  }
  if (first) {
    car.pose = car.start;
    std::fill_n(car.velocity, 3, 0.0f);
    std::fill_n(car.turn, 3, 0.0f);
    car.seen = std::max(car.seen, tick);
    car.hit = false;
  }
  if (time < go_at) return;
  if (!car.hit) {
    car.velocity[0] = float(car.heading * task.speed);
  } else {
    const double speed = std::hypot(double(car.velocity[0]), double(car.velocity[1]));
    const double left = speed > 0 ? std::max(0.0, speed - braking * step) / speed : 0;
    for (float& v : car.velocity) v *= float(left);
    for (float& w : car.turn) w *= 0.8f;
  }
  for (int axis = 0; axis < 3; ++axis) car.pose.position[axis] += step * double(car.velocity[axis]);
}

}  // namespace

Meeting meeting_of(const Options& options) {
  const auto cars = uint32_t(options.meeting * options.crashing);
  const uint32_t pile = std::min(options.pile, cars) / 2 * 2;
  return {pile + (cars - pile) / 2 * 2, pile};
}

std::string car_id(char kind, uint32_t number) { return kind + std::to_string(number); }

void play_host(const HostTask& task, std::atomic<uint32_t>& ready, const std::atomic<bool>& go, const std::atomic<bool>& stop) {
  Host host{task, client::Session({task.endpoint, scene, task.id, "", patience}), {}, {}};
  spawn(host);
  publish_walls(host);
  ++ready;
  while (!go && !stop) host.session.poll(std::chrono::milliseconds(10));

  const auto period = int64_t(std::lround(task.period * rate));
  const auto begun = Clock::now();
  std::vector<CrumpleCarPose> poses(host.cars.size());
  for (int64_t i = 0; !stop; ++i) {
    const auto due = begun + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(double(i) / rate));
    for (auto now = Clock::now(); now < due; now = Clock::now()) {
      const auto left = std::chrono::duration_cast<std::chrono::microseconds>(due - now);
      host.session.poll(std::max(left, std::chrono::microseconds(1)));
    }
    take_reactions(host);
    const double time = double(i % period) / rate;
    for (size_t k = 0; k < host.cars.size(); ++k) {
      Moving& car = host.cars[k];
      move(task, time, i % period == 0, host.tick, car);
      poses[k] = {car.id.c_str(), car.pose, {}, {}, car.seen, car.crashes ? float(task.importance) : 1};
      std::copy_n(car.velocity, 3, poses[k].velocity);
      std::copy_n(car.turn, 3, poses[k].angular_velocity);
    }
    if (!poses.empty()) host.session.publish(double(i) / rate, poses);
    if (i >= period && i % period == std::lround(repair_at * rate)) {
      for (const Moving& car : host.cars) {
        uint64_t ticket;
        if (car.crashes) client::need(crumple_repair(host.session, car.id.c_str(), 1, &ticket));
      }
    }
    if (i % int64_t(rate) == 0) publish_walls(host);
  }
}

}  // namespace crumple::load

// Hosts that follow a script. In each host tick they take the reactions, move their cars, and publish the poses. After a
// reaction with contact, pose and velocity become those that the server reached: while reactions come, the newest is less than
// a tick old, so this is the pose at which the next tick begins. Without contact the host's own motion goes on, because a
// reaction is one or two ticks old and does not know yet that the car brakes.
#include "cpp/drive.h"

#include <Eigen/Geometry>
#include <chrono>
#include <cmath>
#include <crumple.hpp>
#include <cstdio>
#include <map>
#include <stdexcept>
#include <vector>

#include "cpp/scene.h"
#include "io/files.h"
#include "protocol/asset.h"
#include "protocol/key.h"

namespace crumple::client {
namespace {

using Eigen::Quaterniond;
using Eigen::Vector3d;
using Clock = std::chrono::steady_clock;

constexpr double gravity = 9.81;           // m/s^2
constexpr double braking = 0.7 * gravity;  // locked wheels on a dry road
constexpr double silence = 2;              // s: a server that is late in a crash may send nothing for so long
constexpr double patience = 60;            // s in addition to the scene's time, for a server that is late
constexpr double yaw_braking = 5;  // rad/s^2: braking at wheels 1.3 m from the centre of a car of 1500 kg and 2600 kg m^2

// Prints progress at once, also through a pipe.
template <class... Values>
void say(const char* format, Values... values) {
  std::printf(format, values...);
  std::fflush(stdout);
}

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

Vector3d vector_of(const schema::Vec3& v) { return {v.x(), v.y(), v.z()}; }
Vector3d vector_of(const float* v) { return {v[0], v[1], v[2]}; }

void copy(const Vector3d& from, float* to) {
  for (int axis = 0; axis < 3; ++axis) to[axis] = static_cast<float>(from[axis]);
}

// The motion that the host gives its car.
struct Moving {
  Vector3d position = Vector3d::Zero();
  Quaterniond orientation = Quaterniond::Identity();
  Vector3d velocity = Vector3d::Zero(), turn = Vector3d::Zero();
  Vector3d center = Vector3d::Zero();  // centre of mass, car's frame
  uint64_t seen = 0;
  bool hit = false, touching = false;
  double told_seconds = 0;  // the server's time that the reactions of this host tick cover
  double silence = 0;       // s without a reaction

  void advance(double seconds) {
    const Vector3d middle = position + orientation * center + velocity * seconds;
    const double angle = turn.norm() * seconds;
    if (angle > 0) orientation = (Quaterniond(Eigen::AngleAxisd(angle, turn.normalized())) * orientation).normalized();
    position = middle - orientation * center;
  }
};

CrumplePose pose_of(const Moving& car) {
  const Vector3d& p = car.position;
  const Eigen::Quaternionf q = car.orientation.cast<float>().normalized();
  return {{p.x(), p.y(), p.z()}, {q.x(), q.y(), q.z(), q.w()}};
}

void adopt(const CrumpleReaction& reaction, Moving& car) {
  const double* p = reaction.pose.position;
  const float* q = reaction.pose.orientation;
  car.position = {p[0], p[1], p[2]};
  car.orientation = Eigen::Quaternionf(q[3], q[0], q[1], q[2]).cast<double>().normalized();
  car.velocity = vector_of(reaction.velocity);
  car.turn = vector_of(reaction.angular_velocity);
}

Moving at_start(const schema::HitT& hit, const Vector3d& center) {
  constexpr double degree = 3.14159265358979323846 / 180;
  Moving car;
  car.position = vector_of(*hit.position);
  car.orientation = Eigen::AngleAxisd(hit.yaw_deg * degree, Vector3d::UnitZ()) *
                    Eigen::AngleAxisd(hit.pitch_deg * degree, Vector3d::UnitY()) *
                    Eigen::AngleAxisd(hit.roll_deg * degree, Vector3d::UnitX());
  car.velocity = vector_of(*hit.direction).normalized() * (hit.speed_kmh / 3.6);
  car.center = center;
  return car;
}

struct Result {
  double before = 0, after = 0;      // m/s along the direction of travel
  double peak = 0;                   // m/s^2, mean of one server tick
  double dynamic = 0, residual = 0;  // m
  double absorbed = 0;               // J
};

// A car that is driven.
struct Car {
  const schema::SceneCarT& scene;
  std::string id;
  Session& session;  // of its host
  bool planar;
  double mass = 0;                       // kg
  Vector3d center = Vector3d::Zero();    // of mass, car's frame
  CrumpleReaction last{};                // the newest
  double energy = 0, energy_before = 0;  // J, absorbed since spawn, by the last reaction and by that before the hit
  std::vector<Result> results = {};      // of the hits so far
  // Of the present hit:
  Moving moving = {};
  Vector3d travel = Vector3d::Zero(), travel_in_car = Vector3d::Zero();
  bool told = false, touched = false;  // whether a reaction came in this host tick, and one with contact
};

// All that a run needs.
struct Run {
  const DriveOptions& options;
  const schema::SceneT& scene;
  const schema::PresetT& preset;  // empty: none
  const std::atomic<bool>& stop;
  std::map<std::string, Session> sessions = {};  // by host
  std::vector<Car> cars = {};
  double rate = 60;
  double tick_ms = 0, worst_ms = 0;  // of the server: the mean of its busiest second, and its longest tick
  uint64_t late = 0;
  uint64_t tick = 0;        // the server's newest that the hosts know
  double server_rate = 60;  // ticks a second, until health says otherwise
  Clock::time_point start = Clock::now();

  // Of the host that publishes the obstacles, and hears how the server fares.
  Session& first() { return cars.front().session; }
  // "left: " before what is said of this car, where there are several.
  std::string named(const Car& car) const { return cars.size() > 1 ? car.id + ": " : ""; }
};

std::string hash_of_car(const std::string& car) {
  if (car.empty()) throw std::runtime_error("no car is given: add --car FILE with the file that `crumple serve` has");
  if (is_hash(car)) return car;
  const std::string bytes = read_file(car, asset_limit, "give the file that `crumple bake` wrote, or its hash");
  return hash_of(bytes.data(), bytes.size());
}

void took(Run& run, uint64_t tick) { run.tick = std::max(run.tick, tick); }

template <class Command>
void attempt(const std::string& what, const Command& command) {
  try {
    command();
  } catch (const Error& refused) {
    throw Error("the server refused to " + what + ": " + refused.what());
  }
}

CrumpleParameters parameters_of(const schema::ParametersT& from) {
  CrumpleParameters to = crumple_keep();
  const auto take = [](const auto& optional, float& value) {
    if (optional) value = *optional;
  };
  if (from.solver) to.solver = static_cast<int>(*from.solver);
  if (from.iterations) to.iterations = *from.iterations;
  if (from.substeps) to.substeps = *from.substeps;
  take(from.tolerance, to.tolerance);
  to.region = from.region;
  take(from.young_modulus, to.young_modulus);
  take(from.poisson_ratio, to.poisson_ratio);
  take(from.yield_strain, to.yield_strain);
  take(from.hardening, to.hardening);
  take(from.hardening_strain, to.hardening_strain);
  take(from.densification, to.densification);
  take(from.densification_strain, to.densification_strain);
  take(from.plastic_limit, to.plastic_limit);
  take(from.drag, to.drag);
  take(from.friction, to.friction);
  take(from.distance_stiffness, to.distance_stiffness);
  take(from.volume_stiffness, to.volume_stiffness);
  take(from.plasticity, to.plasticity);
  return to;
}

// Spawns a car and learns where its centre of mass is. Returns who made its mesh, and how heavy it is, in words.
std::string spawn(Run& run, Car& car) {
  const schema::SceneT& scene = run.scene;
  Session& session = car.session;
  const std::string& own = car.scene.car.empty() ? scene.car : car.scene.car;
  const std::string asset = hash_of_car(run.options.car.empty() ? own : run.options.car);
  CrumpleSpawn spawn{};
  spawn.pose = pose_of(at_start(*car.scene.hits.front(), Vector3d::Zero()));
  spawn.mass = car.scene.mass > 0 ? car.scene.mass : scene.mass;
  spawn.planar = car.planar;

  const CrumpleMesh mesh = session.mesh(asset);
  car.mass = spawn.mass > 0 ? double(spawn.mass) : double(mesh.mass);
  car.center = vector_of(mesh.center_of_mass);
  const std::string name = run.named(car);
  try {
    took(run, session.spawn(car.id, asset, spawn));
  } catch (const Error& refused) {  // an earlier run may have left its car
    attempt(name + "spawn the car: " + std::string(refused.what()), [&] { took(run, session.despawn(car.id)); });
    attempt(name + "spawn the car", [&] { took(run, session.spawn(car.id, asset, spawn)); });
  }
  for (const auto* list : {&scene.parameters, &car.scene.parameters}) {
    for (const auto& parameters : *list)
      attempt(name + "take the scene's parameters",
              [&] { took(run, session.set_parameters(car.id, parameters_of(*parameters))); });
  }
  for (const auto& parameters : run.preset.parameters)
    attempt(name + "take the preset's parameters",
            [&] { took(run, session.set_parameters(car.id, parameters_of(*parameters))); });
  session.follow(car.id);
  char text[64];
  std::snprintf(text, sizeof text, ", %.0f kg: ", car.mass);
  return mesh.name + std::string(text) + mesh.attribution;
}

// Opens a session for each host and spawns the cars.
void begin(Run& run) {
  run.cars.reserve(run.scene.cars.size());
  for (const auto& car : run.scene.cars) {
    const std::string& host = car->host.empty() ? run.options.host : car->host;
    const auto [session, fresh] = run.sessions.try_emplace(
        host, SessionOptions{run.options.connect, run.options.scene, host, run.options.network, std::chrono::seconds(5)});
    run.cars.push_back({*car,
                        !car->id.empty()         ? car->id
                        : run.options.id.empty() ? "car"
                                                 : run.options.id,
                        session->second, car->planar.value_or(run.scene.planar)});
  }
  say("%s\n", run.scene.about.c_str());
  std::string before;  // cars that are alike are named once
  for (Car& car : run.cars) {
    const std::string words = spawn(run, car);
    if (words != before) say("  car %s\n", words.c_str());
    before = words;
  }
  if (!run.preset.about.empty()) say("  %s\n", run.preset.about.c_str());
}

void publish_obstacles(Run& run) {
  std::vector<CrumpleObstacle> list;
  for (const auto& from : run.scene.obstacles) {
    CrumpleObstacle to{};
    to.id = from->id;
    to.shape = static_cast<int>(from->shape);
    if (from->size) copy(vector_of(*from->size), to.size);
    to.points = reinterpret_cast<const float*>(from->points.data());
    to.point_count = from->points.size();
    const auto& p = from->pose->position();
    const auto& q = from->pose->orientation();
    to.pose = {{p.x(), p.y(), p.z()}, {q.x(), q.y(), q.z(), q.w()}};
    if (from->velocity) copy(vector_of(*from->velocity), to.velocity);
    if (from->angular_velocity) copy(vector_of(*from->angular_velocity), to.angular_velocity);
    to.friction = from->friction;
    list.push_back(to);
  }
  run.first().publish(list);
}

bool moving_obstacles(const schema::SceneT& scene) {
  for (const auto& obstacle : scene.obstacles)
    if (obstacle->velocity || obstacle->angular_velocity) return true;
  return false;
}

void publish_poses(Run& run) {
  for (auto& [host, session] : run.sessions) {
    std::vector<CrumpleCarPose> list;
    for (const Car& car : run.cars) {
      if (&car.session != &session) continue;
      CrumpleCarPose& pose = list.emplace_back();
      pose.car = car.id.c_str();
      pose.pose = pose_of(car.moving);
      copy(car.moving.velocity, pose.velocity);
      copy(car.moving.turn, pose.angular_velocity);
      pose.seen = car.moving.seen;
    }
    session.publish(seconds_since(run.start), list);
  }
}

// The server sends health once a second.
void take_health(Run& run) {
  const auto health = run.first().health();
  if (!health) return;
  took(run, health->tick);
  run.server_rate = health->rate;
  run.tick_ms = std::max(run.tick_ms, static_cast<double>(health->tick_ms));
  run.worst_ms = std::max(run.worst_ms, static_cast<double>(health->worst_ms));
  run.late = health->late;
}

// Gives the largest displacement of a node of the skin against the direction of travel (car's frame), by the session's surface.
double crush(Car& car) {
  const auto surface = car.session.surface(car.id);
  if (!surface) return 0;
  double most = 0;
  for (uint32_t i = 0; i < surface->node_count; ++i) {
    const int16_t* d = surface->quanta + 3 * i;
    most = std::max(most, -car.travel_in_car.dot(Vector3d(d[0], d[1], d[2])));
  }
  return most * surface->quantum;
}

void take(Run& run, const CrumpleReaction& reaction, Car& car) {
  Moving& moving = car.moving;
  Result& result = car.results.back();
  const double tick = reaction.time / static_cast<double>(reaction.tick);
  const Vector3d impulse = vector_of(reaction.impulse);
  const bool contact = reaction.contacts > 0 || impulse.squaredNorm() > 0;
  const double reached = vector_of(reaction.velocity).dot(car.travel);
  if (contact && !moving.hit && !car.touched) {
    const Vector3d gained = car.planar ? Vector3d(impulse.x(), impulse.y(), 0) : impulse;  // the road takes the rest
    result.before = reached - gained.dot(car.travel) / car.mass;
  }
  if (contact) result.after = reached;
  result.peak = std::max(result.peak, impulse.norm() / (car.mass * tick));
  car.energy = reaction.energy_absorbed;
  took(run, reaction.tick);
  moving.told_seconds += tick * (moving.hit || car.touched ? static_cast<double>(reaction.tick - moving.seen) : 1);
  moving.seen = reaction.tick;
  moving.touching = contact;
  car.last = reaction;
  car.touched |= contact;
  car.told = true;
}

// Takes the reactions of this host tick.
void take_reactions(Run& run) {
  for (Car& car : run.cars) car.told = car.touched = false;
  for (auto& [host, session] : run.sessions) {
    while (const auto next = session.next_reaction()) {
      for (Car& car : run.cars) {
        if (car.id == next->car && next->tick > car.moving.seen) take(run, *next, car);
      }
    }
  }
}

// Returns whether the car now stands where the server put it.
bool react(const Run& run, Car& car) {
  Moving& moving = car.moving;
  moving.silence = car.told ? 0 : moving.silence + 1 / run.rate;
  if (!car.told) return false;
  // In the ticks that a reaction is late, braking explains less than 1 m/s; so a reaction with contact was lost.
  if (!car.touched && (!moving.hit || (vector_of(car.last.velocity) - moving.velocity).norm() < 1)) return false;
  moving.hit = true;
  adopt(car.last, moving);
  return true;
}

// Changes the velocity as the road and gravity do in one host tick. A car falls by the server's time, tick by tick as reactions
// come: by the host's time it would be pressed ever harder against the ground if the server's ticks are late.
void slow_down(bool planar, double seconds, Moving& car) {
  if (!planar) {
    const bool told = car.silence < silence;
    if (car.hit) car.velocity.z() -= gravity * (told ? car.told_seconds : seconds);
    car.told_seconds = 0;
  } else if (car.hit && !car.touching) {
    const double speed = car.velocity.norm();
    car.velocity *= speed > 0 ? std::max(0.0, speed - braking * seconds) / speed : 0;
    const double turn = car.turn.norm();
    car.turn *= turn > 0 ? std::max(0.0, turn - yaw_braking * seconds) / turn : 0;
  }
}

// Polls until the time of the next host tick.
void wait_until(Run& run, Clock::time_point next) {
  for (;;) {
    const auto left = std::chrono::duration_cast<std::chrono::microseconds>(next - Clock::now());
    if (left.count() <= 0) break;
    run.first().poll(left);
  }
  for (auto& [host, session] : run.sessions) session.poll();
}

// Puts all cars where their hit begins.
void place(Run& run, size_t hit) {
  for (Car& car : run.cars) {
    const schema::HitT& now = *car.scene.hits[hit];
    if (now.repair > 0) attempt(run.named(car) + "repair the car", [&] { took(run, car.session.repair(car.id, now.repair)); });
  }
  publish_obstacles(run);
  // At the start the hosts know every tick so far, so only reactions to this hit count.
  for (auto& [host, session] : run.sessions) {
    while (const auto stale = session.next_reaction()) took(run, stale->tick);
  }
  for (Car& car : run.cars) {
    car.moving = at_start(*car.scene.hits[hit], car.center);
    car.moving.seen = run.tick;
    car.travel = vector_of(*car.scene.hits[hit]->direction).normalized();
    car.travel_in_car = car.moving.orientation.conjugate() * car.travel;
    Result& result = car.results.emplace_back();
    result.before = result.after = car.moving.velocity.dot(car.travel);
    car.energy_before = car.energy;
  }
}

void play(Run& run, size_t hit, bool keep_publishing) {
  place(run, hit);
  double seconds = 0;
  for (const Car& car : run.cars) seconds = std::max(seconds, double(car.scene.hits[hit]->seconds));
  const double step = 1 / run.rate;
  const auto begun = Clock::now();
  const uint64_t tick_begun = run.tick;
  for (int64_t i = 0; !run.stop; ++i) {
    const double time = static_cast<double>(i) * step;
    // A server that is late in a crash is behind the host's clock, so it gets the time that it needs. Health is up to 1 s old.
    take_health(run);
    const double server_seconds = static_cast<double>(run.tick - tick_begun) / run.server_rate;
    if (time >= seconds && (server_seconds > seconds - 1.1 || time > seconds + patience)) break;
    wait_until(run, begun + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(time)));
    take_reactions(run);
    for (Car& car : run.cars) {
      const bool had_hit = car.moving.hit, placed = react(run, car);
      slow_down(car.planar, step, car.moving);
      if (!placed && i > 0) car.moving.advance(step);
      if (car.moving.hit && !had_hit)
        say("  %.2f s  %scontact at %.1f km/h\n", time, run.named(car).c_str(), 3.6 * car.results.back().before);
    }
    publish_poses(run);
    if (keep_publishing && i % std::llround(run.rate) == 0) publish_obstacles(run);
    for (Car& car : run.cars) car.results.back().dynamic = std::max(car.results.back().dynamic, crush(car));
  }
  bool any_hit = false;
  for (Car& car : run.cars) {
    car.results.back().residual = crush(car);
    car.results.back().absorbed = car.energy - car.energy_before;
    any_hit |= car.moving.hit;
  }
  say("  %.2f s  %s\n", seconds_since(begun), any_hit ? "over" : "over: nothing was hit");
}

void print_table(Run& run, double seconds) {
  int wide = 3;  // columns for the ids
  for (const Car& car : run.cars) wide = std::max(wide, int(car.id.size()));
  const bool several = run.cars.size() > 1;
  const auto first_column = [&](const char* text) { return several ? std::printf("\n  %-*s", wide, text) : std::printf("\n"); };
  first_column("car");
  std::printf("  hit  speed before  after       peak   dynamic crush  residual crush  energy absorbed");
  for (const Car& car : run.cars) {
    for (size_t i = 0; i < car.results.size(); ++i) {
      const Result& r = car.results[i];
      first_column(car.id.c_str());
      std::printf("  %3zu   %6.1f km/h  %5.1f km/h %5.1f g       %4.0f mm         %4.0f mm         %6.1f kJ", i + 1,
                  3.6 * r.before, 3.6 * r.after, r.peak / gravity, 1e3 * r.dynamic, 1e3 * r.residual, 1e-3 * r.absorbed);
    }
  }
  double bytes = 0;
  for (auto& [host, session] : run.sessions) bytes += static_cast<double>(session.statistics().surface_bytes);
  std::printf("\n\n  surface received: %.1f kB, %.0f bytes a second over %.1f s\n", 1e-3 * bytes, bytes / seconds, seconds);
  std::printf("  server: %.2f ms a tick in its busiest second, worst %.1f ms, %llu ticks late\n", run.tick_ms, run.worst_ms,
              static_cast<unsigned long long>(run.late));
}

}  // namespace

int drive(const DriveOptions& options, const std::atomic<bool>& stop) {
  const schema::SceneT scene = read_scene(options.file);
  const schema::PresetT preset = options.preset.empty() ? schema::PresetT{} : read_preset(options.preset);
  if (!options.id.empty() && !scene.cars.front()->id.empty())
    throw std::runtime_error(options.file + ": the scene names its cars; leave --id out");
  Run run{options, scene, preset, stop};
  run.rate = options.rate > 0 ? options.rate : scene.rate;
  begin(run);
  const bool keep_publishing = !moving_obstacles(scene);
  const size_t hits = scene.cars.front()->hits.size();
  run.start = Clock::now();
  for (size_t i = 0; i < hits && !stop; ++i) {
    float fastest = 0;
    for (const auto& car : scene.cars) fastest = std::max(fastest, car->hits[i]->speed_kmh);
    say("hit %zu of %zu: %.1f km/h\n", i + 1, hits, double(fastest));
    play(run, i, keep_publishing);
  }
  print_table(run, seconds_since(run.start));
  for (Car& car : run.cars) {
    if (!options.leave) attempt(run.named(car) + "despawn the car", [&] { car.session.despawn(car.id); });
  }
  return stop ? 1 : 0;
}

}  // namespace crumple::client

// The host that follows a script. In each host tick it takes the reactions, moves the car, and publishes its pose. After a
// reaction with contact, pose and velocity become those that the server reached: while reactions come, the newest is less than
// a tick old, so this is the pose at which the next tick begins. Without contact the host's own motion goes on, because a
// reaction is one or two ticks old and does not know yet that the car brakes.
#include "cpp/drive.h"

#include <Eigen/Geometry>
#include <chrono>
#include <cmath>
#include <crumple.hpp>
#include <cstdio>
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

// All that a run needs.
struct Run {
  const DriveOptions& options;
  const schema::SceneT& scene;
  const schema::PresetT& preset;  // empty: none
  const std::atomic<bool>& stop;
  Session session;
  double rate = 60, mass = 0;
  double tick_ms = 0, worst_ms = 0;  // of the server: the mean of its busiest second, and its longest tick
  uint64_t late = 0;
  CrumpleReaction last{};   // the newest
  uint64_t tick = 0;        // the server's newest that this host knows
  double server_rate = 60;  // ticks a second, until health says otherwise
  double energy = 0;        // J, absorbed since spawn, by the last reaction
  Clock::time_point start = Clock::now();
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

// Spawns the car and learns where its centre of mass is.
Vector3d begin(Run& run) {
  Session& session = run.session;
  const std::string asset = hash_of_car(run.options.car.empty() ? run.scene.car : run.options.car);
  const Moving first = at_start(*run.scene.hits.front(), Vector3d::Zero());
  const std::string& id = run.options.id;
  CrumpleSpawn spawn{};
  spawn.pose = pose_of(first);
  spawn.mass = run.scene.mass;
  spawn.planar = run.scene.planar;

  const CrumpleMesh mesh = session.mesh(asset);
  run.mass = run.scene.mass > 0 ? run.scene.mass : mesh.mass;
  try {
    took(run, session.spawn(id, asset, spawn));
  } catch (const Error& refused) {  // an earlier run may have left its car
    attempt("spawn the car: " + std::string(refused.what()), [&] { took(run, session.despawn(id)); });
    attempt("spawn the car", [&] { took(run, session.spawn(id, asset, spawn)); });
  }
  for (const auto& parameters : run.scene.parameters)
    attempt("take the scene's parameters", [&] { took(run, session.set_parameters(id, parameters_of(*parameters))); });
  for (const auto& parameters : run.preset.parameters)
    attempt("take the preset's parameters", [&] { took(run, session.set_parameters(id, parameters_of(*parameters))); });
  session.follow(id);
  say("%s\n  car %s, %.0f kg: %s\n", run.scene.about.c_str(), mesh.name, run.mass, mesh.attribution);
  if (!run.preset.about.empty()) say("  %s\n", run.preset.about.c_str());
  return vector_of(mesh.center_of_mass);
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
  run.session.publish(list);
}

bool moving_obstacles(const schema::SceneT& scene) {
  for (const auto& obstacle : scene.obstacles)
    if (obstacle->velocity || obstacle->angular_velocity) return true;
  return false;
}

void publish_pose(Run& run, const Moving& car) {
  CrumpleCarPose pose{};
  pose.car = run.options.id.c_str();
  pose.pose = pose_of(car);
  copy(car.velocity, pose.velocity);
  copy(car.turn, pose.angular_velocity);
  pose.seen = car.seen;
  run.session.publish(seconds_since(run.start), {&pose, 1});
}

// The server sends health once a second.
void take_health(Run& run) {
  const auto health = run.session.health();
  if (!health) return;
  took(run, health->tick);
  run.server_rate = health->rate;
  run.tick_ms = std::max(run.tick_ms, static_cast<double>(health->tick_ms));
  run.worst_ms = std::max(run.worst_ms, static_cast<double>(health->worst_ms));
  run.late = health->late;
}

// Gives the largest displacement of a node of the skin against the direction of travel (car's frame), by the session's surface.
double crush(Run& run, const Vector3d& travel) {
  const auto surface = run.session.surface(run.options.id);
  if (!surface) return 0;
  double most = 0;
  for (uint32_t i = 0; i < surface->node_count; ++i) {
    const int16_t* d = surface->quanta + 3 * i;
    most = std::max(most, -travel.dot(Vector3d(d[0], d[1], d[2])));
  }
  return most * surface->quantum;
}

// Takes the reactions of this host tick. Returns whether the car now stands where the server put it.
bool react(Run& run, const Vector3d& travel, Moving& car, Result& result) {
  bool touched = false, any = false;
  while (const auto next = run.session.next_reaction()) {
    const CrumpleReaction& reaction = *next;
    if (run.options.id != reaction.car || reaction.tick <= car.seen) continue;
    const double tick = reaction.time / static_cast<double>(reaction.tick);
    const Vector3d impulse = vector_of(reaction.impulse);
    const bool contact = reaction.contacts > 0 || impulse.squaredNorm() > 0;
    const double reached = vector_of(reaction.velocity).dot(travel);
    if (contact && !car.hit && !touched) result.before = reached - impulse.dot(travel) / run.mass;
    if (contact) result.after = reached;
    result.peak = std::max(result.peak, -impulse.dot(travel) / (run.mass * tick));
    run.energy = reaction.energy_absorbed;
    took(run, reaction.tick);
    car.told_seconds += tick * (car.hit || touched ? static_cast<double>(reaction.tick - car.seen) : 1);
    car.seen = reaction.tick;
    car.touching = contact;
    run.last = reaction;
    touched |= contact;
    any = true;
  }
  car.silence = any ? 0 : car.silence + 1 / run.rate;
  if (!any) return false;
  // In the ticks that a reaction is late, braking explains less than 1 m/s; so a reaction with contact was lost.
  if (!touched && (!car.hit || (vector_of(run.last.velocity) - car.velocity).norm() < 1)) return false;
  car.hit = true;
  adopt(run.last, car);
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
    run.session.poll(left);
  }
  run.session.poll();
}

Result play(Run& run, const schema::HitT& hit, const Vector3d& center, bool keep_publishing) {
  if (hit.repair > 0) attempt("repair the car", [&] { took(run, run.session.repair(run.options.id, hit.repair)); });
  publish_obstacles(run);
  Moving car = at_start(hit, center);
  // At the start it knows every tick so far, so only reactions to this hit count.
  while (const auto stale = run.session.next_reaction()) took(run, stale->tick);
  car.seen = run.tick;
  const Vector3d travel = vector_of(*hit.direction).normalized(), in_car = car.orientation.conjugate() * travel;
  Result result;
  result.before = result.after = car.velocity.dot(travel);
  const double energy_before = run.energy, step = 1 / run.rate;
  const auto begun = Clock::now();
  const uint64_t tick_begun = run.tick;
  for (int64_t i = 0; !run.stop; ++i) {
    const double time = static_cast<double>(i) * step;
    // A server that is late in a crash is behind the host's clock, so it gets the time that it needs. Health is up to 1 s old.
    take_health(run);
    const double server_seconds = static_cast<double>(run.tick - tick_begun) / run.server_rate;
    if (time >= hit.seconds && (server_seconds > hit.seconds - 1.1 || time > hit.seconds + patience)) break;
    wait_until(run, begun + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(time)));
    const bool had_hit = car.hit, placed = react(run, travel, car, result);
    slow_down(run.scene.planar, step, car);
    if (!placed && i > 0) car.advance(step);
    publish_pose(run, car);
    if (keep_publishing && i % std::llround(run.rate) == 0) publish_obstacles(run);
    result.dynamic = std::max(result.dynamic, crush(run, in_car));
    if (car.hit && !had_hit) say("  %.2f s  contact at %.1f km/h\n", time, 3.6 * result.before);
  }
  result.residual = crush(run, in_car);
  result.absorbed = run.energy - energy_before;
  say("  %.2f s  %s\n", seconds_since(begun), car.hit ? "over" : "over: nothing was hit");
  return result;
}

void print_table(Run& run, const std::vector<Result>& results, double seconds) {
  std::printf("\n  hit  speed before  after       peak   dynamic crush  residual crush  energy absorbed\n");
  for (size_t i = 0; i < results.size(); ++i) {
    const Result& r = results[i];
    std::printf("  %3zu   %6.1f km/h  %5.1f km/h %5.1f g       %4.0f mm         %4.0f mm         %6.1f kJ\n", i + 1,
                3.6 * r.before, 3.6 * r.after, r.peak / gravity, 1e3 * r.dynamic, 1e3 * r.residual, 1e-3 * r.absorbed);
  }
  const auto bytes = static_cast<double>(run.session.statistics().surface_bytes);
  std::printf("\n  surface received: %.1f kB, %.0f bytes a second over %.1f s\n", 1e-3 * bytes, bytes / seconds, seconds);
  std::printf("  server: %.2f ms a tick in its busiest second, worst %.1f ms, %llu ticks late\n", run.tick_ms, run.worst_ms,
              static_cast<unsigned long long>(run.late));
}

}  // namespace

int drive(const DriveOptions& options, const std::atomic<bool>& stop) {
  const schema::SceneT scene = read_scene(options.file);
  const schema::PresetT preset = options.preset.empty() ? schema::PresetT{} : read_preset(options.preset);
  Run run{options, scene, preset, stop,
          Session({options.connect, options.scene, options.host, options.network, std::chrono::seconds(5)})};
  run.rate = options.rate > 0 ? options.rate : scene.rate;
  const Vector3d center = begin(run);
  const bool keep_publishing = !moving_obstacles(scene);
  std::vector<Result> results;
  run.start = Clock::now();
  for (size_t i = 0; i < scene.hits.size() && !stop; ++i) {
    say("hit %zu of %zu: %.1f km/h\n", i + 1, scene.hits.size(), scene.hits[i]->speed_kmh);
    results.push_back(play(run, *scene.hits[i], center, keep_publishing));
  }
  print_table(run, results, seconds_since(run.start));
  if (!options.leave) attempt("despawn the car", [&] { run.session.despawn(options.id); });
  return stop ? 1 : 0;
}

}  // namespace crumple::client

// What the server keeps between ticks. Cars and hosts stand in the order of their ids, and every loop over them runs in it.
#pragma once

#include <tbb/enumerable_thread_specific.h>
#include <tbb/task_arena.h>

#include <array>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "car/car.h"
#include "sim/deform.h"
#include "sim/transfer.h"
#include "tick/reconcile.h"
#include "tick/surface_update.h"
#include "tick/world.h"

namespace crumple {

// An asset, and the others of the same surface with fewer nodes, in descending order.
using Levels = std::vector<std::shared_ptr<const Car>>;

// What is about to touch a car that nothing touches: something that stands still beside it, or something that may hit it.
enum class Ahead : uint8_t { nothing, neighbour, hit };

struct Instance {
  const Levels* levels = nullptr;  // front: as spawned, and the asset that viewers are told of; the surface is the same
  std::shared_ptr<const Car> car;  // the level that the body is on
  uint64_t level_tick = 0;         // in which it came to it
  float importance = 1;            // as its host said last
  std::string host;                // whose poses move it
  Mass mass;
  Parameters parameters;
  DeformableState body;
  Motion motion;
  ImpulseLog log;
  uint64_t touched_tick = 0;  // the last in which an obstacle touched it; 0: never
  // Hashes of what is large, kept because most cars are idle in most ticks; keyframe and latest of each surface level.
  struct {
    uint64_t body = 0, log = 0;
    std::array<uint64_t, surface_levels.size()> keyframe{}, latest{};
  } hashes;
  std::array<ViewerState, surface_levels.size()> told;
  // The last ticks', from which this one's share of the budget follows.
  uint16_t sweeps = 0;    // of a sub-step, that it may make at most
  uint16_t substeps = 0;  // in 1/60 s, as its parameters have them or fewer
  StepResult result;
  uint8_t fresh = 0;  // ticks in which more of it may take part than did in the last one: it is being woken
  // The last tick could change nothing of it, and nothing that it depends on has changed since: nor does this one.
  bool idle = false;
  // Of one tick.
  std::optional<Intent> intent;  // the latest; consumed
  Ahead ahead = Ahead::nothing;
  float width = 0;                        // of the narrowest obstacle that is near, m
  std::shared_ptr<const Car> next_level;  // that it comes to; null: it stays
  bool changed = false;                   // it came to another
  uint64_t order = 0;                     // among the cars of the scene, by their ids
  std::array<SurfaceUpdate, surface_levels.size()> news;
};

// A host lives as long as it has cars or obstacles; its sequence numbers are forgotten with it.
struct Host {
  std::optional<uint64_t> poses_sequence, obstacles_sequence;  // of the last message
  uint32_t cars = 0;
  uint32_t obstacles = 0;  // in World::obstacles, behind those of the hosts before it
};

// Times of a room over the ticks since the last health.
enum class Stage : uint8_t { decode, contacts, solve, flow, surface, tick };
inline constexpr std::array stage_names = {"decode", "contacts", "solve", "flow", "surface", "tick"};
using StageTimes = std::array<double, stage_names.size()>;  // s

struct Tally {
  std::array<uint64_t, reason_count> refusals{};
  std::string last_refusal;
  uint64_t messages = 0;
  uint64_t contact_overflows = 0;    // car ticks in which a node met too many obstacles
  uint64_t recoveries = 0;           // car ticks that ended non-finite and were undone
  uint64_t shed = 0, work_shed = 0;  // tet visits asked for and not allowed: in the last tick, in all
  uint64_t work = 0;                 // tet visits of the last tick
  // Since the last health:
  uint64_t most_work = 0;                       // of a tick
  double residual_sum = 0, residual_worst = 0;  // m, of the cars that were solved
  uint64_t solved = 0;                          // car ticks
  uint64_t ticks = 0;
  StageTimes now{}, sum{}, worst{};
};

// A worker's memory, reused from car to car.
struct Worker {
  ScratchHandle scratch = make_scratch();
  std::vector<Vec3> displaced;  // nodes of the skin, from rest, m
  std::vector<int16_t> displacement;
  StageTimes times{};
};

struct World {
  double rate = 60;         // ticks a second
  float quantum = 0.0005f;  // m
  Limits limits;
  uint64_t budget = 0;                                                 // tet visits a tick; 0: as many as are asked for
  std::map<std::string, Levels> assets;                                // by hash
  std::list<Levels> uploaded;                                          // by who plays, the oldest first: of one level each
  std::map<std::pair<std::string, std::string>, LevelMap> level_maps;  // by hashes: from, to
  uint64_t tick = 0;                                                   // ticks done, or the one being done
  std::map<std::string, Instance> cars;
  std::map<std::string, Host> hosts;
  std::vector<Obstacle> obstacles;  // of all hosts: by host, then by id
  bool obstacles_changed = true;    // since the last tick

  Tally tally;
  TickResult result;  // of the tick being done
  std::function<double()> clock;
  std::optional<tbb::task_arena> arena;
  int arena_threads = 0;
  tbb::enumerable_thread_specific<Worker> workers;
};

// Viewers are told of the car anew in the next tick.
void renew(Instance&);

// Seconds from construction to destruction, added to a room's time; nothing without a clock.
struct Watch {
  const std::function<double()>& clock;
  double& seconds;
  double start;
  Watch(const std::function<double()>& c, double& s) : clock(c), seconds(s), start(c ? c() : 0) {}
  ~Watch() {
    if (clock) seconds += clock() - start;
  }
  Watch(const Watch&) = delete;
  Watch& operator=(const Watch&) = delete;
};

}  // namespace crumple

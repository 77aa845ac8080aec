// The state that the server keeps between ticks. Cars and hosts are sorted by id, and every loop over them runs in this order.
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

// An asset, then its coarser levels: the assets with the same surface and fewer nodes, in descending order.
using Levels = std::vector<std::shared_ptr<const Car>>;

// Whether something is about to touch a free car: nothing, a thing that stands still beside it, or a thing that may hit it.
enum class Ahead : uint8_t { nothing, neighbour, hit };

struct Instance {
  const Levels* levels = nullptr;  // front: the spawned asset, which viewers see; all have its surface
  std::shared_ptr<const Car> car;  // the level that the body is on
  uint64_t level_tick = 0;         // tick in which the body came to this level
  float importance = 1;            // last value from its host
  std::string host;                // whose poses move the car
  Mass mass;
  Parameters parameters;
  DeformableState body;
  Motion motion;
  ImpulseLog log;
  uint64_t touched_tick = 0;  // last tick in which an obstacle or a car touched it; 0: never
  // Hashes of the large parts, kept because most cars are idle in most ticks; keyframe and latest per surface level.
  struct {
    uint64_t body = 0, log = 0;
    std::array<uint64_t, surface_levels.size()> keyframe{}, latest{};
  } hashes;
  std::array<ViewerState, surface_levels.size()> told;  // what viewers received last, per surface level
  // Limits and result of the last tick; the budget of this tick follows from them.
  uint16_t sweeps = 0;    // most sweeps per sub-step
  uint16_t substeps = 0;  // in 1/60 s: as the parameters say, or fewer
  StepResult result;
  uint8_t fresh = 0;  // ticks left in which more of the body may wake than was awake in the last one
  // True if the last tick left the car unchanged and none of its inputs has changed since, so this tick can be skipped.
  bool idle = false;
  // Used within one tick:
  bool placed = false;  // a command made its body anew, or its host put it elsewhere, so no crash brought it to its place
  std::optional<Intent> intent;                    // the latest; consumed
  Eigen::Vector3d pull = Eigen::Vector3d::Zero();  // acceleration that its host gives it while it touches something, m/s^2
  Ahead ahead = Ahead::nothing;
  uint64_t key = 0;                       // names the car to the cars that it touches: hash of its id
  std::vector<uint32_t> near;             // positions (`order`) of the cars that may come near
  float width = 0;                        // width of the narrowest near obstacle, m
  std::shared_ptr<const Car> next_level;  // the level to change to; null: no change
  bool changed = false;                   // its level changed in this tick
  uint64_t order = 0;                     // position among the scene's cars, sorted by id
  std::array<SurfaceUpdate, surface_levels.size()> news;
};

// A host exists as long as it has cars or obstacles. Its sequence numbers are forgotten with it.
struct Host {
  std::optional<uint64_t> poses_sequence, obstacles_sequence;  // of the last message
  uint32_t cars = 0;
  uint32_t obstacles = 0;  // number of its obstacles; in World::obstacles they follow the obstacles of the hosts before it
};

// Parts of a tick whose times health reports.
enum class Stage : uint8_t { decode, contacts, solve, flow, surface, tick };
inline constexpr std::array stage_names = {"decode", "contacts", "solve", "flow", "surface", "tick"};
using StageTimes = std::array<double, stage_names.size()>;  // s

struct Tally {
  std::array<uint64_t, reason_count> refusals{};
  std::string last_refusal;
  uint64_t messages = 0;
  uint64_t contact_overflows = 0;    // car ticks in which a node met too many obstacles
  uint64_t recoveries = 0;           // car ticks that ended with a number that is not finite and were undone
  uint64_t shed = 0, work_shed = 0;  // tet visits asked for but not allowed: in the last tick, in all ticks
  uint64_t work = 0;                 // tet visits of the last tick
  // Since the last health:
  uint64_t most_work = 0;                         // of one tick
  uint64_t most_islands = 0, largest_island = 0;  // islands of several cars in one tick; cars of the largest one
  double residual_sum = 0, residual_worst = 0;    // m, over the solved cars
  uint64_t solved = 0;                            // car ticks
  uint64_t ticks = 0;
  StageTimes now{}, sum{}, worst{};
};

// A worker's memory, reused from car to car.
struct Worker {
  std::vector<ScratchHandle> scratch;  // one per car of an island; the first one always exists
  std::vector<Obstacle> obstacles;     // and boxes around near cars
  std::vector<Vec3> displaced;         // displacements of the skin's nodes, m
  std::vector<int16_t> displacement;
  StageTimes times{};

  Worker() { scratch.push_back(make_scratch()); }
};

struct World {
  double rate = 60;         // ticks a second
  float quantum = 0.0005f;  // m
  Limits limits;
  uint64_t budget = 0;                                                 // tet visits per tick; 0: no limit
  std::map<std::string, Levels> assets;                                // by hash
  std::list<Levels> uploaded;                                          // uploaded assets, the oldest first; one level each
  std::map<std::pair<std::string, std::string>, LevelMap> level_maps;  // keys: hashes of the two meshes, from and to
  uint64_t tick = 0;                                                   // number of ticks done, the current one included
  std::map<std::string, Instance> cars;
  std::map<std::string, Host> hosts;
  std::vector<Obstacle> obstacles;  // of all hosts, sorted by host, then by id
  bool obstacles_changed = true;    // since the last tick

  Tally tally;
  TickResult result;  // of the current tick
  std::function<double()> clock;
  std::optional<tbb::task_arena> arena;
  int arena_threads = 0;
  tbb::enumerable_thread_specific<Worker> workers;
};

// Sends viewers a keyframe of the car in the next tick.
void renew(Instance&);

// Adds the seconds from construction to destruction to `seconds`; does nothing without a clock.
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

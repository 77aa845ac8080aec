// One car, one tick: the table of contents of the simulation. Rooms: obstacles into the car's frame (contacts), solve
// (nodal or classic), flow, skin. A function of its arguments alone: no clock, no thread count, no memory of other cars.
#pragma once

#include <algorithm>
#include <cmath>
#include <memory>
#include <span>

#include "sim/body.h"
#include "sim/contacts.h"
#include "sim/motion.h"
#include "sim/obstacle.h"

namespace crumple {

// Sub-steps are a share of time, not of a tick, so that the tick rate does not change the crush. They are halved, up to
// halvings times, while in one of them the car would meet an obstacle by more than substep_travel (m; an edge of a 10,000-node
// car), or contacts would turn its motion by more than substep_turn radians (their force is stepped explicitly). Who asks for
// fewer sub-steps than the default asks for as much more of both: on a mesh whose edges are longer it costs little accuracy.
inline double substep_seconds(int substeps) { return 1.0 / (60.0 * substeps); }
inline double substep_seconds(const Parameters& parameters) { return substep_seconds(parameters.substeps); }
inline double coarseness(const Parameters& parameters) {
  return std::max(1.0, double(Parameters{}.substeps) / double(parameters.substeps));
}
inline constexpr double substep_travel = 0.08;
inline constexpr double substep_turn = 1.1;
inline constexpr int halvings = 3;

// What the tick did to the rigid motion. World axes; about the centre of mass.
struct Response {
  Eigen::Vector3d impulse = Eigen::Vector3d::Zero();          // N s
  Eigen::Vector3d angular_impulse = Eigen::Vector3d::Zero();  // N m s
  float deepest = 0;                                          // the farthest that an obstacle pushed a node, m
  uint32_t contacts = 0;                                      // nodes held at the end
  uint32_t substeps = 0;                                      // solved; 0: nothing was near and the body was settled
  uint32_t sweeps = 0;                                        // of all sub-steps together
  uint64_t work = 0;                                          // tets visited by sweeps
  float residual = 0;             // what the last sweeps of a sub-step moved, rms over awake nodes, the largest, m
  bool contact_overflow = false;  // a node met more than contacts_per_node obstacles: the deepest were kept
  bool recovered = false;         // the tick ended non-finite and was undone: the body stands as before it
};

// Seconds spent in each room, for health; measured by the caller's clock, so that this room knows none.
enum class Room : uint8_t { contacts, solve, flow };
struct Timer {
  virtual ~Timer() = default;
  virtual void enter(Room) = 0;
  virtual void leave() = 0;
};

// Memory of one tick; one a thread, reused.
struct Scratch;
struct ScratchDeleter {
  void operator()(Scratch*) const;
};
using ScratchHandle = std::unique_ptr<Scratch, ScratchDeleter>;
ScratchHandle make_scratch();

// Advances body and motion by `seconds`. The obstacles stand at their poses at the start of the tick and move steadily.
Response deform(const Model&, const Parameters&, const Mass&, std::span<const Obstacle>, double seconds, Scratch&, Body&,
                Motion&, Timer* = nullptr);

// Whether deform() will solve the settled body.
bool wakes(const Model&, const Parameters&, const Mass&, std::span<const Obstacle>, double seconds, Scratch&, const Body&,
           Motion);

// Sub-steps of a tick, for so many in 1/60 s; before they are halved.
inline int substep_count(int substeps, double seconds) {
  return std::max(1, int(std::lround(seconds / substep_seconds(substeps))));
}

// Surface vertices in the car's frame. vertex: as many as the model's.
void skin(const Model&, const Body&, std::span<Vec3> vertex);

// Displacements of these nodes from rest, car's frame, m. out: as many as nodes.
void displace(const Model&, const Body&, std::span<const uint32_t> nodes, std::span<Vec3> out);

}  // namespace crumple

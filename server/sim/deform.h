// One car, one tick: the table of contents of the simulation. In order: obstacles in the car's frame (contacts.h), how many
// sub-steps (substeps.h), and in each of them whether the body is at rest (rest.h), the shape (nodal.h, or classic.h), plastic
// flow (flow.h), what the car's motion loses (energy_balance.h); at the end what went wrong (recovery.h). A function of its
// arguments alone: no clock, no thread count, no memory of other cars.
#pragma once

#include <memory>

#include "sim/step.h"
#include "sim/substeps.h"

namespace crumple {

// Seconds spent in each room, for health; measured by the caller's clock, so that this room knows none.
enum class Room : uint8_t { contacts, solve, flow };
struct Timer {
  virtual ~Timer() = default;
  virtual void enter(Room) = 0;
  virtual void leave() = 0;
};

// Memory of one tick (scratch.h); one a thread, reused.
struct Scratch;
struct ScratchDeleter {
  void operator()(Scratch*) const;
};
using ScratchHandle = std::unique_ptr<Scratch, ScratchDeleter>;
ScratchHandle make_scratch();

// Advances body and motion by input.seconds.
StepResult deform(const StepInput&, Scratch&, DeformableState&, Motion&, Timer* = nullptr);

// Whether deform() will solve the settled body.
bool wakes(const StepInput&, Scratch&, const DeformableState&, Motion);

}  // namespace crumple

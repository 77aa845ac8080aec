// One tick of one car: the table of contents of the simulation. In order: candidates for contact (contacts.h), the number of
// sub-steps (substeps.h), then in each sub-step: is the body at rest (rest.h), its new shape (nodal.h, or classic.h), plastic
// flow (flow.h), and the change of the car's motion (energy_balance.h); at the end recovery from failures (recovery.h). The
// result depends on the arguments alone: not on a clock, the number of threads, or other cars.
#pragma once

#include <memory>

#include "sim/step.h"
#include "sim/substeps.h"

namespace crumple {

// Measures the seconds spent in each part of the tick, for health. The caller supplies the clock, so the tick reads none.
enum class Room : uint8_t { contacts, solve, flow };
struct Timer {
  virtual ~Timer() = default;
  virtual void enter(Room) = 0;
  virtual void leave() = 0;
};

// Memory of one tick (scratch.h); one per thread, reused.
struct Scratch;
struct ScratchDeleter {
  void operator()(Scratch*) const;
};
using ScratchHandle = std::unique_ptr<Scratch, ScratchDeleter>;
ScratchHandle make_scratch();

// Advances body and motion by input.seconds.
StepResult deform(const StepInput&, Scratch&, DeformableState&, Motion&, Timer* = nullptr);

// Whether deform() would wake and solve this settled body.
bool wakes(const StepInput&, Scratch&, const DeformableState&, Motion);

}  // namespace crumple

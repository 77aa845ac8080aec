// One tick of cars that may touch one another, or of one car: the table of contents of the simulation. In order: candidates for
// contact with obstacles (contacts.h) and cars (pairs.h), the number of sub-steps (substeps.h), then each sub-step
// (step_group.h): is the body at rest (rest.h), its new shape (nodal.h, or classic.h), plastic flow (flow.h), and the change of
// the cars' motion (energy_balance.h); at the end recovery from failures (recovery.h). The result depends on the arguments
// alone: not on a clock or the number of threads.
#pragma once

#include <memory>

#include "sim/island.h"
#include "sim/step.h"
#include "sim/substeps.h"
#include "sim/timer.h"

namespace crumple {

// Memory of one tick (scratch.h); one per thread, reused.
struct Scratch;
struct ScratchDeleter {
  void operator()(Scratch*) const;
};
using ScratchHandle = std::unique_ptr<Scratch, ScratchDeleter>;
ScratchHandle make_scratch();

// Advances the bodies and motions of an island by input.seconds, which is the same for all. A car alone takes the same steps as
// in the function below. Cars with Solver::classic do not touch other cars.
void deform(std::span<Member>, Timer* = nullptr);

// Advances body and motion of one car by input.seconds.
StepResult deform(const StepInput&, Scratch&, DeformableState&, Motion&, Timer* = nullptr);

}  // namespace crumple

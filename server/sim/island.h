// Cars that may touch one another within a tick. They are solved together; the result does not depend on their order.
#pragma once

#include <vector>

#include "sim/step.h"

namespace crumple {

struct Scratch;

struct Member {
  StepInput input;
  uint64_t key;  // names the car to the others, in all ticks
  Scratch& scratch;
  StepState state;
  const std::vector<uint32_t>* near = nullptr;  // cars of the island that it may touch, ascending; null: all
};

}  // namespace crumple

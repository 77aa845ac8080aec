// Says before the tick whether it will solve a settled body, so that the budget counts its work.
#pragma once

#include "sim/deform.h"

namespace crumple {

// Whether deform() would wake and solve this settled body.
bool wakes(const StepInput&, Scratch&, const DeformableState&, Motion);

}  // namespace crumple

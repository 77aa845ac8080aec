// Finds the outside of a car's tets (sim/boundary.h). That takes milliseconds, so the file does not contain it.
#pragma once

#include "sim/boundary.h"
#include "sim/model.h"

namespace crumple {

Boundary make_boundary(const Model&);

}  // namespace crumple

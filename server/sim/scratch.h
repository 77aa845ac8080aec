// Memory of one worker, reused from car to car: each part is written by the file that declares it. Between two ticks it keeps
// its capacity, and for how many cars the team goes on without helpers, which changes nothing but time. All else is written in
// a tick before it is read there.
#pragma once

#include <vector>

#include "sim/contacts.h"
#include "sim/nodal.h"
#include "sim/recovery.h"

namespace crumple {

struct Scratch {
  ContactSet contacts;
  NodalSolver solver;
  std::vector<Vec3> start;  // of deform.cpp: node positions at the start of the sub-step, m
  Backup backup;
};

}  // namespace crumple

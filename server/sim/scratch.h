// Memory of one worker, reused from car to car. Only the file that declares a part writes it. Between ticks the memory keeps
// its capacity and the number of cars that the team still solves without helpers; that number affects only time. Everything
// else is written in a tick before it is read.
#pragma once

#include <vector>

#include "sim/contacts.h"
#include "sim/nodal.h"
#include "sim/pairs.h"
#include "sim/recovery.h"

namespace crumple {

struct Scratch {
  ContactSet contacts;
  NodalSolver solver;
  std::vector<Vec3> start;  // used by step_group.cpp: node positions at the start of the sub-step, m
  Backup backup;
  // Of the island whose first car has this memory:
  Team team;
  std::vector<PairCandidates> pairs;
};

}  // namespace crumple

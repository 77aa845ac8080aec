// Memory of one tick, reused; nothing in it survives a tick.
#pragma once

#include <array>
#include <vector>

#include "sim/contacts.h"
#include "sim/deform.h"
#include "sim/flow.h"
#include "sim/kernels.h"
#include "sim/team.h"

namespace crumple {

// What a contact did in the last sweep, for force and friction.
struct Held {
  bool active = false;
  Vec3 force = Vec3::Zero();  // of the obstacle on the node, N, car's frame
};

struct Scratch {
  std::vector<Candidates> candidates;
  std::vector<Contact> contacts;        // sorted by node
  std::vector<uint32_t> contact_first;  // per node: its first contact + 1; 0: none
  std::vector<Held> held;               // per contact
  std::vector<Vec3> start;              // node positions at the start of the sub-step
  // Of `nodal`, as its kernels want them (kernels.h).
  std::vector<Quad> node, before, rest, direction;  // n + 1, padded to whole rounds of 16 floats
  std::vector<Quad> stiffness;                      // t, padded, + 1
  std::vector<TetLanes> tets;
  std::vector<Weights> weights;
  std::vector<uint8_t> region;              // t, padded
  std::vector<Law> law;                     // per region
  std::vector<uint16_t> flowing;            // per group of tets: which are beyond yield
  std::vector<std::array<double, 6>> sums;  // of pieces of work, added in their order
  std::vector<uint16_t> still;              // per block
  std::vector<uint16_t> touched;            // per block
  std::vector<uint8_t> awake;               // per block: 0 at rest, 1 solved, 2 solved and has moved
  std::vector<uint8_t> stirred;             // per group: one of its blocks is awake
  // Of mixing.h.
  std::vector<Quad> from;                       // nodes before the sweep
  std::vector<Quad> residual, result, unmixed;  // of the last step; nodes as the last sweep left them
  double residual_size = 0;                     // squared, m^2
  bool compared = false, mixed = false;         // there is a last step in this sub-step; it was mixed
  double volume = 0;                            // of all tets at rest, m^3
  Team team;
  Body backup;            // as the tick found it
  bool prepared = false;  // the tick has begun to change the body
};

}  // namespace crumple

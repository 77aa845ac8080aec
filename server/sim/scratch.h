// Memory of one tick, reused; nothing in it survives a tick.
#pragma once

#include <vector>

#include "sim/contacts.h"
#include "sim/deform.h"
#include "sim/flow.h"

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
  std::vector<Vec3> before;             // node positions at the start of the sub-step
  std::vector<Mat3> deformation;        // per tet: F
  std::vector<Elastic> stiffness;       // per tet: secant moduli times volume, N m (gamma unscaled)
  std::vector<float> drag;              // per node: c / h, N/m
  std::vector<float> anchor;            // per node: anchor spring, N/m; 0: free
  std::vector<Vec3> pair_start;         // node positions before a pair of sweeps
  std::vector<Vec3> direction;          // of a line search
  float volume = 0;                     // of all tets at rest, m^3
  Body backup;                          // as the tick found it
};

}  // namespace crumple

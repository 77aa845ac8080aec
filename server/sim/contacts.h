// Contacts: which planes keep which nodes out of which obstacles during one sub-step, in the car's frame.
// A node starts each sub-step outside (or on) every obstacle, so the plane that separates it at the start, carried along to
// the end, keeps it on the side it came from: however thin the obstacle and however fast, it cannot be passed.
#pragma once

#include <limits>
#include <span>
#include <vector>

#include "sim/step.h"

namespace crumple {

inline constexpr int contacts_per_node = 3;  // three planes pin a point; beyond that the deepest are kept
// A contact is looked for this much before it is met, m: neighbours push nodes about within a sub-step.
inline constexpr float contact_margin = 0.03f;
// A node that starts inside an obstacle (one that was born there) leaves it at this speed, m/s, not at once.
inline constexpr float push_out_speed = 10.0f;

// From the car's frame to an obstacle's: local = rotation * x + translation.
struct Relative {
  Mat3 rotation;
  Vec3 translation;
};
Relative relative(const Pose& car, const Pose& obstacle);

struct Contact {
  uint32_t node;
  uint32_t obstacle;
  Vec3 normal;   // unit, car's frame at the end of the sub-step
  float offset;  // the node must keep normal . x >= offset
  float before;  // signed distance at the start of the sub-step, m
  float after;   // at its end, if the node stood still in the car's frame, m
  Vec3 carried;  // where the node would be if it stuck to the obstacle
  float friction;
};

// Nodes that can meet an obstacle within the tick.
struct Candidates {
  uint32_t obstacle;
  std::vector<uint32_t> node;
};

// What a contact does in a sub-step, as the solver leaves it.
struct ContactForce {
  bool active = false;
  Vec3 force = Vec3::Zero();  // of the obstacle on the node, N, car's frame
};

// The contacts of one car; written by the functions below and by nobody else.
struct ContactSet {
  std::vector<Candidates> candidate;  // of the tick: per obstacle that is near
  std::vector<Contact> contact;       // of the sub-step; sorted by node, at most contacts_per_node each
  std::vector<uint32_t> first;        // per node: its first contact + 1; 0: none (index_contacts)

  bool holds(size_t node) const { return first[node] != 0; }
  // Whether it is the first of its node: for what is done once a node.
  bool is_first(const Contact& c) const { return first[c.node] == size_t(&c - contact.data()) + 1; }
};

// What a car meets, if it and all obstacles move on steadily.
struct Encounter {
  bool near = false;  // a node may meet one
  // The box around the body meets one, and they move at all: not what it passes by, drives along or stands beside. Seen at
  // moments a metre apart, so not what is thinner than the car and crosses it sideways in between.
  bool hit = false;
  float width = std::numeric_limits<float>::infinity();  // of the narrowest one near, m
};
Encounter encounter(const StepInput&, const DeformableState&, const Motion&);

// The choice of candidates, once a tick, from the car's and the obstacles' steady motions. An obstacle that comes may push the
// car on into another one within the tick: nodes are candidates of all as far away as any of them moves against the car.
void find_candidates(const StepInput&, const DeformableState&, const Motion&, ContactSet&);

// The way of the car's frame in one sub-step, which is `seconds` long and starts at `start` seconds into the tick.
struct FramePath {
  Pose from, to;
  double start, seconds;
};

// Contacts of one sub-step. Returns false if some node met more than contacts_per_node: the deepest are kept.
bool find_contacts(const DeformableState&, std::span<const Obstacle>, const FramePath&, ContactSet&);

// After it, where nodes are asked for their contacts.
void index_contacts(size_t nodes, ContactSet&);

}  // namespace crumple

// Contacts: planes in the car's frame that keep nodes out of obstacles during one sub-step.
// A node starts each sub-step outside (or on) every obstacle. The plane that separates the two at the start is carried along to
// the end and keeps the node on its side, so a node cannot pass an obstacle, however thin or fast the obstacle is.
#pragma once

#include <limits>
#include <span>
#include <vector>

#include "sim/step.h"

namespace crumple {

inline constexpr int contacts_per_node = 3;  // three planes pin a point; of more the deepest are kept
// A contact is created when the gap is smaller than this, m: neighbours push nodes about within a sub-step.
inline constexpr float contact_margin = 0.03f;
// A node that starts inside an obstacle (one that was created there) leaves it at this speed, m/s, not at once.
inline constexpr float push_out_speed = 10.0f;

// Transform from the car's frame to an obstacle's frame: local = rotation * x + translation.
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

// The nodes that may meet one obstacle within the tick.
struct Candidates {
  uint32_t obstacle;
  std::vector<uint32_t> node;
};

// The force of a contact in a sub-step, as the solver computed it.
struct ContactForce {
  bool active = false;
  Vec3 force = Vec3::Zero();  // that the obstacle exerts on the node, N, car's frame
};

// The contacts of one car. Only the functions below write it.
struct ContactSet {
  std::vector<Candidates> candidate;  // per near obstacle, for the whole tick
  std::vector<Contact> contact;       // of this sub-step; sorted by node, at most contacts_per_node each
  std::vector<uint32_t> first;        // per node: index of its first contact + 1; 0: none (index_contacts)
  std::vector<uint32_t> loose;        // anchored nodes on their way back, which nothing touches any more (hold_anchors)

  bool holds(size_t node) const { return first[node] != 0; }
  // Whether this is its node's first contact, for work that is done once per node.
  bool is_first(const Contact& c) const { return first[c.node] == size_t(&c - contact.data()) + 1; }
};

// The obstacles that a car meets in this tick if it and all obstacles move on steadily.
struct Encounter {
  bool near = false;  // a node may meet an obstacle
  // The body's bounding box meets an obstacle, and the two move against each other. Obstacles that the car passes, drives along
  // or stands beside do not count. The box is tested at moments at most a metre of travel apart, so an obstacle thinner than
  // the car that crosses it sideways in between is missed.
  bool hit = false;
  float width = std::numeric_limits<float>::infinity();  // width of the narrowest near obstacle, m
};
Encounter encounter(const StepInput&, const DeformableState&, const Motion&);

// Chooses the candidates once a tick, from the steady motions of the car and the obstacles. An obstacle may push the car into
// another, so every obstacle uses the largest relative travel of any. travel: the same of other cars, m; 0: none is near.
void find_candidates(const StepInput&, const DeformableState&, const Motion&, ContactSet&, float travel = 0);

// How the car's frame moves in one sub-step, which lasts `seconds` and starts `start` seconds into the tick.
struct FramePath {
  Pose from, to;
  double start, seconds;
};

// Finds the contacts of one sub-step. Returns false if a node met more than contacts_per_node planes; the deepest are kept.
bool find_contacts(const DeformableState&, std::span<const Obstacle>, const FramePath&, ContactSet&);

// Fills contacts.first. Call it after find_contacts() and before anything looks up contacts by node.
void index_contacts(size_t nodes, ContactSet&);

}  // namespace crumple

// Contacts between cars in one sub-step: a boundary node of one car against a boundary triangle of another, both ways. Each car
// stays in its own frame. A contact presses with max(0, pressure - stiffness * gap); solver steps move the rest into `pressure`
// until the gap closes (augmented Lagrangian), and friction likewise. So cars that touch are solved together, and a force is
// the same for both.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "sim/contacts.h"
#include "sim/island.h"

namespace crumple {

struct PairContact {
  uint32_t car[2];     // [0] has the node, [1] the triangle
  uint32_t node;       // of car[0]
  uint32_t corner[3];  // of car[1]
  Vec3 weight;         // of the corners, at the point of the triangle under the node
  Vec3 normal;         // unit, from the triangle to the node, frame of car[1] at the end of the sub-step
  Vec3 own_normal;     // the same in the frame of car[0]
  Mat3 rotation;       // from the frame of car[0] to that of car[1], at the end
  float constant;      // gap = own_normal . node - normal . point + constant, m
  Vec3 offset;         // slip = rotation node - point + offset, m: the node's way over the point since the start
  float friction;
  float before, after;  // gap at the start, and at the end if both bodies stood still in their frames, m
  float motion;         // the node's way over the triangle by the motion of the frames alone, m

  // Of the solver:
  float stiffness = 0;       // N/m
  float pressure = 0;        // N, >= 0
  Vec3 rub = Vec3::Zero();   // friction, N, frame of car[1]
  float start_pressure = 0;  // both at the start of the sub-step
  Vec3 start_rub = Vec3::Zero();
  Vec3 seen_node, seen_point;  // where both were when the sweep began, each in its frame, m

  // At the end:
  float pressed = 0;          // normal force, N
  Vec3 force = Vec3::Zero();  // on the node, N, frame of car[1]
  float heat = 0;             // work of friction, J

  float gap(const Vec3& at, const Vec3& point) const { return own_normal.dot(at) - normal.dot(point) + constant; }
  Vec3 slip(const Vec3& at, const Vec3& point) const {
    const Vec3 way = rotation * at - point + offset;
    return way - normal.dot(way) * normal;
  }
};

// The contacts in which each node of one car takes part.
struct PairIndex {
  static constexpr uint32_t own = 3;  // `which`: its car has the node; else the corner of the triangle
  struct Entry {
    uint32_t contact, which;
  };
  std::vector<uint32_t> node;   // that take part, ascending
  std::vector<uint32_t> first;  // n + 1: entry[first[i] .. first[i + 1])
  std::vector<Entry> entry;
  bool holds(size_t i) const { return !first.empty() && first[i] < first[i + 1]; }
};

// Cars of an island that contacts connect in this sub-step. car[k] of a contact is an index of `member`.
struct PairGroup {
  std::vector<uint32_t> member;  // of the island, ascending
  std::vector<PairContact> contact;
  std::vector<PairIndex> index;  // per member of the group
};

// Nodes of one car that may meet triangles of another in this tick.
struct PairCandidates {
  uint32_t car[2];
  std::vector<uint32_t> node, triangle;
};

// Chooses the candidates once a tick. Returns per car how far another one may move against it, m; 0: none is near. Cars that
// came to be inside each other are no candidates until they have parted. Notes in the bodies which cars are near.
std::vector<float> find_pair_candidates(std::span<Member>, std::vector<PairCandidates>&);

// Finds the contacts of a sub-step that lasts `seconds`, and groups all cars of the island by them. from, to: the cars' poses.
// share: per car, `seconds` divided by the length of its last sub-step.
std::vector<PairGroup> find_pairs(std::span<const Member>, std::span<const PairCandidates>, std::span<const Pose> from,
                                  std::span<const Pose> to, std::span<const float> share, double seconds);

// The force of a contact if its node and the triangle's point are there, each in its frame.
struct PairForce {
  float normal;   // N, >= 0
  Vec3 friction;  // N, frame of car[1]
  float stick;    // stiffness of friction, N/m: less than the contact's where it slips
};
PairForce pair_force(const PairContact&, const Vec3& node, const Vec3& point);

// Keeps the contacts that press for the next sub-step, in the memory of the node's car.
void remember_pairs(std::span<Member>, const PairGroup&);

}  // namespace crumple

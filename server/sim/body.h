// The state that a car's body keeps between ticks, and nothing else: two runs are equal if the hashes of this state are.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "sim/anderson.h"
#include "sim/material.h"
#include "sim/model.h"
#include "sim/motion.h"

namespace crumple {

// The body's memory of other cars: its contacts with them in the last sub-step, and the cars that were near.
struct PairMemory {
  struct Touch {
    uint64_t partner;  // Member::key of the other car
    uint32_t node;     // of this body
    Vec3 normal;       // unit, from the partner's surface to the node, in the partner's frame
    float pressure;    // N
    Vec3 friction;     // N, on the node, in the partner's frame
  };
  struct Push {
    uint64_t partner;
    Eigen::Vector3d force;  // N, on this body at the end of the last sub-step, world axes: a part of DeformableState::force
    bool operator==(const Push&) const = default;
  };
  std::vector<Touch> touch;       // ascending by node
  std::vector<Push> push;         // ascending by partner
  std::vector<uint64_t> near;     // keys of the cars that were near in the last tick, ascending
  std::vector<uint64_t> passing;  // of these the ones that it passes through, because they came to be inside each other
};
static_assert(sizeof(PairMemory::Touch) == 40 && sizeof(PairMemory::Push) == 32);  // no padding: they are hashed

struct DeformableState {
  std::vector<Vec3> node;            // positions, car's frame, m
  std::vector<Vec3> step;            // displacement of the last sub-step, m: the predictor's history
  float step_seconds = 0;            // duration of that sub-step; 0: none was made yet
  std::vector<Gradients> gradients;  // per tet: rest gradients after plastic flow, 1/m
  std::vector<float> hardening;      // per tet: accumulated plastic strain
  std::vector<float> edge_rest;      // rest lengths of `classic`, m
  std::vector<float> tet_rest;       // rest volumes of `classic`, m^3
  AndersonHistory history;           // the solver's last steps; empty when settled
  PairMemory pairs;
  double absorbed = 0;  // energy absorbed since spawn by plastic work, drag and friction, J
  double stored = 0;    // elastic energy now, J
  double anchors = 0;   // part of `stored` in the springs of anchored nodes, J
  double owed = 0;      // part of `stored` that the motion did not give, J: the body may not return it
  // Set by measure_reach(): the nodes' farthest distance from the centre of mass, and their bounding box in the car's frame, m.
  float reach = 0;
  Vec3 low = Vec3::Zero(), high = Vec3::Zero();
  // Total contact force (N) and moment about the centre of mass (N m) at the end of the last sub-step, world axes.
  Eigen::Vector3d force = Eigen::Vector3d::Zero();
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();
  bool touching = false;  // an obstacle or another car held some node in the last sub-step
  float drift = 0;        // how far obstacles and cars slid along the settled body since it settled, m
  bool lost = false;      // no crash makes this shape: the body springs back before anything flows
  bool settled = true;    // no node moved in the last sub-step: the body costs nothing until touched
};

// ---- the list of its fields ----

// A list field has one value per node, tet or edge.
enum class Per : uint8_t { node, tet, edge };
inline size_t count_of(const Model& model, Per per) {
  return per == Per::node ? model.node.size() : per == Per::tet ? model.tet.size() : model.edge.size();
}

// How the functions below treat a field, besides copying it.
struct FieldTraits {
  bool saved = false;         // State of the protocol has it
  bool transferred = false;   // transfer() copies it unchanged to another level
  bool repaired = false;      // a partial repair moves it towards its value in an undamaged car
  bool not_negative = false;  // true: refuse numbers below 0; false: any finite number is good
};

template <class T>
struct ListField {
  const char* name;  // its name in State, if saved
  std::vector<T> DeformableState::*value;
  Per per;
  std::span<const T> Model::*rest;  // its values in an undamaged car; null: zeros
  FieldTraits traits;
};
template <class Field>
concept IsList = requires(Field field) {
  field.per;
};

template <class T>
struct SingleField {
  const char* name;
  T DeformableState::*value;
  FieldTraits traits;
};

// Lists every field once, except those that measure_reach() computes. Hash and snapshot use this order. All code that treats a
// body field by field calls this with a visitor for ListField and SingleField: make_body, repair, refuse_state, hash
// (body.cpp), restore (recovery.cpp), transfer (transfer.cpp), snapshots (tick/fields.h), State (wire/state_fields.h).
template <class Visit>
constexpr void for_each_field(const Visit& visit) {
  using enum Per;
  visit(ListField<Vec3>{"node", &DeformableState::node, node, &Model::node, {.saved = true, .repaired = true}});
  visit(ListField<Vec3>{"step", &DeformableState::step, node, nullptr, {}});
  visit(ListField<Gradients>{
      "gradients", &DeformableState::gradients, tet, &Model::gradients, {.saved = true, .repaired = true}});
  visit(ListField<float>{
      "hardening", &DeformableState::hardening, tet, nullptr, {.saved = true, .repaired = true, .not_negative = true}});
  visit(ListField<float>{"edge_rest",
                         &DeformableState::edge_rest,
                         edge,
                         &Model::edge_rest,
                         {.saved = true, .repaired = true, .not_negative = true}});
  visit(ListField<float>{"tet_rest", &DeformableState::tet_rest, tet, &Model::tet_rest, {.saved = true, .repaired = true}});
  visit(SingleField<double>{"absorbed", &DeformableState::absorbed, {.saved = true, .transferred = true}});
  visit(SingleField<double>{"stored", &DeformableState::stored, {.saved = true, .transferred = true}});
  visit(SingleField<double>{"anchors", &DeformableState::anchors, {.not_negative = true}});
  visit(SingleField<double>{"owed", &DeformableState::owed, {.transferred = true, .not_negative = true}});
  visit(SingleField<bool>{"touching", &DeformableState::touching, {}});
  visit(SingleField<bool>{"settled", &DeformableState::settled, {.saved = true, .transferred = true}});
  visit(SingleField<bool>{"lost", &DeformableState::lost, {.transferred = true}});
  visit(SingleField<float>{"drift", &DeformableState::drift, {.not_negative = true}});
  visit(SingleField<float>{"step_seconds", &DeformableState::step_seconds, {.not_negative = true}});
  visit(SingleField<AndersonHistory>{"history", &DeformableState::history, {}});
  visit(SingleField<PairMemory>{"pairs", &DeformableState::pairs, {}});
  visit(SingleField<Eigen::Vector3d>{"force", &DeformableState::force, {}});
  visit(SingleField<Eigen::Vector3d>{"moment", &DeformableState::moment, {}});
}

// The value of list entry i in an undamaged car.
template <class T>
T rest_of(const Model& model, const ListField<T>& field, size_t i) {
  if (field.rest) return (model.*field.rest)[i];
  if constexpr (std::is_same_v<T, Vec3>) return Vec3::Zero();
  return T{};
}

// ---- what can be done with a body ----

// An undamaged car.
DeformableState make_body(const Model&);

// Takes `amount` of the damage away: 1 gives the undamaged car, bit for bit.
void repair(const Model&, float amount, DeformableState&);

// Recomputes reach, low and high. Call it after nodes moved.
void measure_reach(const Model&, DeformableState&);

// Says why these fields cannot be a body of this car: a list has the wrong size, or a number is not finite or is negative where
// it must not be. saved: check only the fields that State has.
[[nodiscard]] std::optional<std::string> refuse_fields(const Model&, const DeformableState&, bool saved);

// Says why the fields of a State cannot be this car's: the reasons above, or a node is farther than 10 m from rest.
[[nodiscard]] std::optional<std::string> refuse_state(const Model&, const DeformableState&);

// XXH64 over everything in the body.
uint64_t hash(const DeformableState&);

}  // namespace crumple

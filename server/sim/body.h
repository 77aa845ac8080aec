// What one car keeps between ticks, and nothing else: its hash decides whether two runs are the same.
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

struct DeformableState {
  std::vector<Vec3> node;            // positions, car's frame, m
  std::vector<Vec3> step;            // displacement of the last sub-step, m: the predictor's history
  float step_seconds = 0;            // that it took; 0: none was made yet
  std::vector<Gradients> gradients;  // per tet: rest gradients after plastic flow, 1/m
  std::vector<float> hardening;      // per tet: accumulated plastic strain
  std::vector<float> edge_rest;      // rest lengths of `classic`, m
  std::vector<float> tet_rest;       // rest volumes of `classic`, m^3
  AndersonHistory history;           // of the solver's last steps; empty when settled
  double absorbed = 0;               // J since spawn: plastic work, drag, friction
  double stored = 0;                 // J: elastic, now
  double owed = 0;                   // J of it that the motion did not give: the body may not return them
  // Of the nodes (measure_reach): the farthest from the centre of mass, and the box around them in the car's frame; m.
  float reach = 0;
  Vec3 low = Vec3::Zero(), high = Vec3::Zero();
  // Of the contacts on the car at the end of the last sub-step, N and N m about the centre of mass, world axes.
  Eigen::Vector3d force = Eigen::Vector3d::Zero();
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();
  bool touching = false;  // some node was held by an obstacle in the last sub-step
  float drift = 0;        // way of the obstacles along a settled body since it settled, m
  bool lost = false;      // its shape is one that no crash makes: it springs back before anything flows
  bool settled = true;    // nothing moved in the last sub-step: costs nothing until touched
};

// ---- the list of its fields
// ------------------------------------------------------------------------------------------------------

// What a list has one value per.
enum class Per : uint8_t { node, tet, edge };
inline size_t count_of(const Model& model, Per per) {
  return per == Per::node ? model.node.size() : per == Per::tet ? model.tet.size() : model.edge.size();
}

// How a field is treated besides being copied.
struct FieldTraits {
  bool saved = false;         // it is part of the protocol's State
  bool transferred = false;   // it goes to another level of the car as it is
  bool repaired = false;      // a partial repair takes it towards its value in an undamaged car
  bool not_negative = false;  // else any finite number
};

template <class T>
struct ListField {
  const char* name;  // as State has it, where it is saved
  std::vector<T> DeformableState::*value;
  Per per;
  std::span<const T> Model::*rest;  // of an undamaged car; null: zeros
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

// Every field, once, but what measure_reach() makes of them. In this order the hash takes them in and a snapshot has them.
// Whoever treats a body field by field calls this with a function for ListField and SingleField: make_body, repair,
// refuse_state, hash (body.cpp), restore (recovery.cpp), transfer (transfer.cpp), snapshots (tick/fields.h), State
// (wire/state_fields.h).
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
  visit(SingleField<double>{"owed", &DeformableState::owed, {.transferred = true, .not_negative = true}});
  visit(SingleField<bool>{"touching", &DeformableState::touching, {}});
  visit(SingleField<bool>{"settled", &DeformableState::settled, {.saved = true, .transferred = true}});
  visit(SingleField<bool>{"lost", &DeformableState::lost, {.transferred = true}});
  visit(SingleField<float>{"drift", &DeformableState::drift, {.not_negative = true}});
  visit(SingleField<float>{"step_seconds", &DeformableState::step_seconds, {.not_negative = true}});
  visit(SingleField<AndersonHistory>{"history", &DeformableState::history, {}});
  visit(SingleField<Eigen::Vector3d>{"force", &DeformableState::force, {}});
  visit(SingleField<Eigen::Vector3d>{"moment", &DeformableState::moment, {}});
}

// The value at place i of a list in an undamaged car.
template <class T>
T rest_of(const Model& model, const ListField<T>& field, size_t i) {
  if (field.rest) return (model.*field.rest)[i];
  if constexpr (std::is_same_v<T, Vec3>) return Vec3::Zero();
  return T{};
}

// ---- what is done with it
// --------------------------------------------------------------------------------------------------------

// An undamaged car.
DeformableState make_body(const Model&);

// Takes `amount` of the damage away: 1 gives the undamaged car, bit for bit.
void repair(const Model&, float amount, DeformableState&);

// After nodes moved.
void measure_reach(const Model&, DeformableState&);

// Why these fields cannot be a body of this car: a list of another size, a number that is not finite or must not be negative.
// saved: of those that State has only.
[[nodiscard]] std::optional<std::string> refuse_fields(const Model&, const DeformableState&, bool saved);

// Why what State has cannot be the state of this car: as above, or nodes farther than 10 m from rest.
[[nodiscard]] std::optional<std::string> refuse_state(const Model&, const DeformableState&);

// XXH64 over everything in the body.
uint64_t hash(const DeformableState&);

}  // namespace crumple

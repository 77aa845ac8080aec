// The fields of the protocol's State beside the same fields of a body. encode_state and the Load order use this list.
#pragma once

#include "schema/message_generated.h"
#include "sim/body.h"

namespace crumple {

// Calls visit(field of DeformableState, State's accessor, StateBuilder's adder) for each field.
template <class Visit>
constexpr void for_each_saved_field(const Visit& visit) {
  using schema::State, schema::StateBuilder;
  visit(&DeformableState::node, &State::node, &StateBuilder::add_node);
  visit(&DeformableState::gradients, &State::gradients, &StateBuilder::add_gradients);
  visit(&DeformableState::hardening, &State::hardening, &StateBuilder::add_hardening);
  visit(&DeformableState::edge_rest, &State::edge_rest, &StateBuilder::add_edge_rest);
  visit(&DeformableState::tet_rest, &State::tet_rest, &StateBuilder::add_tet_rest);
  visit(&DeformableState::absorbed, &State::absorbed, &StateBuilder::add_absorbed);
  visit(&DeformableState::stored, &State::stored, &StateBuilder::add_stored);
  visit(&DeformableState::settled, &State::settled, &StateBuilder::add_settled);
}

// The body's list marks the fields of State; both lists must agree.
static_assert(
    [] {
      int marked = 0, here = 0;
      for_each_field([&](const auto& field) { marked += field.traits.saved; });
      for_each_saved_field([&](auto...) { ++here; });
      return marked == here;
    }(),
    "a field of DeformableState is marked `saved` and is not in for_each_saved_field, or the other way round");

}  // namespace crumple

// Anderson's acceleration of a fixed-point iteration. A solver step (some sweeps) is a map x -> g(x). At the solution the
// residual f = g - x is zero. Anderson combines the changes of f and g over the last few steps so that the residual would be
// smallest, and continues from there. Changes of earlier sub-steps help as much as this one's, because a crash changes slowly:
// they contain the slow, long waves of the error that sweeps hardly move, and the plastic softening that secant moduli hide.
// Measured on three cars (50 km/h wall and pole, sub-steps of 1/960 s): 6 sweeps a sub-step leave an error of 0.03-0.8 %;
// without acceleration 100 sweeps leave more. D. G. Anderson 1965; H. F. Walker, P. Ni 2011, doi 10.1137/10078356X; in physics
// simulation: Y. Peng et al. 2018.
//
// All lists of nodes have the solver's padding: padded_nodes() Float4s, a multiple of four (blocks.h).
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "sim/team.h"
#include "sim/vector.h"

namespace crumple {

inline constexpr int anderson_depth = 6;  // changes kept: two lists of nodes each, per moving body

// What a body keeps from one sub-step to the next. Cleared when it settles.
struct AndersonHistory {
  int count = 0;                                                                 // number of changes, at most anderson_depth
  int next = 0;                                                                  // slot that is overwritten next
  std::array<std::vector<Float4>, anderson_depth> residual, result;              // changes of f and g, m
  std::array<std::array<double, anderson_depth>, anderson_depth> products = {};  // dot products of the changes of f, m^2
};

// Whether the solver can continue with this history, for a body of this many nodes. Foreign bytes may hold anything.
[[nodiscard]] bool is_sound(const AndersonHistory&, size_t nodes);

// Calls visit on each field, to write, read or hash them.
template <class History, class Visit>
void each_field(History& history, const Visit& visit) {
  visit(history.count);
  visit(history.next);
  for (auto& list : history.residual) visit(list);
  for (auto& list : history.result) visit(list);
  visit(history.products);
}

// The last step of the current sub-step. One per worker; its lists are reused.
struct AndersonStep {
  std::vector<Float4> residual, result;  // f and g
  std::vector<Float4> unmixed;           // nodes after the last sweeps, before mix()
  double residual_size = 0;              // squared length of f, m^2
  double new_size = 0;                   // used by compare(): the same, before it is known whether the step is undone
  bool compared = false;                 // this sub-step has a last step, and it was not undone
  bool mixed = false;                    // mix() chose the start of the next step
};

// One car in an iteration. Cars that touch one another are solved together: their nodes are parts of one long x, in a fixed
// order.
struct AndersonPart {
  std::span<const Float4> before;  // nodes before the step
  std::span<Float4> node;          // nodes after it
  AndersonStep& last;
  AndersonHistory& history;
  Team& team;
};

// Begins a sub-step: histories stay, but steps of two sub-steps are not compared. Histories of cars that did not step together
// before are cleared.
void begin_substep(std::span<const AndersonPart>);

// Call it after a step that led from `before` to `node`. Adds the change since the previous step to the histories, and measures
// the residuals. If the last mix() made the residual more than twice as large, this undoes it in `node` and clears the
// histories: sweeps alone always descend.
void compare(std::span<const AndersonPart>);

// Moves `node` to the start of the next step.
void mix(std::span<const AndersonPart>);

}  // namespace crumple

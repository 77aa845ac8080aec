// Anderson's acceleration of a fixed-point iteration. A step of the solver (some sweeps) is a map x -> g(x), and the solution
// is where its residual f = g - x is zero. From the changes of f and g over the last few steps it takes the combination that
// would make the residual smallest, and goes on from there. The changes of earlier sub-steps serve as well as this one's, since
// a crash changes slowly: they know the slow, long waves of the error that sweeps hardly move, and the plastic softening that
// their secant moduli hide. Measured on three cars (50 km/h wall and pole, sub-steps of 1/960 s): 6 sweeps a sub-step leave
// 0.03-0.8 % where without it 100 sweeps leave more. D. G. Anderson 1965; H. F. Walker, P. Ni 2011, doi 10.1137/10078356X; in
// physics simulation: Y. Peng et al. 2018.
//
// All lists of nodes are as the solver's are: as many Float4s as its padding asks for, a multiple of four (kernels.h).
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "sim/team.h"
#include "sim/vector.h"

namespace crumple {

inline constexpr int anderson_depth = 6;  // changes that are kept: two lists of nodes each, per moving body

// What a body keeps from one sub-step to the next; forgotten when it settles.
struct AndersonHistory {
  int count = 0;                                                                 // of changes, at most anderson_depth
  int next = 0;                                                                  // which of them is overwritten next
  std::array<std::vector<Float4>, anderson_depth> residual, result;              // changes of f and g, m
  std::array<std::array<double, anderson_depth>, anderson_depth> products = {};  // dot products of the changes of f, m^2
};

// Whether the solver can go on with it, for a body of this many nodes: damaged or foreign bytes may hold anything.
[[nodiscard]] bool is_sound(const AndersonHistory&, size_t nodes);

// Calls visit(each field) for one that writes, reads or sums them up.
template <class History, class Visit>
void each_field(History& history, const Visit& visit) {
  visit(history.count);
  visit(history.next);
  for (auto& list : history.residual) visit(list);
  for (auto& list : history.result) visit(list);
  visit(history.products);
}

// The last step of the sub-step that is being solved. One a worker; its lists are reused.
class Anderson {
 public:
  // A sub-step begins: the history stays, but steps are not compared across it.
  void begin();

  // After a step that led from `before` to `node`: takes what it changed against the step before it into the history, and how
  // far it went. If the acceleration before it made the residual more than twice as large, that is undone in `node` and all is
  // forgotten: sweeps alone always descend.
  void compare(std::span<const Float4> before, std::span<Float4> node, Team&, AndersonHistory&);

  // Moves `node` to where the next step shall start.
  void mix(std::span<Float4> node, Team&, const AndersonHistory&);

  // Squared length of the last step, m^2. `compared`: there is a last step in this sub-step, and it was not undone.
  double residual_size() const { return residual_size_; }
  bool compared() const { return compared_; }

 private:
  std::vector<Float4> residual_, result_;  // f and g of the last step
  std::vector<Float4> unmixed_;            // nodes as the last sweeps left them, once they were mixed
  double residual_size_ = 0;
  bool compared_ = false, mixed_ = false;  // mixed: the next step starts where mix() put it
};

}  // namespace crumple

// What `--budget-ms` is in tet visits, the unit of the world's budget. Learned from ticks that say something about it: long
// ones, and those whose work was cut short. Before the first of them a warm-up says it.
#pragma once

#include <cstdint>
#include <optional>

#include "tick/world.h"

namespace crumple {

class BudgetEstimator {
 public:
  // limit: s a tick; 0: none.
  explicit BudgetEstimator(double limit) : limit_(limit) {}
  bool is_limited() const { return limit_ > 0; }
  void warm_up(double seconds, uint64_t visits);
  void learn(double seconds, const Work&);
  // A new budget, tet visits a tick, if it differs from the last one by more than 5 %.
  std::optional<uint64_t> next();

 private:
  double limit_;
  double visit_ = 0;   // s, with all threads and whatever else a tick does; 0: not known yet
  uint64_t last_ = 0;  // budget
};

}  // namespace crumple

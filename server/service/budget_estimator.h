// Converts `--budget` to tet visits, the unit of the world's budget. It learns the time of a visit from ticks that show it:
// long ticks, and ticks whose work was cut. Before the first such tick it uses the warm-up.
#pragma once

#include <cstdint>
#include <optional>

#include "tick/world.h"

namespace crumple {

class BudgetEstimator {
 public:
  // limit: seconds per tick; 0: no limit.
  explicit BudgetEstimator(double limit) : limit_(limit) {}
  bool is_limited() const { return limit_ > 0; }
  void warm_up(double seconds, uint64_t visits);
  void learn(double seconds, const Work&);
  // The new budget in tet visits per tick, if it differs from the last one by more than 5 %.
  std::optional<uint64_t> next();

 private:
  double limit_;
  double visit_ = 0;   // seconds per visit, with all threads and everything else in a tick; 0: not known yet
  uint64_t last_ = 0;  // the last budget
};

}  // namespace crumple

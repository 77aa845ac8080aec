#include "service/budget_estimator.h"

#include <algorithm>
#include <cmath>

namespace crumple {

void BudgetEstimator::warm_up(double seconds, uint64_t visits) {
  if (visits > 0) visit_ = seconds / double(visits);
}

void BudgetEstimator::learn(double seconds, const Work& work) {
  if (work.done == 0 || (seconds < 0.5 * limit_ && work.shed == 0)) return;
  const double now = seconds / double(work.done);
  visit_ = visit_ > 0 ? 0.8 * visit_ + 0.2 * now : now;
}

std::optional<uint64_t> BudgetEstimator::next() {
  if (limit_ == 0 || visit_ == 0) return std::nullopt;
  const double budget = std::max(1.0, limit_ / visit_);
  if (std::abs(budget - double(last_)) <= 0.05 * double(last_)) return std::nullopt;
  return last_ = uint64_t(budget);
}

}  // namespace crumple

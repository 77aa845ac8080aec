// Times the stages of a car's tick for health. The caller supplies the clock, so the tick reads none.
#pragma once

#include <cstdint>

namespace crumple {

enum class SolveStage : uint8_t { contacts, solve, flow };

struct Timer {
  virtual ~Timer() = default;
  virtual void enter(SolveStage) = 0;
  virtual void leave() = 0;
};

// Enters a stage, and leaves it at the end of the block. timer: null if nobody measures.
class StageTimer {
 public:
  StageTimer(Timer* timer, SolveStage stage) : timer_(timer) {
    if (timer_) timer_->enter(stage);
  }
  ~StageTimer() {
    if (timer_) timer_->leave();
  }
  StageTimer(const StageTimer&) = delete;
  StageTimer& operator=(const StageTimer&) = delete;

 private:
  Timer* timer_;
};

}  // namespace crumple

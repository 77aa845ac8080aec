// Tests the threads that help with one car: which thread does a piece, and when the caller works alone.
#include "sim/team.h"

#include <gtest/gtest.h>
#include <tbb/task_arena.h>

#include <atomic>
#include <chrono>
#include <thread>

namespace crumple {
namespace {

// Whether the work came in pieces instead of as a whole.
bool shared(Team& team) {
  bool pieces = false;
  std::atomic<uint32_t> done = 0;
  team.run(0, 64, 1, [&](uint32_t first, uint32_t last) {
    if (last - first == 1) pieces = true;
    done += last - first;
  });
  EXPECT_EQ(done, 64u);
  return pieces;
}

TEST(Team, GoesOnAloneForAWhileAfterHelpersHaveKeptItWaitingTwice) {
  tbb::task_arena(2).execute([] {
    const auto caller = std::this_thread::get_id();
    Team team;
    bool alone = false;
    for (int tick = 0; tick < 50 && !alone; ++tick) {
      team.gather();
      ASSERT_TRUE(shared(team)) << "tick " << tick;
      for (int phase = 0; phase < 2; ++phase) {
        std::atomic<bool> first = true;  // the system suspends a helper in the middle of a piece
        team.run(0, 64, 1, [&](uint32_t, uint32_t) {
          if (std::this_thread::get_id() == caller) return std::this_thread::yield();
          if (first.exchange(false)) std::this_thread::sleep_for(std::chrono::milliseconds(20));
        });
      }
      alone = !shared(team);
      team.leave();
    }
    if (!alone) GTEST_SKIP() << "no helper came";
    int ticks = 0;
    for (bool together = false; !together; ++ticks) {
      ASSERT_LT(ticks, 100);
      team.gather();
      together = shared(team);
      team.leave();
    }
    EXPECT_EQ(ticks, 60);
  });
}

}  // namespace
}  // namespace crumple

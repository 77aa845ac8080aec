// Tests the motion at the start of a tick, with numbers calculated by hand.
#include "tick/reconcile.h"

#include <gtest/gtest.h>

#include <limits>

namespace crumple {
namespace {

struct Meeting {
  Motion own;
  Intent intent;
  ImpulseLog log;
  Meeting(double own_x, double x, double speed, uint64_t seen) {
    own.pose.position.x() = own_x;
    intent.motion.pose.position.x() = x;
    intent.motion.velocity.x() = speed;
    intent.seen = seen;
  }
  void change(uint64_t tick, double speed, double turn) { log.add({tick, {speed, 0, 0}, {0, 0, turn}}); }
  Motion at(uint64_t now, bool touching) const { return reconcile(own, intent, log, now, touching); }
};

TEST(Reconcile, WithoutContactsTheHostsMotionIsTaken) {
  const Motion motion = Meeting(1, 2, 10, 5).at(8, false);
  EXPECT_EQ(motion.pose.position.x(), 2);
  EXPECT_EQ(motion.velocity.x(), 10);
}

TEST(Reconcile, AddsTheImpulsesThatTheHostHasNotSeen) {
  Meeting meeting(1, 2, 10, 5);
  meeting.change(4, -100, 9);  // seen
  meeting.change(5, -100, 9);  // seen
  meeting.change(6, -3, 0.5);
  meeting.change(7, -2, 0.25);
  const Motion motion = meeting.at(8, false);
  EXPECT_EQ(motion.velocity.x(), 5);
  EXPECT_EQ(motion.angular_velocity.z(), 0.75);
  EXPECT_EQ(motion.pose.position.x(), 1) << "contacts win over the path until the host knows of them";
}

TEST(Reconcile, AHostThatHasSeenAllIsFollowedOnceNothingTouches) {
  Meeting meeting(1, 2, 10, 7);
  meeting.change(7, -3, 0);
  EXPECT_EQ(meeting.at(8, false).velocity.x(), 10);
  EXPECT_EQ(meeting.at(8, false).pose.position.x(), 2);
  EXPECT_EQ(meeting.at(8, true).pose.position.x(), 1);
}

TEST(Reconcile, AScriptedCarKeepsItsVelocityAndYieldsItsPathOnlyWhileTouching) {
  Meeting meeting(1, 2, 10, 0);
  meeting.change(6, -3, 0);
  EXPECT_EQ(meeting.at(8, false).velocity.x(), 10);
  EXPECT_EQ(meeting.at(8, false).pose.position.x(), 2);
  EXPECT_EQ(meeting.at(8, true).velocity.x(), 10);
  EXPECT_EQ(meeting.at(8, true).pose.position.x(), 1);
}

TEST(Reconcile, AJumpOfMoreThanFiveMetresIsATeleport) {
  EXPECT_EQ(Meeting(0, 5, 0, 0).at(8, true).pose.position.x(), 0);
  EXPECT_EQ(Meeting(0, 5.001, 0, 0).at(8, true).pose.position.x(), 5.001);
}

TEST(Reconcile, TheLogHolds64Ticks) {
  Meeting meeting(0, 0, 0, 1);
  for (uint64_t k = 1; k <= 100; ++k) meeting.change(k, 1, 0);
  EXPECT_EQ(meeting.at(101, false).velocity.x(), 64);
  EXPECT_EQ(meeting.at(200, false).velocity.x(), 0) << "what is older is forgotten";
  meeting.intent.seen = std::numeric_limits<uint64_t>::max();
  EXPECT_EQ(meeting.at(101, false).velocity.x(), 0);
}

}  // namespace
}  // namespace crumple

#include "tick/reconcile.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

namespace crumple {

ImpulseLog::Change ImpulseLog::since(uint64_t seen, uint64_t now) const {
  Change sum;
  for (uint64_t k = now > changes.size() ? now - changes.size() : 1; k < now; ++k) {
    const Change& change = changes[k % changes.size()];
    if (k <= seen || change.tick != k) continue;
    sum.tick = k;
    sum.velocity += change.velocity;
    sum.angular_velocity += change.angular_velocity;
  }
  return sum;
}

uint64_t hash(const ImpulseLog& log) {
  static_assert(sizeof(ImpulseLog::Change) == sizeof(uint64_t) + 6 * sizeof(double));
  return XXH64(log.changes.data(), sizeof log.changes, 0);
}

Motion reconcile(const Motion& own, const Intent& intent, const ImpulseLog& log, uint64_t now, bool touching) {
  Motion motion = intent.motion;
  const bool far = (motion.pose.position - own.pose.position).norm() > teleport;
  bool contact_wins = touching && !far;
  if (intent.seen != 0) {
    const ImpulseLog::Change unseen = log.since(intent.seen, now);
    motion.velocity += unseen.velocity;
    motion.angular_velocity += unseen.angular_velocity;
    // At any distance: if ticks are late in a crash, a host that has not yet received the reaction is far ahead without meaning
    // a teleport.
    contact_wins = contact_wins || unseen.tick != 0;
  }
  if (contact_wins) motion.pose = own.pose;
  return motion;
}

}  // namespace crumple

// The hash of everything that the next tick depends on, field by field in a fixed order: two runs are the same if theirs are.
// What is large (body, surfaces) is hashed where it changes, by the worker that changed it.
#define XXH_INLINE_ALL
#include <xxhash.h>

#include "state.h"

namespace crumple {
namespace {

// XXH64 of a stream of numbers and texts.
class Sum {
 public:
  Sum() { XXH64_reset(&state_, 0); }
  void add(const void* data, size_t size) { XXH64_update(&state_, data, size); }
  void add(double value) { add(&value, sizeof value); }
  void add(uint64_t value) { add(&value, sizeof value); }
  void add(const std::string& text) {
    add(uint64_t(text.size()));
    add(text.data(), text.size());
  }
  void add(const Eigen::Vector3d& v) { add(v.data(), 3 * sizeof(double)); }
  void add(const Pose& pose) {
    add(pose.position);
    add(pose.orientation.coeffs().data(), 4 * sizeof(double));
  }
  void add(const Motion& motion) {
    add(motion.pose);
    add(motion.velocity);
    add(motion.angular_velocity);
  }
  void add(const std::optional<uint64_t>& value) {
    add(uint64_t(value.has_value()));
    add(value.value_or(0));
  }
  uint64_t value() const { return XXH64_digest(&state_); }

 private:
  XXH64_state_t state_;
};

void add(const Parameters& parameters, Sum& sum) {
  static_assert(sizeof(Material) == 9 * sizeof(float));
  sum.add(uint64_t(parameters.solver));
  sum.add(uint64_t(parameters.iterations));
  sum.add(double(parameters.tolerance));
  sum.add(uint64_t(parameters.substeps));
  sum.add(parameters.region.data(), sizeof parameters.region);
}

void add(const Instance& car, Sum& sum) {
  sum.add(car.levels->front()->hash);
  sum.add(car.car->hash);
  sum.add(uint64_t(car.sweeps));
  sum.add(uint64_t(car.substeps));
  sum.add(uint64_t(car.fresh));
  sum.add(uint64_t(car.response.sweeps));
  sum.add(uint64_t(car.response.substeps));
  sum.add(car.response.work);
  sum.add(double(car.response.residual));
  sum.add(car.level_tick);
  sum.add(double(car.importance));
  sum.add(car.host);
  sum.add(car.mass.mass);
  sum.add(car.mass.inertia);
  sum.add(car.mass.center);
  sum.add(uint64_t(car.mass.planar));
  add(car.parameters, sum);
  sum.add(car.hashes.data(), sizeof car.hashes);
  sum.add(car.motion);
  for (const ImpulseLog::Change& change : car.log.changes) {
    sum.add(change.tick);
    sum.add(change.velocity);
    sum.add(change.angular_velocity);
  }
  sum.add(car.touched_tick);
  for (const Told& told : car.told) {
    sum.add(told.keyframe_tick);
    sum.add(uint64_t(told.due) + 2 * uint64_t(told.flowing));
  }
}

void add(const Obstacle& obstacle, Sum& sum) {
  static_assert(sizeof(Plane) == 4 * sizeof(float));
  sum.add(uint64_t(obstacle.faces.size()));
  sum.add(obstacle.faces.data(), obstacle.faces.size() * sizeof(Plane));
  for (float number : {obstacle.half_length, obstacle.radius, obstacle.reach, obstacle.friction}) sum.add(double(number));
  sum.add(obstacle.pose);
  sum.add(obstacle.velocity);
  sum.add(obstacle.angular_velocity);
}

}  // namespace

uint64_t hash(const World& world) {
  Sum sum;
  sum.add(world.tick);
  sum.add(world.rate);
  sum.add(double(world.quantum));
  sum.add(world.budget);
  for (const auto& [id, car] : world.cars) {
    sum.add(id);
    add(car, sum);
  }
  for (const auto& [id, host] : world.hosts) {
    sum.add(id);
    sum.add(host.poses_sequence);
    sum.add(host.obstacles_sequence);
    sum.add(uint64_t(host.cars));
    sum.add(uint64_t(host.obstacles));
  }
  for (const Obstacle& obstacle : world.obstacles) add(obstacle, sum);
  return sum.value();
}

}  // namespace crumple

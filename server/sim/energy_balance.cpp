#include "sim/energy_balance.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/scratch.h"

namespace crumple {
namespace {

using Eigen::Vector3d;

constexpr double least_share = 0.5, most_share = 2;  // of the mean impulse
constexpr double most_correction = 0.5;              // of the largest impulse of a group's cars
constexpr double slow_way = 0.3;                     // m/s: slower contacts lose way, so that what is pulled down comes to rest
constexpr double calm_seconds = 0.02;                // in which they do

// World axes; `angular` about the centre of mass. A force (N) and its moment (N m), or an impulse (N s, N m s).
struct Load {
  Vector3d linear = Vector3d::Zero(), angular = Vector3d::Zero();
};

Load operator*(double by, const Load& load) { return {by * load.linear, by * load.angular}; }
Load operator+(const Load& a, const Load& b) { return {a.linear + b.linear, a.angular + b.angular}; }

// The linear part of the load of one car on another in a sub-step.
struct PartnerLoad {
  uint64_t key;                         // of the other car
  Vector3d before = Vector3d::Zero();   // force at the end of the last sub-step, N
  Vector3d now = Vector3d::Zero();      // and of this one
  Vector3d balance = Vector3d::Zero();  // impulse that balances the energy, before it is scaled, N s
  Vector3d calm = Vector3d::Zero();     // impulse that damps slow contacts, N s
  uint32_t contacts = 0;
};
using PartnerLoads = std::vector<std::vector<PartnerLoad>>;  // per car of the group, ascending by key

PartnerLoad& load_of(uint64_t key, std::vector<PartnerLoad>& partner_loads) {
  auto at = std::lower_bound(partner_loads.begin(), partner_loads.end(), key,
                             [](const PartnerLoad& each, uint64_t wanted) { return each.key < wanted; });
  if (at == partner_loads.end() || at->key != key) at = partner_loads.insert(at, PartnerLoad{key});
  return *at;
}

Vector3d center(const Member& car) {
  const Pose& pose = car.state.motion.pose;
  return pose.position + pose.orientation * car.input.mass.center;
}

// Where a node is, world.
Vector3d place(const Member& car, uint32_t node) {
  const Pose& pose = car.state.motion.pose;
  return pose.position + pose.orientation * car.state.body.node[node].cast<double>();
}

// The velocity of an obstacle at a contact, m/s, world.
Vector3d velocity_of(const Member& car, const Contact& contact, const Substep& now) {
  const Obstacle& obstacle = car.input.obstacles[contact.obstacle];
  const Vector3d arm = place(car, contact.node) - obstacle.pose.position - now.start * obstacle.velocity;
  return obstacle.velocity + obstacle.angular_velocity.cross(arm);
}

// Calls visit(contact, force) for the obstacles' contacts that press.
template <class Visit>
void for_each_pressing(const Member& car, const Visit& visit) {
  const std::vector<ContactForce>& held = car.scratch.solver.contact_forces;
  for (size_t k = 0; k < held.size(); ++k) {
    if (held[k].active) visit(car.scratch.contacts.contact[k], held[k].force);
  }
}

// Force-weighted mean velocity of what moves on whatever the cars do, where it presses on them: obstacles and cars of infinite
// mass; m/s, world.
Vector3d pressing_velocity(std::span<Member> island, const PairGroup& group, const Substep& now) {
  Vector3d sum = Vector3d::Zero();
  double forces = 0;
  for (const PairContact& contact : group.contact) {
    const Member &first = island[group.member[contact.car[0]]], &second = island[group.member[contact.car[1]]];
    const bool is_fixed[2] = {!std::isfinite(first.input.mass.mass), !std::isfinite(second.input.mass.mass)};
    if (!(contact.pressed > 0) || is_fixed[0] == is_fixed[1]) continue;
    const Member& fixed = is_fixed[0] ? first : second;
    const Vector3d arm = place(first, contact.node) - center(fixed);
    sum += double(contact.pressed) * (fixed.state.motion.velocity + fixed.state.motion.angular_velocity.cross(arm));
    forces += double(contact.pressed);
  }
  for (uint32_t k : group.member) {
    for_each_pressing(island[k], [&](const Contact& contact, const Vec3& force) {
      const double size = double(force.norm());
      if (size == 0) return;
      sum += size * velocity_of(island[k], contact, now);
      forces += size;
    });
  }
  return forces > 0 ? Vector3d(sum / forces) : sum;
}

// The share of the impulse that balances the energy. Energies are kinetic, seen from the obstacles, J. pressing: velocity of
// the obstacles. The motion never gains more than state.spring, and its gain is subtracted from there. Without that limit the
// explicit step of the motion would throw about a body far too stiff or too viscous for the sub-step, and so would obstacles
// that leave the body no room: their forces no longer say where it should go.
double balancing_share(const Mass& mass, const Load& impulse, const Vector3d& pressing, StepState& state) {
  if (!std::isfinite(mass.mass)) return 1;
  Motion relative = state.motion, still;
  relative.velocity -= pressing;
  still.pose = state.motion.pose;
  const double before = kinetic_energy(relative, mass);
  push(impulse.linear, impulse.angular, mass, relative);
  push(impulse.linear, impulse.angular, mass, still);
  // A share s of the impulse changes the energy by linear s + square s^2.
  const double square = kinetic_energy(still, mass), linear = kinetic_energy(relative, mass) - before - square;
  if (!(square > 0)) return 1;
  const auto gains = [&](double gain, int sign) {  // shares that add this energy, or come nearest to it
    return (sign * std::sqrt(std::max(0.0, linear * linear + 4 * square * gain)) - linear) / (2 * square);
  };
  const double missing = state.spring - state.body.stored;
  const double stops = gains(missing, -1), returns = gains(missing, 1);
  double share = std::clamp(std::fabs(stops - 1) < std::fabs(returns - 1) ? stops : returns, least_share, most_share);
  if ((linear + square * share) * share > state.spring) share = std::clamp(gains(state.spring, 1), 0.0, share);
  state.spring -= (linear + square * share) * share;
  return share;
}

// The forces of obstacles on a car, and their friction's heat.
Load push_by_obstacles(Member& car) {
  StepState& state = car.state;
  DeformableState& body = state.body;
  Vector3d force = Vector3d::Zero(), moment = Vector3d::Zero();  // car's frame
  for_each_pressing(car, [&](const Contact& contact, const Vec3& held) {
    const Vector3d f = held.cast<double>();
    const Vec3 slip = body.node[contact.node] - contact.carried;
    force += f;
    moment += (body.node[contact.node].cast<double>() - car.input.mass.center).cross(f);
    const Vec3 tangential = held - contact.normal.dot(held) * contact.normal;
    const double rubbed = double(std::max(0.0f, -tangential.dot(slip)));
    body.absorbed += rubbed;
    state.spring -= rubbed;
    state.result.deepest = std::max(state.result.deepest, -contact.after);
    ++state.result.contacts;
  });
  const Eigen::Quaterniond& axes = state.motion.pose.orientation;
  return {axes * force, axes * moment};
}

// Adds the forces between cars: one force at one point of the world for both. Each car takes half of the friction's heat.
void push_by_cars(std::span<Member> island, const PairGroup& group, std::vector<Load>& load, PartnerLoads& partner_loads) {
  for (const PairContact& contact : group.contact) {
    if (!(contact.pressed > 0)) continue;
    Member &first = island[group.member[contact.car[0]]], &second = island[group.member[contact.car[1]]];
    const Vector3d force = second.state.motion.pose.orientation * contact.force.cast<double>();
    const Vector3d at = place(first, contact.node);
    Load &a = load[contact.car[0]], &b = load[contact.car[1]];
    a = a + Load{force, (at - center(first)).cross(force)};
    b = b + Load{-force, -(at - center(second)).cross(force)};
    PartnerLoad &to_first = load_of(second.key, partner_loads[contact.car[0]]),
                &to_second = load_of(first.key, partner_loads[contact.car[1]]);
    to_first.now += force;
    to_second.now -= force;
    ++to_first.contacts;
    ++to_second.contacts;
    for (Member* each : {&first, &second}) {
      auto& [body, motion, result, spring] = each->state;
      body.absorbed += 0.5 * double(contact.heat);
      spring -= 0.5 * double(contact.heat);
      result.deepest = std::max(result.deepest, -contact.after);
      ++result.contacts;
    }
  }
}

// Kinetic energies of a group's motions when impulses push them, seen from something that moves with `velocity`, J. Cars of
// infinite mass have none.
class Kinetic {
 public:
  Kinetic(std::span<Member> island, const PairGroup& group, const Vector3d& velocity)
      : island_(island), group_(group), velocity_(velocity) {}
  double after(const std::vector<Load>& impulse) const {
    return sum([&](const Member& car, size_t k) {
      Motion motion = car.state.motion;
      motion.velocity -= velocity_;
      push(impulse[k].linear, impulse[k].angular, car.input.mass, motion);
      return kinetic_energy(motion, car.input.mass);
    });
  }
  // Of the impulses alone, if all stood still.
  double of(const std::vector<Load>& impulse) const {
    return sum([&](const Member& car, size_t k) {
      Motion motion;
      motion.pose = car.state.motion.pose;
      push(impulse[k].linear, impulse[k].angular, car.input.mass, motion);
      return kinetic_energy(motion, car.input.mass);
    });
  }

 private:
  template <class Energy>
  double sum(const Energy& energy) const {
    double all = 0;
    for (size_t k = 0; k < group_.member.size(); ++k) {
      const Member& car = island_[group_.member[k]];
      if (std::isfinite(car.input.mass.mass)) all += energy(car, k);
    }
    return all;
  }
  std::span<Member> island_;
  const PairGroup& group_;
  Vector3d velocity_;
};

// The velocity of a car's point half-way through the sub-step, m/s, world.
Vector3d velocity_at(const Member& car, const Load& impulse, const Vector3d& point) {
  Motion middle = car.state.motion;
  push(0.5 * impulse.linear, 0.5 * impulse.angular, car.input.mass, middle);
  return middle.velocity + middle.angular_velocity.cross(point - center(car));
}

// Impulses against the way of the cars over one another and over obstacles, in proportion to the forces: equal and opposite for
// the two sides of a contact. Their size is for the caller to choose. slow: m/s, contacts count less the faster they are, and
// not at all from this speed on.
std::vector<Load> against_the_way(std::span<Member> island, const PairGroup& group, const Substep& now,
                                  const std::vector<Load>& impulse, PartnerLoads& partner_loads,
                                  double slow = std::numeric_limits<double>::infinity()) {
  std::vector<Load> out(group.member.size());
  double forces = 0;
  const auto add = [&](size_t k, const Vector3d& at, const Vector3d& way, double force) {
    const Vector3d linear = -force * std::max(0.0, 1 - way.norm() / slow) * way;
    out[k] = out[k] + Load{linear, (at - center(island[group.member[k]])).cross(linear)};
    return linear;
  };
  const auto planar = [&](size_t k) { return island[group.member[k]].input.mass.planar; };
  for (const PairContact& contact : group.contact) {
    const auto& [a, b] = contact.car;
    const double force = double(contact.pressed);
    if (!(force > 0)) continue;
    const Vector3d at = place(island[group.member[a]], contact.node);
    Vector3d way = velocity_at(island[group.member[a]], impulse[a], at) - velocity_at(island[group.member[b]], impulse[b], at);
    if (planar(a) && planar(b)) way.z() = 0;
    load_of(island[group.member[b]].key, partner_loads[a]).balance += add(a, at, way, force);
    load_of(island[group.member[a]].key, partner_loads[b]).balance += add(b, at, -way, force);
    forces += force;
  }
  for (size_t k = 0; k < group.member.size(); ++k) {
    const Member& car = island[group.member[k]];
    for_each_pressing(car, [&](const Contact& contact, const Vec3& held) {
      const Vector3d at = place(car, contact.node);
      add(k, at, velocity_at(car, impulse[k], at) - velocity_of(car, contact, now), double(held.norm()));
      forces += double(held.norm());
    });
  }
  const double scale = forces > 0 ? 1 / forces : 0;
  for (Load& each : out) each = scale * each;
  for (std::vector<PartnerLoad>& each : partner_loads) {
    for (PartnerLoad& from : each) from.balance *= scale;
  }
  return out;
}

// The share s nearest to zero for which linear s + square s^2 = gain, or comes nearest to it.
double smallest_share(double linear, double square, double gain) {
  const double root = linear * linear + 4 * square * gain;
  if (root <= 0) return -linear / (2 * square);
  const double larger = -(linear + std::copysign(std::sqrt(root), linear)) / (2 * square);
  return larger != 0 ? -gain / (square * larger) : 0;
}

// Balances the energy of cars that touch one another, and never lets the motions gain more than the bodies have. was: where the
// centres of mass stood when the sub-step began: the first half of the impulse, which has moved the cars already, acted there.
void balance(std::span<Member> island, const PairGroup& group, const Substep& now, std::span<const Load> begun,
             std::vector<Load>& impulse, double& share, PartnerLoads& partner_loads) {
  const Kinetic kinetic(island, group, pressing_velocity(island, group, now));
  double spring = 0, stored = 0, most = 0;
  for (size_t k = 0; k < group.member.size(); ++k) {
    const StepState& state = island[group.member[k]].state;
    spring += state.spring;
    stored += state.body.stored;
    most = std::max(most, impulse[k].linear.norm());
  }
  const double before = kinetic.after(std::vector<Load>(impulse.size()));
  const std::vector<Load> more = against_the_way(island, group, now, impulse, partner_loads);
  double size = 0;
  for (const Load& each : more) size = std::max(size, each.linear.norm());
  const double square = kinetic.of(more);
  double by = 0;
  if (size > 0 && square > 0) {
    const double gained = kinetic.after(impulse) - before;
    std::vector<Load> with = impulse;
    for (size_t k = 0; k < with.size(); ++k) with[k] = with[k] + more[k];
    const double linear = kinetic.after(with) - before - gained - square;
    const double limit = most_correction * most / size;
    by = std::clamp(smallest_share(linear, square, spring - stored - gained), -limit, limit);
    for (size_t k = 0; k < impulse.size(); ++k) impulse[k] = impulse[k] + by * more[k];
  }
  for (std::vector<PartnerLoad>& each : partner_loads) {
    for (PartnerLoad& from : each) from.balance *= by;
  }
  double gained = kinetic.after(impulse) - before;
  const double whole = kinetic.of(impulse);
  if (gained > spring && whole > 0) {
    const double linear = gained - whole;
    share = std::clamp((std::sqrt(std::max(0.0, linear * linear + 4 * whole * spring)) - linear) / (2 * whole), 0.0, 1.0);
    for (size_t k = 0; k < impulse.size(); ++k) {
      impulse[k] = share * impulse[k] + Load{Vector3d::Zero(), (1 - share) * begun[k].angular};
    }
    gained = kinetic.after(impulse) - before;
  }
  // What is still missing is divided among the bodies in proportion to what they store.
  const double missing = spring - gained - stored;
  for (uint32_t k : group.member) {
    StepState& state = island[k].state;
    state.spring = state.body.stored + missing * (stored > 0 ? state.body.stored / stored : 1 / double(group.member.size()));
  }
}

// Damps the way of slow contacts of cars that their hosts press on something, by no more than what presses them. The materials
// do not: without this a car that its weight presses on another would hum for ever, and creep along meanwhile.
void calm(std::span<Member> island, const PairGroup& group, const Substep& now, std::vector<Load>& impulse,
          PartnerLoads& partner_loads) {
  double most = 0;  // N s
  for (uint32_t k : group.member) {
    const StepInput& input = island[k].input;
    if (std::isfinite(input.mass.mass)) most = std::max(most, now.seconds * input.mass.mass * input.pull.norm());
  }
  if (most == 0) return;
  PartnerLoads damped(group.member.size());
  const std::vector<Load> more = against_the_way(island, group, now, impulse, damped, slow_way);
  const Kinetic kinetic(island, group, pressing_velocity(island, group, now));
  double size = 0;
  for (const Load& each : more) size = std::max(size, each.linear.norm());
  const double square = kinetic.of(more);
  if (!(size > 0 && square > 0)) return;
  const auto with = [&](double by) {
    std::vector<Load> sum = impulse;
    for (size_t k = 0; k < sum.size(); ++k) sum[k] = sum[k] + by * more[k];
    return sum;
  };
  const double before = kinetic.after(impulse), linear = kinetic.after(with(1)) - before - square;
  const double by = std::min(std::min(1.0, now.seconds / calm_seconds) * -linear / (2 * square), most / size);
  if (!(by > 0)) return;
  impulse = with(by);
  for (size_t k = 0; k < damped.size(); ++k) {
    for (const PartnerLoad& from : damped[k]) load_of(from.key, partner_loads[k]).calm = by * from.balance;
  }
  const double lost = (before - kinetic.after(impulse)) / double(group.member.size());
  for (uint32_t k : group.member) island[k].state.body.absorbed += std::max(0.0, lost);
}

}  // namespace

void react(std::span<Member> island, const PairGroup& group, const Substep& now, double h) {
  std::vector<Load> load, impulse, begun;
  PartnerLoads partner_loads(group.member.size());
  for (uint32_t k : group.member) {
    StepResult& result = island[k].state.result;
    result.contacts = 0;
    for (PartnerResult& each : result.partners) each.contacts = 0;
    load.push_back(push_by_obstacles(island[k]));
  }
  for (size_t k = 0; k < load.size(); ++k) {
    for (const auto& [partner, force] : island[group.member[k]].state.body.pairs.push) {
      load_of(partner, partner_loads[k]).before = force;
    }
  }
  push_by_cars(island, group, load, partner_loads);
  // The first half has moved the cars already for now.seconds, of which h is the nearest number in single precision: with h,
  // cars that touch each other would gain spin.
  const double first = group.member.size() > 1 ? 0.5 * (now.seconds - h) : 0;
  for (size_t k = 0; k < load.size(); ++k) {
    // Mean of the forces at both ends of the sub-step.
    const auto& [body, motion, result, spring] = island[group.member[k]].state;
    const Load before{body.force, body.moment};
    impulse.push_back(Load{0.5 * h * (body.force + load[k].linear), 0.5 * h * (body.moment + load[k].angular)} +
                      first * before);
    // The first half of the impulse has moved the car already, and acted where the car stood when the sub-step began.
    const Vector3d way = h * motion.velocity + 0.5 * h * h / island[group.member[k]].input.mass.mass * body.force;
    begun.push_back({Vector3d::Zero(), 0.5 * h * way.cross(body.force)});
  }
  double share = 1;
  if (group.member.size() == 1) {
    StepState& state = island[group.member.front()].state;
    share =
        balancing_share(island[group.member.front()].input.mass, impulse.front(), pressing_velocity(island, group, now), state);
    impulse.front() = share * impulse.front();
  } else {
    balance(island, group, now, begun, impulse, share, partner_loads);
  }
  calm(island, group, now, impulse, partner_loads);
  for (size_t k = 0; k < load.size(); ++k) {
    Member& car = island[group.member[k]];
    auto& [body, motion, result, spring] = car.state;
    body.force = std::min(1.0, share) * load[k].linear;
    body.moment = std::min(1.0, share) * load[k].angular;
    body.touching = result.contacts > 0;
    push(impulse[k].linear, impulse[k].angular, car.input.mass, motion);
    result.impulse += impulse[k].linear;
    result.angular_impulse += impulse[k].angular;
    body.pairs.push.clear();
    for (const PartnerLoad& from : partner_loads[k]) {
      PartnerResult& partner = result_of(from.key, result.partners);
      partner.impulse += share * (0.5 * h * (from.before + from.now) + first * from.before + from.balance) + from.calm;
      partner.contacts = from.contacts;
      if (from.contacts > 0) body.pairs.push.push_back({from.key, std::min(1.0, share) * from.now});
    }
  }
}

}  // namespace crumple

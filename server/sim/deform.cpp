#include "sim/deform.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sim/classic.h"
#include "sim/nodal.h"

namespace crumple {
namespace {

constexpr float wake_depth = 1e-4f;                  // m: and it is woken by an obstacle this deep in it
constexpr float shortest_substep = 0.01f;            // of a whole one, where the first is cut to the touch
constexpr double least_share = 0.5, most_share = 2;  // of the impulse that the forces say
constexpr float flat = 0.02f;                        // share of a tet's volume left: below it no shape is a sound one at rest
constexpr float mended = 0.1f;                       // of the flow around an inverted tet, a tick

struct RoomTimer {
  Timer* timer;
  RoomTimer(Timer* t, Room room) : timer(t) {
    if (timer) timer->enter(room);
  }
  ~RoomTimer() {
    if (timer) timer->leave();
  }
};

void index_contacts(Scratch& scratch) {
  std::fill(scratch.contact_first.begin(), scratch.contact_first.end(), 0u);
  for (size_t k = scratch.contacts.size(); k-- > 0;) scratch.contact_first[scratch.contacts[k].node] = uint32_t(k + 1);
  scratch.held.assign(scratch.contacts.size(), Held{});
}

// Share of the sub-step that is left when the first contact closes; all of it if none does.
float after_touch(std::span<const Contact> contacts) {
  float earliest = 1;
  for (const Contact& c : contacts) {
    if (c.after < 0) earliest = std::min(earliest, c.before > 0 ? c.before / (c.before - c.after) : 0.0f);
  }
  return earliest < 1 ? std::max(shortest_substep, 1 - earliest) : 1;
}

// A settled body wakes when an obstacle enters it, and when the one that it rests against has moved on or leaves. drift: way of
// the obstacles along it since it settled, m.
bool woken(double h, std::span<const Contact> contacts, const Body& body, float& drift) {
  if (!body.touching) {
    return std::any_of(contacts.begin(), contacts.end(), [](const Contact& c) { return c.after < -wake_depth; });
  }
  if (contacts.empty()) return true;
  float most = 0;
  for (const Contact& c : contacts) most = std::max(most, (c.carried - body.node[c.node]).norm());
  if (double(most) > double(settle_speed) * h) drift += most;
  return drift > wake_depth;
}

// A body that holds numbers that are not finite has lost its shape there: those nodes and tets are as baked again.
void heal(const Model& model, Body& body) {
  for (size_t i = 0; i < body.node.size(); ++i) {
    if (body.node[i].allFinite() && body.step[i].allFinite()) continue;
    body.node[i] = model.node[i];
    body.step[i].setZero();
  }
  for (size_t t = 0; t < body.gradients.size(); ++t) {
    bool sound = std::isfinite(body.hardening[t]);
    for (const Vec3& corner : body.gradients[t].corner) sound = sound && corner.allFinite();
    if (sound) continue;
    body.gradients[t] = model.gradients[t];
    body.hardening[t] = 0;
  }
  for (size_t e = 0; e < body.edge_rest.size(); ++e) {
    if (!std::isfinite(body.edge_rest[e])) body.edge_rest[e] = model.edge_rest[e];
  }
  for (size_t t = 0; t < body.tet_rest.size(); ++t) {
    if (!std::isfinite(body.tet_rest[t])) body.tet_rest[t] = model.tet_rest[t];
  }
  if (!std::isfinite(body.absorbed)) body.absorbed = 0;
  if (!std::isfinite(body.stored)) body.stored = 0;
  if (!std::isfinite(body.owed)) body.owed = 0;
  if (!body.force.allFinite() || !body.moment.allFinite()) body.force.setZero(), body.moment.setZero();
  measure_reach(model, body);
}

// How much of an impulse contacts give: so much that what the motion loses is what the body takes. The forces at both ends of a
// sub-step do not know where between them a tet began to flow or a node met the obstacle, and sweeps leave them an error: their
// mean alone creates or loses some 3 % of a crash's energy at 4 sub-steps a tick, and it falls only with the sub-step's length.
// Energies are kinetic ones as seen from the obstacles, J. spring: what the body should store by what the motion gave it;
// stored: what it does store. Takes from `spring` what the motion gains, and that is never more than `spring`: a body far too
// stiff or too viscous for the sub-step would be thrown about by the explicit step of its motion, and obstacles that leave it
// no room press with forces that no longer tell where it should go.
double balancing_share(const Mass& mass, const Eigen::Vector3d& impulse, const Eigen::Vector3d& angular_impulse,
                       const Eigen::Vector3d& velocity, const Motion& motion, double stored, bool lost, double& spring) {
  if (!std::isfinite(mass.mass)) return 1;
  Motion relative = motion, still;
  relative.velocity -= velocity;
  still.pose = motion.pose;
  const double before = kinetic_energy(relative, mass);
  push(impulse, angular_impulse, mass, relative);
  push(impulse, angular_impulse, mass, still);
  // A share s of it adds linear s + square s^2.
  const double square = kinetic_energy(still, mass), linear = kinetic_energy(relative, mass) - before - square;
  if (!(square > 0)) return 1;
  const auto gains = [&](double gain, int sign) {  // the shares that add this much, or come nearest to it
    return (sign * std::sqrt(std::max(0.0, linear * linear + 4 * square * gain)) - linear) / (2 * square);
  };
  double share = 1;
  if (!lost) {
    const double stops = gains(spring - stored, -1), returns = gains(spring - stored, 1);
    share = std::clamp(std::fabs(stops - 1) < std::fabs(returns - 1) ? stops : returns, least_share, most_share);
  }
  if ((linear + square * share) * share > spring) share = std::clamp(gains(spring, 1), 0.0, share);
  spring -= (linear + square * share) * share;
  return share;
}

// Of the obstacles where they press on the car, weighted by their forces; m/s, world. start: of the sub-step, within the tick.
Eigen::Vector3d pressing_velocity(std::span<const Obstacle> obstacles, double start, const Scratch& scratch, const Body& body,
                                  const Motion& motion) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double forces = 0;
  for (size_t k = 0; k < scratch.contacts.size(); ++k) {
    const double force = double(scratch.held[k].force.norm());
    if (!scratch.held[k].active || force == 0) continue;
    const Contact& contact = scratch.contacts[k];
    const Obstacle& obstacle = obstacles[contact.obstacle];
    const Eigen::Vector3d node = motion.pose.position + motion.pose.orientation * body.node[contact.node].cast<double>();
    const Eigen::Vector3d arm = node - obstacle.pose.position - start * obstacle.velocity;
    sum += force * (obstacle.velocity + obstacle.angular_velocity.cross(arm));
    forces += force;
  }
  return forces > 0 ? Eigen::Vector3d(sum / forces) : sum;
}

// The forces of all contacts as one impulse on the rigid motion, and the work that friction took. The impulse is the mean of
// the forces at both ends of the sub-step, or the share of it that balances the energy. pressing: velocity of the obstacles.
void react(const Mass& mass, double h, const Eigen::Vector3d& pressing, const Scratch& scratch, Body& body, Motion& motion,
           Response& response, double& spring) {
  Eigen::Vector3d force = Eigen::Vector3d::Zero(), moment = Eigen::Vector3d::Zero();
  uint32_t touching = 0;
  for (size_t k = 0; k < scratch.contacts.size(); ++k) {
    const Contact& contact = scratch.contacts[k];
    const Held& held = scratch.held[k];
    touching += held.active;
    if (!held.active) continue;
    const Eigen::Vector3d f = held.force.cast<double>();
    const Vec3 slip = body.node[contact.node] - contact.carried;
    force += f;
    moment += (body.node[contact.node].cast<double>() - mass.center).cross(f);
    const Vec3 tangential = held.force - contact.normal.dot(held.force) * contact.normal;
    const double rubbed = double(std::max(0.0f, -tangential.dot(slip)));
    body.absorbed += rubbed;
    spring -= rubbed;
    response.deepest = std::max(response.deepest, -contact.after);
  }
  const Eigen::Quaterniond& axes = motion.pose.orientation;
  Eigen::Vector3d impulse = 0.5 * h * (body.force + axes * force);
  Eigen::Vector3d angular_impulse = 0.5 * h * (body.moment + axes * moment);
  const double share = balancing_share(mass, impulse, angular_impulse, pressing, motion, body.stored, body.lost, spring);
  impulse *= share;
  angular_impulse *= share;
  body.force = std::min(1.0, share) * (axes * force);
  body.moment = std::min(1.0, share) * (axes * moment);
  body.touching = touching > 0;
  push(impulse, angular_impulse, mass, motion);
  response.impulse += impulse;
  response.angular_impulse += angular_impulse;
  response.contacts = touching;
}

// Where the frame goes in a sub-step: with the velocity half-way through it, if the force stays. With the velocity at its start
// each sub-step would create the energy impulse^2 / (2 mass).
Pose path(const Motion& motion, const Mass& mass, const Body& body, double h) {
  Motion middle = motion;
  push(0.5 * h * body.force, 0.5 * h * body.moment, mass, middle);
  return advance(middle, mass, h);
}

// Nodes of the cell that nothing touches stand at rest.
void hold_anchors(const Model& model, const Scratch& scratch, Body& body) {
  for (size_t i = 0; i < body.node.size(); ++i) {
    if (model.node_anchored[i] && scratch.contact_first[i] == 0) {
      body.node[i] = model.node[i];
      body.step[i].setZero();
    }
  }
}

void settle(float h, std::span<const Vec3> before, Body& body) {
  float most = 0;
  for (size_t i = 0; i < body.node.size(); ++i) {
    body.step[i] = body.node[i] - before[i];
    most = std::max(most, body.step[i].squaredNorm());
  }
  body.settled = most <= settle_speed * settle_speed * h * h;
  body.step_seconds = h;
  body.drift = 0;
}

// How many the tick needs; see substep_seconds.
int substeps(const Parameters& parameters, const Mass& mass, std::span<const Obstacle> obstacles, double seconds,
             const Scratch& scratch, const Body& body, const Motion& motion) {
  double closing = 0;
  for (const Candidates& near : scratch.candidates) {
    const Obstacle& obstacle = obstacles[near.obstacle];
    const double turning = motion.angular_velocity.norm() + obstacle.angular_velocity.norm();
    closing = std::max(closing, (motion.velocity - obstacle.velocity).norm() + double(body.reach) * turning);
  }
  // A block of the car's size, squeezed: its stiffness is about one and a half times E times its length from the middle.
  double modulus = 0;
  for (const Material& material : parameters.region) modulus = std::max(modulus, double(material.young_modulus));
  const double frequency = std::sqrt(1.5 * modulus * double(body.reach) / mass.mass);
  const int count = substep_count(parameters.substeps, seconds);
  int times = 1;
  for (int k = 0; k < halvings; ++k) {
    const double h = seconds / (count * times) / coarseness(parameters);
    if (closing * h > substep_travel || frequency * h > substep_turn) times *= 2;
  }
  return count * times;
}

// Before a tick changes the body for the first time.
void keep(const Model& model, Scratch& scratch, Body& body) {
  scratch.prepared = true;
  scratch.contact_first.assign(model.node.size(), 0);
  History history = std::exchange(body.history, {});  // nothing to go back to if the tick fails
  scratch.backup = body;
  body.history = std::move(history);
}

struct Substep {
  double start, seconds;  // within the tick
  float last;             // seconds of the one before, for the predictor
};

// One sub-step. Returns the seconds that were solved.
float step(const Model& model, const Parameters& parameters, const Mass& mass, std::span<const Obstacle> obstacles,
           const Substep& now, Scratch& scratch, Body& body, Motion& motion, Response& response, double& spring, Timer* timer) {
  const Pose to = path(motion, mass, body, now.seconds);
  {
    const RoomTimer room(timer, Room::contacts);
    if (!find_contacts(body, obstacles, scratch.candidates, motion.pose, to, now.start, now.seconds, scratch.contacts)) {
      response.contact_overflow = true;
    }
  }
  motion.pose = to;
  if (body.settled && !woken(now.seconds, scratch.contacts, body, body.drift)) {
    if (body.touching) {  // the obstacle presses on a body that has come to rest under it
      push(now.seconds * body.force, now.seconds * body.moment, mass, motion);
      response.impulse += now.seconds * body.force;
      response.angular_impulse += now.seconds * body.moment;
    } else {
      body.force.setZero();
      body.moment.setZero();
    }
    return now.last;
  }
  if (!scratch.prepared) {
    keep(model, scratch, body);
    scratch.team.gather();
    prepare_nodal(model, parameters, body, scratch);
  }
  const float h = float(now.seconds) * (body.touching ? 1 : after_touch(scratch.contacts));
  {
    const RoomTimer room(timer, Room::solve);
    index_contacts(scratch);
    hold_anchors(model, scratch, body);
    scratch.start = body.node;
    const Effort effort = solve_nodal(model, parameters, mass.mass, h, h / now.last, scratch, body);
    response.sweeps += effort.sweeps;
    response.work += effort.work;
    response.residual = std::max(response.residual, effort.residual);
  }
  settle(h, scratch.start, body);
  {
    const RoomTimer room(timer, Room::flow);
    const double taken = flow_nodal(model, scratch, body);
    body.absorbed += taken;
    spring -= taken;
    body.stored = stored_nodal(model, scratch, body);
  }
  react(mass, double(h), pressing_velocity(obstacles, now.start, scratch, body, motion), scratch, body, motion, response,
        spring);
  // At the turning point of a crash nothing moves for a moment, but the body is about to spring back.
  if (body.force.norm() * double(h) > double(settle_speed) * mass.mass) body.settled = false;
  ++response.substeps;
  return h;
}

// A body that nothing holds has come to rest, and some tets are inverted or flat: they stick between others that flowed while
// all of them were crushed beyond what is left of them. No car has that shape: the flow around them goes back, a part a tick,
// until the body is sound; that of the whole body where there is none around them. Returns whether there was any to take back.
bool mend(const Model& model, Body& body) {
  bool any = false, inverted = false;
  const auto take_back = [&](uint32_t tet) {
    float& kappa = body.hardening[tet];
    if (kappa == 0) return;
    any = true;
    const float taken = kappa > 1e-3f ? mended : 1;
    kappa -= taken * kappa;
    for (int k = 0; k < 3; ++k) {
      Vec3& gradient = body.gradients[tet].corner[k];
      gradient += taken * (model.gradients[tet].corner[k] - gradient);
    }
  };
  for (size_t t = 0; t < model.tet.size(); ++t) {
    const uint32_t* n = model.tet[t].node;
    const Mat3 f = deformation(body.node[n[0]], body.node[n[1]], body.node[n[2]], body.node[n[3]], body.gradients[t]);
    if (f.determinant() > flat) continue;
    inverted = true;
    for (uint32_t node : model.tet[t].node) {
      for (uint32_t k = model.node_first[node]; k < model.node_first[node + 1]; ++k) take_back(model.corner[k] / 4);
    }
  }
  if (inverted && !any) {
    for (uint32_t tet = 0; tet < model.tet.size(); ++tet) take_back(tet);
  }
  return any;
}

void tick_classic(const Model& model, const Parameters& parameters, const Mass& mass, std::span<const Obstacle> obstacles,
                  double seconds, Scratch& scratch, Body& body, Motion& motion, Response& response, Timer* timer) {
  const Pose to = advance(motion, mass, seconds);
  {
    const RoomTimer room(timer, Room::contacts);
    response.contact_overflow =
        !find_contacts(body, obstacles, scratch.candidates, motion.pose, to, 0, seconds, scratch.contacts);
  }
  motion.pose = to;
  body.force.setZero();  // `classic` knows no forces
  body.moment.setZero();
  if (body.settled && !woken(seconds, scratch.contacts, body, body.drift)) return;
  keep(model, scratch, body);
  const RoomTimer room(timer, Room::solve);
  scratch.start = body.node;
  solve_classic(model, parameters, scratch.contacts, body);
  settle(float(seconds), scratch.start, body);
  for (const Contact& contact : scratch.contacts) {
    response.contacts += contact.after < 0;
    response.deepest = std::max(response.deepest, -contact.after);
  }
  body.touching = response.contacts > 0;
  response.substeps = 1;
}

bool finite(const Body& body, const Motion& motion) {
  bool all = motion.pose.position.allFinite() && motion.velocity.allFinite() && motion.angular_velocity.allFinite();
  for (const Vec3& node : body.node) all = all && node.allFinite();
  return all && std::isfinite(body.absorbed) && std::isfinite(body.stored) && std::isfinite(body.owed);
}

}  // namespace

void ScratchDeleter::operator()(Scratch* scratch) const { delete scratch; }
ScratchHandle make_scratch() { return ScratchHandle(new Scratch); }

bool wakes(const Model& model, const Parameters& parameters, const Mass& mass, std::span<const Obstacle> obstacles,
           double seconds, Scratch& scratch, const Body& body, Motion motion) {
  find_candidates(model, body, motion, mass, obstacles, seconds, scratch.candidates);
  if (scratch.candidates.empty()) return body.touching;
  const int count =
      parameters.solver == Solver::classic ? 1 : substeps(parameters, mass, obstacles, seconds, scratch, body, motion);
  const double h = seconds / count;
  float drift = body.drift;
  for (int k = 0; k < count; ++k) {
    const Pose to = path(motion, mass, body, h);
    find_contacts(body, obstacles, scratch.candidates, motion.pose, to, k * h, h, scratch.contacts);
    motion.pose = to;
    if (woken(h, scratch.contacts, body, drift)) return true;
    if (body.touching) push(h * body.force, h * body.moment, mass, motion);
  }
  return false;
}

Response deform(const Model& model, const Parameters& parameters, const Mass& mass, std::span<const Obstacle> obstacles,
                double seconds, Scratch& scratch, Body& body, Motion& motion, Timer* timer) {
  Response response;
  const Motion begin = motion;
  {
    const RoomTimer room(timer, Room::contacts);
    find_candidates(model, body, motion, mass, obstacles, seconds, scratch.candidates);
  }
  if (scratch.candidates.empty() && body.settled && !body.touching) {
    motion.pose = advance(motion, mass, seconds);
    return response;
  }
  scratch.prepared = false;
  if (parameters.solver == Solver::classic) {
    tick_classic(model, parameters, mass, obstacles, seconds, scratch, body, motion, response, timer);
  } else {
    const int count = substeps(parameters, mass, obstacles, seconds, scratch, body, motion);
    const double h = seconds / count;
    double spring = body.lost ? 0 : std::max(0.0, body.stored - body.owed);
    float last = body.step_seconds > 0 ? body.step_seconds : float(h);
    for (int k = 0; k < count; ++k) {
      last = step(model, parameters, mass, obstacles, {k * h, h, last}, scratch, body, motion, response, spring, timer);
    }
    scratch.team.leave();
    body.owed = body.lost || body.settled || !std::isfinite(mass.mass) ? 0 : std::max(0.0, body.stored - spring);
  }
  if (scratch.prepared && !finite(body, motion)) {
    std::swap(body, scratch.backup);
    heal(model, body);
    motion = begin;
    motion.velocity.setZero();
    motion.angular_velocity.setZero();
    response = Response{};
    response.recovered = true;
  }
  if (response.substeps > 0) measure_reach(model, body);
  if (body.settled) body.history = {}, body.lost = false;
  if (response.substeps > 0 && body.settled && !body.touching && mend(model, body)) {
    body.settled = false;
    body.lost = true;  // or what was taken back flows again at once
  }
  return response;
}

}  // namespace crumple

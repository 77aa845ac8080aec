#include "sim/deform.h"

#include <algorithm>
#include <cmath>

#include "sim/classic.h"
#include "sim/nodal.h"

namespace crumple {
namespace {

constexpr float settle_speed = 2e-3f;      // m/s: slower than this everywhere, a body no obstacle pushes is left alone
constexpr float wake_depth = 1e-4f;        // m: and it is woken by an obstacle this deep in it
constexpr float shortest_substep = 0.01f;  // of a whole one, where the first is cut to the touch

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

void prepare(const Model& model, Scratch& scratch) {
  scratch.contact_first.assign(model.node.size(), 0);
  scratch.before.resize(model.node.size());
  scratch.pair_start.resize(model.node.size());
  scratch.direction.resize(model.node.size());
  scratch.deformation.resize(model.tet.size());
  scratch.stiffness.resize(model.tet.size());
  scratch.drag.resize(model.node.size());
  scratch.anchor.assign(model.node.size(), 0.0f);
  scratch.volume = 0;
  for (float volume : model.tet_rest) scratch.volume += volume;
}

// Share of the sub-step that is left when the first contact closes; all of it if none does.
float after_touch(std::span<const Contact> contacts) {
  float earliest = 1;
  for (const Contact& c : contacts) {
    if (c.after < 0) earliest = std::min(earliest, c.before > 0 ? c.before / (c.before - c.after) : 0.0f);
  }
  return earliest < 1 ? std::max(shortest_substep, 1 - earliest) : 1;
}

bool woken(const Body& body, std::span<const Contact> contacts) {
  if (!body.settled) return true;
  return std::any_of(contacts.begin(), contacts.end(), [](const Contact& c) { return c.after < -wake_depth; });
}

// Plastic flow of every tet, and the drag that its nodes took: J.
double dissipate(const Model& model, const Parameters& parameters, Scratch& scratch, Body& body) {
  Elastic moduli[region_limit];
  YieldLaw laws[region_limit];
  for (int r = 0; r < region_limit; ++r) {
    moduli[r] = elastic(parameters.region[r]);
    laws[r] = yield_law(parameters.region[r]);
  }
  double work = 0;
  for (size_t t = 0; t < model.tet.size(); ++t) {
    const uint32_t* n = model.tet[t].node;
    const int region = model.tet_region[t];
    const Mat3 f = deformation(body.node[n[0]], body.node[n[1]], body.node[n[2]], body.node[n[3]], body.gradients[t]);
    work += double(model.tet_rest[t]) * flow(moduli[region], laws[region], f, body.gradients[t], body.hardening[t]);
  }
  for (size_t i = 0; i < body.node.size(); ++i) {
    work += double(scratch.drag[i]) * (body.node[i] - scratch.before[i]).squaredNorm();
  }
  return work;
}

// Elastic energy of the tets and of the springs that hold the cell, J.
double stored_energy(const Model& model, const Parameters& parameters, const Scratch& scratch, const Body& body) {
  Elastic moduli[region_limit];
  for (int r = 0; r < region_limit; ++r) moduli[r] = elastic(parameters.region[r]);
  double sum = 0;
  for (size_t t = 0; t < model.tet.size(); ++t) {
    const uint32_t* n = model.tet[t].node;
    const Mat3 f = deformation(body.node[n[0]], body.node[n[1]], body.node[n[2]], body.node[n[3]], body.gradients[t]);
    sum += double(model.tet_rest[t]) * energy_density(moduli[model.tet_region[t]], f);
  }
  for (size_t i = 0; i < body.node.size(); ++i) {
    if (scratch.anchor[i] > 0) sum += 0.5 * double(scratch.anchor[i]) * (body.node[i] - model.node[i]).squaredNorm();
  }
  return sum;
}

// The forces of all contacts as one impulse on the rigid motion, and the work that friction took. The impulse is the mean of
// the forces at both ends of the sub-step: with those at its end alone a crash loses 2 % of its energy to the rectangle rule.
void react(const Mass& mass, double h, const Scratch& scratch, Body& body, Motion& motion, Response& response) {
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
    body.absorbed += std::max(0.0f, -tangential.dot(slip));
    response.deepest = std::max(response.deepest, -contact.after);
  }
  const Eigen::Quaterniond& axes = motion.pose.orientation;
  const Eigen::Vector3d impulse = 0.5 * h * (body.force + axes * force);
  const Eigen::Vector3d angular_impulse = 0.5 * h * (body.moment + axes * moment);
  body.force = axes * force;
  body.moment = axes * moment;
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

void settle(float h, const Scratch& scratch, Body& body) {
  float most = 0;
  for (size_t i = 0; i < body.node.size(); ++i) {
    body.step[i] = body.node[i] - scratch.before[i];
    most = std::max(most, body.step[i].squaredNorm());
  }
  body.settled = most <= settle_speed * settle_speed * h * h;
}

struct Substep {
  double start, seconds;  // within the tick
  float last;             // seconds of the one before, for the predictor
};

// One sub-step. Returns the seconds that were solved.
float step(const Model& model, const Parameters& parameters, const Mass& mass, std::span<const Obstacle> obstacles,
           const Substep& now, Scratch& scratch, Body& body, Motion& motion, Response& response, Timer* timer) {
  const Pose to = path(motion, mass, body, now.seconds);
  {
    const RoomTimer room(timer, Room::contacts);
    if (!find_contacts(body, obstacles, scratch.candidates, motion.pose, to, now.start, now.seconds, scratch.contacts)) {
      response.contact_overflow = true;
    }
  }
  motion.pose = to;
  if (!woken(body, scratch.contacts)) {
    body.force.setZero();
    body.moment.setZero();
    return now.last;
  }
  const float h = float(now.seconds) * (body.touching ? 1 : after_touch(scratch.contacts));
  {
    const RoomTimer room(timer, Room::solve);
    index_contacts(scratch);
    hold_anchors(model, scratch, body);
    std::copy(body.node.begin(), body.node.end(), scratch.before.begin());
    solve_nodal(model, parameters, mass.mass, h, h / now.last, scratch, body);
  }
  settle(h, scratch, body);
  {
    const RoomTimer room(timer, Room::flow);
    body.absorbed += dissipate(model, parameters, scratch, body);
  }
  react(mass, double(h), scratch, body, motion, response);
  // At the turning point of a crash nothing moves for a moment, but the body is about to spring back.
  if (body.force.norm() * double(h) > double(settle_speed) * mass.mass) body.settled = false;
  ++response.substeps;
  return h;
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
  if (!woken(body, scratch.contacts)) return;
  const RoomTimer room(timer, Room::solve);
  std::copy(body.node.begin(), body.node.end(), scratch.before.begin());
  solve_classic(model, parameters, scratch.contacts, body);
  settle(float(seconds), scratch, body);
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
  return all && std::isfinite(body.absorbed) && std::isfinite(body.stored);
}

}  // namespace

void ScratchDeleter::operator()(Scratch* scratch) const { delete scratch; }
ScratchHandle make_scratch() { return ScratchHandle(new Scratch); }

Response deform(const Model& model, const Parameters& parameters, const Mass& mass, std::span<const Obstacle> obstacles,
                double seconds, Scratch& scratch, Body& body, Motion& motion, Timer* timer) {
  Response response;
  const Motion begin = motion;
  {
    const RoomTimer room(timer, Room::contacts);
    find_candidates(model, body, motion, mass, obstacles, seconds, scratch.candidates);
  }
  if (scratch.candidates.empty() && body.settled) {
    body.touching = false;
    motion.pose = advance(motion, mass, seconds);
    return response;
  }
  prepare(model, scratch);
  scratch.backup = body;

  if (parameters.solver == Solver::classic) {
    tick_classic(model, parameters, mass, obstacles, seconds, scratch, body, motion, response, timer);
  } else {
    const int count = std::max(1, int(std::lround(seconds / substep_seconds)));
    const double h = seconds / count;
    float last = float(h);
    for (int k = 0; k < count; ++k) {
      last = step(model, parameters, mass, obstacles, {k * h, h, last}, scratch, body, motion, response, timer);
    }
    body.stored = stored_energy(model, parameters, scratch, body);
  }
  if (!finite(body, motion)) {
    std::swap(body, scratch.backup);
    motion = begin;
    motion.velocity.setZero();
    motion.angular_velocity.setZero();
    response = Response{};
    response.recovered = true;
  }
  if (response.substeps > 0) measure_reach(model, body);
  return response;
}

}  // namespace crumple

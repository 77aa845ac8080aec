#include "sim/deform.h"

#include "sim/classic.h"
#include "sim/energy_balance.h"
#include "sim/rest.h"
#include "sim/scratch.h"

namespace crumple {
namespace {

struct RoomTimer {
  Timer* timer;
  RoomTimer(Timer* t, Room room) : timer(t) {
    if (timer) timer->enter(room);
  }
  ~RoomTimer() {
    if (timer) timer->leave();
  }
};

// Moves the car's frame and finds the contacts. Returns false if the body stays at rest, so that its shape need not be solved.
bool meet(const StepInput& input, const Substep& now, const Pose& to, Scratch& scratch, StepState& state, Timer* timer) {
  auto& [body, motion, result, spring] = state;
  const RoomTimer room(timer, Room::contacts);
  if (!find_contacts(body, input.obstacles, {motion.pose, to, now.start, now.seconds}, scratch.contacts)) {
    result.contact_overflow = true;
  }
  motion.pose = to;
  return !body.settled || is_woken(now.seconds, scratch.contacts.contact, body, body.drift);
}

// One sub-step. Returns the seconds solved.
float step(const StepInput& input, const Substep& now, Scratch& scratch, StepState& state, Timer* timer) {
  auto& [body, motion, result, spring] = state;
  auto& [contacts, solver, start, backup] = scratch;
  if (!meet(input, now, path(input.mass, body, motion, now.seconds), scratch, state, timer)) {
    stay_at_rest(input, now, state);
    return now.last;
  }
  if (!backup.taken) {
    back_up(body, backup);
    solver.team.gather();
    prepare_nodal(input.model, input.parameters, body, solver);
  }
  const float h = float(now.seconds) * (body.touching ? 1 : after_touch(contacts.contact));
  {
    const RoomTimer room(timer, Room::solve);
    index_contacts(input.model.node.size(), contacts);
    hold_anchors(input.model, contacts, body);
    start = body.node;
    const SolveStats stats = solve_nodal(input, contacts, h, h / now.last, solver, body);
    result.sweeps += stats.sweeps;
    result.work += stats.work;
    result.residual = std::max(result.residual, stats.residual);
  }
  settle(h, start, body);
  {
    const RoomTimer room(timer, Room::flow);
    const double taken = flow_nodal(input.model, solver, body);
    body.absorbed += taken;
    spring -= taken;
    body.stored = stored_nodal(input.model, contacts, solver, body);
  }
  react(input, now, double(h), contacts, solver.contact_forces, state);
  // At the turning point of a crash nothing moves for a moment, but the body is about to spring back.
  if (body.force.norm() * double(h) > double(settle_speed) * input.mass.mass) body.settled = false;
  ++result.substeps;
  return h;
}

void tick_nodal(const StepInput& input, Scratch& scratch, StepState& state, Timer* timer) {
  auto& [body, motion, result, spring] = state;
  const int count = choose_substeps(input, scratch.contacts, body, motion);
  const double h = input.seconds / count;
  spring = body.lost ? 0 : std::max(0.0, body.stored - body.owed);
  float last = body.step_seconds > 0 ? body.step_seconds : float(h);
  for (int k = 0; k < count; ++k) last = step(input, {k * h, h, last}, scratch, state, timer);
  scratch.solver.team.leave();
  const bool balanced = body.lost || body.settled || !std::isfinite(input.mass.mass);
  body.owed = balanced ? 0 : std::max(0.0, body.stored - spring);
}

void tick_classic(const StepInput& input, Scratch& scratch, StepState& state, Timer* timer) {
  auto& [body, motion, result, spring] = state;
  const std::vector<Contact>& contacts = scratch.contacts.contact;
  body.force.setZero();  // `classic` has no forces
  body.moment.setZero();
  const Substep whole{0, input.seconds, float(input.seconds)};
  if (!meet(input, whole, advance(motion, input.mass, input.seconds), scratch, state, timer)) return;
  back_up(body, scratch.backup);
  const RoomTimer room(timer, Room::solve);
  scratch.start = body.node;
  solve_classic(input.model, input.parameters, contacts, body);
  settle(float(input.seconds), scratch.start, body);
  for (const Contact& contact : contacts) {
    result.contacts += contact.after < 0;
    result.deepest = std::max(result.deepest, -contact.after);
  }
  body.touching = result.contacts > 0;
  result.substeps = 1;
}

}  // namespace

void ScratchDeleter::operator()(Scratch* scratch) const { delete scratch; }
ScratchHandle make_scratch() { return ScratchHandle(new Scratch); }

bool wakes(const StepInput& input, Scratch& scratch, const DeformableState& body, Motion motion) {
  ContactSet& contacts = scratch.contacts;
  find_candidates(input, body, motion, contacts);
  if (contacts.candidate.empty()) return body.touching;
  const bool whole = input.parameters.solver == Solver::classic;
  const int count = whole ? 1 : choose_substeps(input, contacts, body, motion);
  const double h = input.seconds / count;
  float drift = body.drift;
  for (int k = 0; k < count; ++k) {
    const Pose to = path(input.mass, body, motion, h);
    find_contacts(body, input.obstacles, {motion.pose, to, k * h, h}, contacts);
    motion.pose = to;
    if (is_woken(h, contacts.contact, body, drift)) return true;
    if (body.touching) push(h * body.force, h * body.moment, input.mass, motion);
  }
  return false;
}

StepResult deform(const StepInput& input, Scratch& scratch, DeformableState& body, Motion& motion, Timer* timer) {
  const Motion begin = motion;
  StepState state{body, motion};
  StepResult& result = state.result;
  scratch.backup.taken = false;
  {
    const RoomTimer room(timer, Room::contacts);
    find_candidates(input, body, motion, scratch.contacts);
  }
  if (scratch.contacts.candidate.empty() && body.settled && !body.touching) {
    motion.pose = advance(motion, input.mass, input.seconds);
    return result;
  }
  (input.parameters.solver == Solver::classic ? tick_classic : tick_nodal)(input, scratch, state, timer);
  if (scratch.backup.taken && !is_finite(body, motion)) {
    restore(input.model, begin, scratch.backup, body, motion);
    result = {};
    result.recovered = true;
  }
  if (result.substeps > 0) measure_reach(input.model, body);
  if (body.settled) body.history = {}, body.lost = false;
  if (result.substeps > 0 && body.settled && !body.touching && revert_inverted(input.model, body)) {
    body.settled = false;
    body.lost = true;  // else the reverted tets would flow again at once
  }
  return result;
}

}  // namespace crumple

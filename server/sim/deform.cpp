#include "sim/deform.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "sim/classic.h"
#include "sim/rest.h"
#include "sim/scratch.h"
#include "sim/step_group.h"

namespace crumple {
namespace {

// A tick in which cars touch one another is solved again with 2 and 4 times as many sub-steps if its energy error is larger,
// or if a body is torn.
constexpr double largest_error = 0.01;
constexpr int most_times = 4;
constexpr double slow_speed = 0.1;  // m/s

// Accelerates the cars by their hosts' own forces for some seconds.
void pull(std::span<Member> island, double seconds) {
  for (Member& member : island) member.state.motion.velocity += seconds * member.input.pull;
}

// Solves all sub-steps, `times` as many as the motion asks for.
void run_substeps(std::span<Member> island, double closing, int times, Timer* timer) {
  int count = 1;
  for (const Member& member : island) {
    const auto& [body, motion, result, spring] = member.state;
    count = std::max(count, choose_substeps(member.input, member.scratch.contacts, body, motion, closing));
  }
  count *= times;
  const double h = island.front().input.seconds / count;
  for (Member& member : island) {
    auto& [body, motion, result, spring] = member.state;
    spring = std::max(0.0, body.stored - body.owed);
  }
  pull(island, -island.front().input.seconds);
  for (int k = 0; k < count; ++k) {
    const Substep now{k * h, h};
    pull(island, 0.5 * h);
    for (PairGroup& group : meet(island, now, timer)) step_group(island, group, now, timer);
    pull(island, 0.5 * h);
  }
  island.front().scratch.team.leave();
}

// Whether shorter sub-steps may help. They do not if an obstacle was put into a car: it brings energy from outside. Cars with
// fewer sub-steps than the default, such as those that the budget has restricted, are kept as they are.
bool can_improve(std::span<const Member> island) {
  const auto touches = [](const Member& member) { return !member.state.result.partners.empty(); };
  const auto is_restricted = [](const Member& member) { return coarseness(member.input.parameters) > 1; };
  return std::any_of(island.begin(), island.end(), touches) && std::none_of(island.begin(), island.end(), is_restricted);
}

// Whether a sound body has tets that have lost their shape. A tet that a sub-step turns inside out does not flow, so it stores
// energy that nothing gave it.
bool is_torn(std::span<const Member> island) {
  return std::any_of(island.begin(), island.end(),
                     [](const Member& member) { return member.state.result.lost > 0 && !member.scratch.backup.body.lost; });
}

// Energy that the bodies store in the tick and their motion did not give, or the other way round, as a share of all that these
// bodies have taken up. The motion may pay what they owe. Energies that move the cars no faster than slow_speed do not count.
double energy_error(std::span<const Member> island) {
  double before = 0, now = 0, taken = 0, little = 0;
  for (const Member& member : island) {
    const auto& [body, motion, result, spring] = member.state;
    taken += body.stored + body.absorbed;
    if (!std::isfinite(member.input.mass.mass)) continue;
    before += body.owed;
    now += body.stored - spring;
    little += 0.5 * member.input.mass.mass * slow_speed * slow_speed;
  }
  if (!std::isfinite(now)) return std::numeric_limits<double>::infinity();
  const double error = std::max(now - before, -now);
  return error > little ? error / taken : 0;
}

// What a body stores beyond what the motion gave it, it will not give back.
void note_debts(std::span<Member> island) {
  for (Member& member : island) {
    auto& [body, motion, result, spring] = member.state;
    const bool balanced = body.settled || !std::isfinite(member.input.mass.mass);
    body.owed = balanced ? 0 : std::max(0.0, body.stored - spring);
  }
}

// Takes a tick back, so that it can be solved again in shorter sub-steps. Of its result only the cost remains.
void take_back(std::span<Member> island, std::span<const Motion> begin) {
  for (size_t k = 0; k < island.size(); ++k) {
    auto& [body, motion, result, spring] = island[k].state;
    Backup& backup = island[k].scratch.backup;
    if (backup.taken) std::swap(body, backup.body);
    backup.taken = false;
    motion = begin[k];
    result = {.sweeps = result.sweeps, .work = result.work};
  }
}

void tick_nodal(std::span<Member> island, std::span<const Motion> begin, double closing, Timer* timer) {
  run_substeps(island, closing, 1, timer);
  const auto solve_again = [&](int times) {
    take_back(island, begin);
    run_substeps(island, closing, times, timer);
  };
  double least = energy_error(island);
  int times = 1, best = 1;
  bool good = !can_improve(island) || (least <= largest_error && !is_torn(island));
  while (!good && times < most_times) {
    solve_again(times *= 2);
    const double error = energy_error(island);
    good = error <= largest_error && !is_torn(island);
    if (good || error < least) least = error, best = times;
  }
  if (best != times) solve_again(best);
  note_debts(island);
}

void tick_classic(Member& member, Timer* timer) {
  auto& [body, motion, result, spring] = member.state;
  auto& [contacts, solver, start, backup, team, pairs] = member.scratch;
  const StepInput& input = member.input;
  body.force.setZero();  // `classic` has no forces
  body.moment.setZero();
  body.pairs.push.clear();
  const Substep whole{0, input.seconds};
  const Pose to = advance(motion, input.mass, input.seconds);
  {
    const StageTimer stage(timer, SolveStage::contacts);
    const FramePath frame{motion.pose, to, 0, input.seconds};
    if (!find_contacts(body, input.obstacles, frame, contacts)) result.contact_overflow = true;
    motion.pose = to;
  }
  Met met;
  for (const Contact& contact : contacts.contact) met.add(contact, body);
  if (body.settled && !is_woken(whole.seconds, met, body, body.drift)) return;
  back_up(body, backup);
  const StageTimer stage(timer, SolveStage::solve);
  start = body.node;
  solve_classic(input.model, input.parameters, contacts.contact, body);
  settle(float(input.seconds), start, body);
  for (const Contact& contact : contacts.contact) {
    result.contacts += contact.after < 0;
    result.deepest = std::max(result.deepest, -contact.after);
  }
  body.touching = result.contacts > 0;
  result.substeps = 1;
}

// Undoes a tick that went wrong, and tidies up.
void finish(std::span<Member> island, std::span<const Motion> begin) {
  const auto failed = [](const Member& member) {
    return member.scratch.backup.taken && !is_finite(member.state.body, member.state.motion);
  };
  const bool undo = std::any_of(island.begin(), island.end(), failed);
  for (size_t k = 0; k < island.size(); ++k) {
    const Model& model = island[k].input.model;
    Backup& backup = island[k].scratch.backup;
    auto& [body, motion, result, spring] = island[k].state;
    if (undo && backup.taken) {
      restore(model, begin[k], backup, body, motion);
      result = {};
      result.recovered = true;
    }
    if (result.substeps > 0) measure_reach(model, body);
    if (body.settled) body.history = {}, body.lost = false;
    if (result.substeps > 0 && body.settled && !body.touching && revert_inverted(model, body)) {
      body.settled = false;
      body.lost = true;  // else the reverted tets would flow again at once
    }
  }
}

// Whether nothing is near any of the cars, and all of them are at rest.
bool nothing_happens(std::span<const Member> island) {
  return std::all_of(island.begin(), island.end(), [](const Member& member) {
    const DeformableState& body = member.state.body;
    return member.scratch.contacts.candidate.empty() && body.settled && !body.touching;
  });
}

}  // namespace

void ScratchDeleter::operator()(Scratch* scratch) const { delete scratch; }
ScratchHandle make_scratch() { return ScratchHandle(new Scratch); }

void deform(std::span<Member> island, Timer* timer) {
  std::vector<Motion> begin;
  std::vector<PairCandidates>& near = island.front().scratch.pairs;
  double closing = 0;
  {
    const StageTimer stage(timer, SolveStage::contacts);
    const std::vector<float> travel = find_pair_candidates(island, near);
    for (size_t k = 0; k < island.size(); ++k) {
      Member& member = island[k];
      begin.push_back(member.state.motion);
      member.scratch.backup.taken = false;
      find_candidates(member.input, member.state.body, member.state.motion, member.scratch.contacts, travel[k]);
      closing = std::max(closing, 0.5 * double(travel[k]) / member.input.seconds);  // each car takes half of the way
    }
  }
  if (near.empty() && nothing_happens(island)) {
    for (Member& member : island) {
      member.state.motion.pose = advance(member.state.motion, member.input.mass, member.input.seconds);
    }
    return;
  }
  if (island.size() == 1 && island.front().input.parameters.solver == Solver::classic) {
    tick_classic(island.front(), timer);
  } else {
    tick_nodal(island, begin, closing, timer);
  }
  finish(island, begin);
}

StepResult deform(const StepInput& input, Scratch& scratch, DeformableState& body, Motion& motion, Timer* timer) {
  Member member{input, 0, scratch, {body, motion}};
  deform({&member, 1}, timer);
  return member.state.result;
}

}  // namespace crumple

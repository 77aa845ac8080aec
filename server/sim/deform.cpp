#include "sim/deform.h"

#include "sim/classic.h"
#include "sim/energy_balance.h"
#include "sim/rest.h"
#include "sim/scratch.h"

namespace crumple {
namespace {

// The length of the body's last sub-step, s.
float last_seconds(const DeformableState& body, const Substep& now) {
  return body.step_seconds > 0 ? body.step_seconds : float(now.seconds);
}

// Moves the cars' frames, finds all contacts of a sub-step, and groups the cars by those with each other.
std::vector<PairGroup> meet(std::span<Member> island, const Substep& now, Timer* timer) {
  const StageTimer stage(timer, SolveStage::contacts);
  std::vector<Pose> from, to;
  std::vector<float> share;
  for (Member& member : island) {
    auto& [body, motion, result, spring] = member.state;
    from.push_back(motion.pose);
    to.push_back(path(member.input.mass, body, motion, now.seconds));
    share.push_back(float(now.seconds) / last_seconds(body, now));
    const FramePath frame{motion.pose, to.back(), now.start, now.seconds};
    if (!find_contacts(body, member.input.obstacles, frame, member.scratch.contacts)) result.contact_overflow = true;
  }
  std::vector<PairGroup> groups = find_pairs(island, island.front().scratch.pairs, from, to, share, now.seconds);
  for (size_t k = 0; k < island.size(); ++k) island[k].state.motion.pose = to[k];
  return groups;
}

// Whether a body of the group moves or is woken: then the whole group is solved.
bool is_awake(std::span<Member> island, const PairGroup& group, const Substep& now) {
  bool awake = false;
  for (size_t k = 0; k < group.member.size(); ++k) {
    Member& member = island[group.member[k]];
    DeformableState& body = member.state.body;
    Met met;
    for (const Contact& contact : member.scratch.contacts.contact) met.add(contact, body);
    for (const PairContact& contact : group.contact) {
      if (contact.car[0] == k || contact.car[1] == k) met.add(contact);
    }
    awake = !body.settled || is_woken(now.seconds, met, body, body.drift) || awake;
  }
  return awake;
}

// Readies a car for its first solved sub-step of the tick.
void prepare(Member& member, Team& team) {
  Scratch& scratch = member.scratch;
  if (scratch.backup.taken) return;
  back_up(member.state.body, scratch.backup);
  prepare_nodal(member.input.model, member.input.parameters, member.state.body, team, scratch.solver);
}

// The length of the group's sub-step: it begins when the first contact closes.
float seconds_of(std::span<Member> island, const PairGroup& group, const Substep& now) {
  Touchdown touchdown;
  for (uint32_t k : group.member) {
    if (island[k].state.body.touching) return float(now.seconds);
    for (const Contact& contact : island[k].scratch.contacts.contact) touchdown.add(contact.before, contact.after);
  }
  for (const PairContact& contact : group.contact) touchdown.add(contact.before, contact.after);
  return float(now.seconds) * touchdown.rest();
}

// The nodes of a member that touch other cars. Null: none, though the others of the group may touch one another.
const PairIndex* touched(const PairGroup& group, size_t member) {
  return group.contact.empty() || group.index[member].node.empty() ? nullptr : &group.index[member];
}

// Finds the new shapes of the group's bodies.
void solve(std::span<Member> island, PairGroup& group, const Substep& now, float h, Timer* timer) {
  const StageTimer stage(timer, SolveStage::solve);
  std::vector<NodalPart> parts;
  for (size_t k = 0; k < group.member.size(); ++k) {
    Member& member = island[group.member[k]];
    auto& [contacts, solver, start, backup, team, pairs] = member.scratch;
    DeformableState& body = member.state.body;
    const PairIndex* index = touched(group, k);
    index_contacts(member.input.model.node.size(), contacts);
    hold_anchors(member.input.model, index, contacts, body);
    start = body.node;
    parts.push_back({member.input, contacts, index, h / last_seconds(body, now), solver, body});
  }
  solve_nodal(parts, group.contact, h);
  for (size_t k = 0; k < group.member.size(); ++k) {
    StepResult& result = island[group.member[k]].state.result;
    result.sweeps += parts[k].stats.sweeps;
    result.work += parts[k].stats.work;
    result.residual = std::max(result.residual, parts[k].stats.residual);
  }
}

// One sub-step of cars that contacts connect, or of one car.
void step(std::span<Member> island, PairGroup& group, const Substep& now, Timer* timer) {
  if (!is_awake(island, group, now)) {
    for (uint32_t k : group.member) stay_at_rest(island[k].input, now, island[k].state);
    return;
  }
  Team& helpers = island.front().scratch.team;
  helpers.gather();
  for (uint32_t k : group.member) prepare(island[k], helpers);
  const float h = seconds_of(island, group, now);
  solve(island, group, now, h, timer);
  for (size_t k = 0; k < group.member.size(); ++k) {
    Member& member = island[group.member[k]];
    auto& [body, motion, result, spring] = member.state;
    auto& [contacts, solver, start, backup, team, pairs] = member.scratch;
    settle(h, start, body);
    const StageTimer stage(timer, SolveStage::flow);
    const double taken = flow_nodal(member.input.model, solver, body);
    body.absorbed += taken;
    spring -= taken;
    const double before = body.stored;
    body.stored = stored_nodal(member.input.model, contacts, touched(group, k), solver, body);
    // Nothing works on a free body. What it stores more, it took back from the flow (revert_inverted).
    const bool free = !body.touching && contacts.contact.empty() && !touched(group, k);
    if (body.lost && free) body.absorbed -= std::clamp(body.stored - before, 0.0, body.absorbed);
  }
  react(island, group, now, double(h));
  remember_pairs(island, group);
  for (uint32_t k : group.member) {
    auto& [body, motion, result, spring] = island[k].state;
    // What was let go while the rest moved may have kept still since then: only a solve of all nodes tells that a body rests.
    if (!island[k].scratch.solver.active.whole) body.settled = false;
    // At the turning point of a crash nothing moves for a moment, but the body is about to spring back.
    if (body.force.norm() * double(h) > double(settle_speed) * island[k].input.mass.mass) body.settled = false;
    ++result.substeps;
  }
}

// Accelerates the cars by their hosts' own forces for some seconds.
void pull(std::span<Member> island, double seconds) {
  for (Member& member : island) member.state.motion.velocity += seconds * member.input.pull;
}

void tick_nodal(std::span<Member> island, double closing, Timer* timer) {
  int count = 1;
  for (const Member& member : island) {
    const auto& [body, motion, result, spring] = member.state;
    count = std::max(count, choose_substeps(member.input, member.scratch.contacts, body, motion, closing));
  }
  const double h = island.front().input.seconds / count;
  for (Member& member : island) {
    auto& [body, motion, result, spring] = member.state;
    spring = std::max(0.0, body.stored - body.owed);
  }
  pull(island, -island.front().input.seconds);
  for (int k = 0; k < count; ++k) {
    const Substep now{k * h, h};
    pull(island, 0.5 * h);
    for (PairGroup& group : meet(island, now, timer)) step(island, group, now, timer);
    pull(island, 0.5 * h);
  }
  island.front().scratch.team.leave();
  for (Member& member : island) {
    auto& [body, motion, result, spring] = member.state;
    const bool balanced = body.settled || !std::isfinite(member.input.mass.mass);
    body.owed = balanced ? 0 : std::max(0.0, body.stored - spring);
  }
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
    tick_nodal(island, closing, timer);
  }
  finish(island, begin);
}

StepResult deform(const StepInput& input, Scratch& scratch, DeformableState& body, Motion& motion, Timer* timer) {
  Member member{input, 0, scratch, {body, motion}};
  deform({&member, 1}, timer);
  return member.state.result;
}

}  // namespace crumple

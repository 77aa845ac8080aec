#include "sim/step_group.h"

#include "sim/energy_balance.h"
#include "sim/rest.h"
#include "sim/scratch.h"
#include "sim/substeps.h"

namespace crumple {
namespace {

// The length of the body's last sub-step, s.
float last_seconds(const DeformableState& body, const Substep& now) {
  return body.step_seconds > 0 ? body.step_seconds : float(now.seconds);
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
    result.lost = std::max(result.lost, parts[k].stats.lost);
  }
}

}  // namespace

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

void step_group(std::span<Member> island, PairGroup& group, const Substep& now, Timer* timer) {
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

}  // namespace crumple

#include "viewer/follow.h"

#include <algorithm>
#include <tuple>
#include <utility>
#include <vector>

#include "schema/message_generated.h"

namespace crumple::viewer {
namespace {

using Entry = std::pair<const std::string, FollowedCar>;

// The pause after a question that brought nothing: each time twice as long.
std::chrono::milliseconds pause_of(const FollowedCar& car) {
  return car.tries == 0 ? std::chrono::milliseconds(0)
                        : std::min(ask_again * (1 << std::min(car.tries - 1, 10)), longest_pause);
}

// Asks at once if a slot is free and the pause after the last question is over. Otherwise ask_due() asks later.
void ask_for_keyframe(Following& all, const std::string& id, FollowedCar& car, Time now) {
  if (car.asking || (car.owed && now - car.asked < pause_of(car))) return;
  car.owed = true;
  if (all.open >= questions_limit) return;
  car.asking = all.ask(all.root + "car/" + id + "/key/" + std::to_string(car.level), {}, keyframe_patience);
  if (!car.asking) return;
  all.questions[car.asking] = {id};
  ++all.open;
  ++car.tries;
  car.asked = now;
  car.unsure = false;
}

// Frees the slot of a question: an answer has come, or none will come.
void free_slot(Following& all, Question& question) {
  if (std::exchange(question.open, false)) --all.open;
}

// Forgets an earlier question: its answer would say nothing about the present. The network still carries the question, so it
// keeps its slot.
void forget_question(Following& all, FollowedCar& car) {
  const auto at = all.questions.find(std::exchange(car.asking, 0));
  if (at != all.questions.end()) at->second.id.clear();
  car.owed = false;
}

void begin_anew(Following& all, FollowedCar& car) {
  car.fresh = true;
  car.coming = {};
  car.tries = 0;
  forget_question(all, car);
}

// Counts the bytes of the car's surfaces anew.
void weigh(Following& all, FollowedCar& car) {
  all.held -= std::exchange(car.held, 0);
  for (const Surface* one : {&car.surface, &car.coming})
    for (const Quanta* quanta : {&one->quanta, &one->key, &one->key_parts.quanta, &one->delta_parts.quanta})
      car.held += quanta->capacity() * sizeof(int16_t);
  all.held += car.held;
}

void erase(Following& all, Cars::iterator at) {
  forget_question(all, at->second);
  all.held -= at->second.held;
  all.cars.erase(at);
}

// Forgets the car without a token that has been silent longest, so that a scene may use new ids for ever. False if all cars
// have tokens.
bool forget_one(Following& all, const FollowedCar* besides = nullptr) {
  auto oldest = all.cars.end();
  for (auto at = all.cars.begin(); at != all.cars.end(); ++at) {
    if (at->second.alive || at->second.named || &at->second == besides) continue;
    if (oldest == all.cars.end() || at->second.last < oldest->second.last) oldest = at;
  }
  if (oldest == all.cars.end()) return false;
  erase(all, oldest);
  return true;
}

// Returns the car with this id if the viewer follows it. A viewer that follows all cars adds it.
Entry* followed(Following& all, std::string_view id) {
  auto at = all.cars.find(id);
  if (at == all.cars.end()) {
    if (all.level == none || (all.cars.size() >= cars_limit && !forget_one(all))) return nullptr;
    at = all.cars.try_emplace(std::string(id)).first;
    at->second.level = all.level;
  }
  return &*at;
}

void change_level(Following& all, const std::string& id, FollowedCar& car, int level, Time now) {
  if (car.level == level) return;
  car.level = level;
  car.surface.key = {};  // no delta of the new level refers to it
  begin_anew(all, car);
  if (car.alive) ask_for_keyframe(all, id, car, now);
}

SurfaceNews take_surface(Following& all, Entry& entry, bool keyframe, bool asked_for, std::span<const uint8_t> bytes,
                         Time now) {
  auto& [id, car] = entry;
  // Ticks of an earlier car with this id, an earlier owner or another level cannot be compared with the present ones.
  Surface& surface = car.fresh && keyframe ? car.coming : car.surface;
  if (asked_for) surface.key_parts = {};
  const uint64_t key_before = surface.key.empty() ? 0 : surface.key_tick;
  Outcome outcome = keyframe ? apply_keyframe(bytes, surface) : apply_delta(bytes, surface);
  weigh(all, car);
  while (all.held > surfaces_limit && forget_one(all, &car)) {
  }
  if (all.held > surfaces_limit) {
    const int tries = std::max(car.tries, 1);  // it will be asked for less and less often
    car.surface = {};
    begin_anew(all, car);
    car.tries = tries;
    weigh(all, car);
    outcome = {Applied::refused, "the surfaces of all followed cars would need more than 1 GiB"};
    return {&id, &car, std::move(outcome), asked_for, false};
  }
  const Applied applied = outcome.applied;
  const bool other_key = !surface.key.empty() && surface.key_tick != key_before;
  car.unsure = !asked_for;
  car.owed &= !asked_for || applied == Applied::refused;
  if (keyframe && applied == Applied::whole) car.owed = false;
  if (!car.owed) car.tries = 0;
  if (asked_for) car.doubtful = false;
  if (applied == Applied::whole && &surface == &car.coming) car.surface = std::exchange(car.coming, {});
  if (applied == Applied::whole) car.fresh &= !keyframe;
  if (applied == Applied::missing_keyframe) ask_for_keyframe(all, id, car, now);
  const bool counts = applied == Applied::whole || applied == Applied::part || other_key;
  return {&id, &car, std::move(outcome), asked_for, counts};
}

// Asks for all keyframes again after another owner appeared, and some time after an owner went. The viewer may hold surfaces of
// one owner and receive messages of the other. If both were there for a moment, no token of the scene or of its cars has gone.
// Owners that come and go without end are tokens of strangers, so the viewer believes them less and less often.
void renew_due(Following& all, Time now) {
  if (now < all.renew_at || now - all.renewed < all.renew_pause) return;
  all.renew_pause = now - all.renewed > owners_settle ? ask_again : std::min(2 * all.renew_pause, longest_pause);
  all.renewed = now;
  all.renew_at = Time::max();
  for (auto& [id, car] : all.cars) {
    if (!car.alive || car.surface.quanta.empty()) continue;  // ask_due() asks for the others anyway
    begin_anew(all, car);
    ask_for_keyframe(all, id, car, now);
  }
}

}  // namespace

void Following::follow(const std::string& id, int wanted, Time now) {
  FollowedCar& car = cars.try_emplace(id).first->second;
  car.named = true;
  change_level(*this, id, car, wanted, now);
  ask_for_keyframe(*this, id, car, now);  // even before its token comes
}

void Following::follow_all(int wanted, Time now) {
  level = wanted;
  for (auto& [id, car] : cars) change_level(*this, id, car, wanted, now);
}

void Following::forget(std::string_view id) {
  const auto at = cars.find(id);
  if (at == cars.end()) return;
  erase(*this, at);
}

SurfaceNews Following::take_sample(const Key& key, std::span<const uint8_t> bytes, Time now) {
  if (key.channel != Channel::keyframe && key.channel != Channel::delta) return {};
  Entry* entry = followed(*this, key.id);
  // The sample is of a level that the viewer has left, or no car that it follows.
  if (!entry || key.number != static_cast<uint64_t>(entry->second.level)) return {};
  entry->second.last = now;
  return take_surface(*this, *entry, key.channel == Channel::keyframe, false, bytes, now);
}

void Following::take_token(const Key& key, bool alive, Time now) {
  if (key.channel == Channel::owner) {
    renew_at = alive ? now : std::min(renew_at, now + ask_again);
    return renew_due(*this, now);
  }
  Entry* entry = key.channel == Channel::command ? followed(*this, key.id) : nullptr;
  if (!entry) return;
  auto& [id, car] = *entry;
  const bool asked = alive && !car.alive && (car.asking || !car.fresh);  // the viewer asked before the token came
  car.alive = alive;
  car.gone = !alive;
  car.doubtful = false;  // the viewer asks for a new car's keyframe anyway
  if (asked) return;
  begin_anew(*this, car);  // the next car of this id did not get the question
  if (alive) ask_for_keyframe(*this, id, car, now);
}

// Asks for the keyframe of each car for which the server has sent something newer than the viewer's surface, unless that may
// still be on its way.
void Following::take_health(const schema::Health& message, Time now) {
  if (!message.told()) return;
  for (const auto* told : *message.told()) {
    const auto at = cars.find(told->car()->string_view());
    if (at == cars.end() || told->ticks()->size() <= static_cast<uint32_t>(at->second.level)) continue;
    FollowedCar& car = at->second;
    const bool older = car.surface.quanta.empty() || car.surface.tick < told->ticks()->Get(static_cast<uint32_t>(car.level));
    if (older && now - car.last > on_its_way) ask_for_keyframe(*this, at->first, car, now);
  }
}

SurfaceNews Following::take_reply(uint64_t ticket, std::span<const uint8_t> bytes, bool failed, Time now) {
  const auto at = questions.find(ticket);
  if (at == questions.end()) return {};
  free_slot(*this, at->second);
  const auto entry = failed ? cars.end() : cars.find(at->second.id);
  return entry == cars.end() ? SurfaceNews{} : take_surface(*this, *entry, true, true, bytes, now);
}

void Following::end(uint64_t ticket) {
  const auto at = questions.find(ticket);
  if (at == questions.end()) return;
  free_slot(*this, at->second);
  if (const auto entry = cars.find(at->second.id); entry != cars.end()) entry->second.asking = 0;
  questions.erase(at);
}

void Following::doubt(Time now) {
  for (auto& [id, car] : cars) {
    if (!car.alive || car.surface.quanta.empty()) continue;
    forget_question(*this, car);
    car.tries = 0;
    car.doubtful = true;
  }
  ask_due(now);
}

// Free slots go first to the cars with the fewest tries, then to those that have waited longest. A car that does not exist
// fails each time, so it cannot keep a slot from one that exists.
void Following::ask_due(Time now) {
  renew_due(*this, now);
  std::vector<Entry*> due;
  for (Entry& entry : cars) {
    const FollowedCar& car = entry.second;
    const bool unanswered = (car.doubtful || car.owed || car.fresh) && car.alive && now - car.asked > pause_of(car);
    if (!car.asking && (unanswered || (car.unsure && now - car.last > silence))) due.push_back(&entry);
  }
  const size_t slots = questions_limit - std::min(open, questions_limit);
  const auto last = due.begin() + static_cast<ptrdiff_t>(std::min(due.size(), slots));
  std::partial_sort(due.begin(), last, due.end(), [](const Entry* a, const Entry* b) {
    return std::tie(a->second.tries, a->second.asked, a->first) < std::tie(b->second.tries, b->second.asked, b->first);
  });
  for (auto at = due.begin(); at != last; ++at) ask_for_keyframe(*this, (*at)->first, (*at)->second, now);
}

}  // namespace crumple::viewer

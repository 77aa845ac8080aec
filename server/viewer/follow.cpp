#include "viewer/follow.h"

#include <algorithm>
#include <utility>

#include "schema/message_generated.h"

namespace crumple::viewer {
namespace {

using Entry = std::pair<const std::string, FollowedCar>;

// Whether another question may be put now. A car of which something has come is asked for at once.
bool may_ask(const Following& all, const FollowedCar& car) {
  return all.tickets.size() < questions_limit || car.last != Time{} || !car.surface.quanta.empty();
}

// Asks at once, but waits before it asks again if the last answer brought nothing: each time twice as long.
void ask_for_keyframe(Following& all, const std::string& id, FollowedCar& car, Time now) {
  if (car.asking || (car.owed && now - car.asked < car.pause)) return;
  if (!may_ask(all, car)) return;  // ask_due() tries again
  car.pause = car.owed ? std::min(2 * car.pause, longest_pause) : ask_again;
  car.owed = true;
  car.asking = all.ask(all.root + "car/" + id + "/key/" + std::to_string(car.level), {}, keyframe_patience);
  if (!car.asking) return;
  all.tickets[car.asking] = id;
  car.asked = now;
  car.unsure = false;
}

// Forgets an earlier question: its answer would say nothing about the present.
void forget_question(Following& all, FollowedCar& car) {
  all.tickets.erase(std::exchange(car.asking, 0));
  car.owed = false;
}

void begin_anew(Following& all, FollowedCar& car) {
  car.fresh = true;
  car.coming = {};
  forget_question(all, car);
}

// Returns the car with this id if the viewer follows it. A viewer that follows all cars adds it.
Entry* followed(Following& all, std::string_view id) {
  auto at = all.cars.find(id);
  if (at == all.cars.end()) {
    if (all.level == none || all.cars.size() >= cars_limit) return nullptr;
    at = all.cars.try_emplace(std::string(id)).first;
    at->second.level = all.level;
  }
  return &*at;
}

void change_level(Following& all, const std::string& id, FollowedCar& car, int level, Time now) {
  if (car.level == level) return;
  car.level = level;
  car.surface.key.clear();  // no delta of the new level refers to it
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
  const Applied applied = outcome.applied;
  const bool other_key = !surface.key.empty() && surface.key_tick != key_before;
  car.unsure = !asked_for;
  car.owed &= !asked_for || applied == Applied::refused;
  if (asked_for) car.doubtful = false;
  if (applied == Applied::whole && &surface == &car.coming) car.surface = std::exchange(car.coming, {});
  if (applied == Applied::whole) car.fresh &= !keyframe;
  if (applied == Applied::missing_keyframe) ask_for_keyframe(all, id, car, now);
  const bool counts = applied == Applied::whole || applied == Applied::part || other_key;
  return {&id, &car, std::move(outcome), asked_for, counts};
}

// Another owner appeared. The viewer may hold surfaces of one owner and receive messages of the other. If both were there for a
// moment, no token of the scene or of its cars has gone. So the viewer asks for all keyframes again.
void another_owner(Following& all, Time now) {
  for (auto& [id, car] : all.cars) {
    if (!car.alive) continue;
    begin_anew(all, car);
    ask_for_keyframe(all, id, car, now);
  }
}

}  // namespace

void Following::follow(const std::string& id, int wanted, Time now) {
  FollowedCar& car = cars.try_emplace(id).first->second;
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
  forget_question(*this, at->second);
  cars.erase(at);
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
  if (key.channel == Channel::owner) return another_owner(*this, now);
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
  const auto at = tickets.find(ticket);
  if (at == tickets.end() || failed) return {};
  const auto entry = cars.find(at->second);
  return entry == cars.end() ? SurfaceNews{} : take_surface(*this, *entry, true, true, bytes, now);
}

void Following::end(uint64_t ticket) {
  const auto at = tickets.find(ticket);
  if (at == tickets.end()) return;
  if (const auto entry = cars.find(at->second); entry != cars.end()) entry->second.asking = 0;
  tickets.erase(at);
}

void Following::doubt(Time now) {
  for (auto& [id, car] : cars) {
    if (!car.alive || car.surface.quanta.empty()) continue;
    forget_question(*this, car);
    car.asked = {};
    car.doubtful = true;
  }
  ask_due(now);
}

void Following::ask_due(Time now) {
  for (auto& [id, car] : cars) {
    const bool unanswered = (car.doubtful || car.owed || car.fresh) && car.alive && now - car.asked > car.pause;
    if (unanswered || (car.unsure && now - car.last > silence)) ask_for_keyframe(*this, id, car, now);
  }
}

}  // namespace crumple::viewer

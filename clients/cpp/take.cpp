// Takes in messages. It checks a message before it uses a field of it. A malformed message counts as refused and changes
// nothing.
#include <algorithm>
#include <utility>

#include "cpp/session.h"
#include "protocol/key.h"
#include "protocol/message.h"
#include "schema/message_generated.h"

namespace crumple::client {
namespace {

void copy(const schema::Vec3& from, float (&to)[3]) {
  to[0] = from.x();
  to[1] = from.y();
  to[2] = from.z();
}

CrumplePose pose_of(const schema::Pose& pose) {
  const auto& p = pose.position();
  const auto& q = pose.orientation();
  return {{p.x(), p.y(), p.z()}, {q.x(), q.y(), q.z(), q.w()}};
}

void refuse(Crumple& session, std::string why) {
  ++session.statistics.refused;
  fail(CRUMPLE_BAD_ARGUMENT, std::move(why));
}

void take_surface(Crumple& session, const SurfaceNews& news, size_t size) {
  if (!news.id) return;
  ++session.statistics.surface;
  session.statistics.surface_bytes += size;
  const Surface& surface = news.car->surface;
  switch (news.outcome.applied) {
    case Applied::whole: {
      if (session.shown.size() > session.following.cars.size())  // `following` has forgotten some
        std::erase_if(session.shown, [&](const auto& each) { return !session.following.cars.contains(each.first); });
      ShownCar& shown = session.shown[*news.id];
      shown.dirty = true;
      if (!news.asked_for) session.clock.take(surface.tick);
      if (!shown.past.empty()) remember(surface, shown, session.clock.rate);
      break;
    }
    case Applied::old:
      ++session.statistics.older;
      break;
    case Applied::refused:
      refuse(session, news.outcome.why);
      break;
    case Applied::part:
    case Applied::missing_keyframe:
      break;
  }
}

void take_reactions(Crumple& session, std::span<const uint8_t> bytes) {
  const auto* message = verified<schema::Reactions>(bytes);
  if (!message) return refuse(session, "reactions are not a well-formed FlatBuffers table");
  session.clock.take(message->tick());
  const auto is_name = [](const flatbuffers::String* text) { return crumple::is_id(text->string_view()); };
  const auto name_of = [&](const flatbuffers::String* text) { return session.names.insert(text->str()).first->c_str(); };
  for (const auto* from : *message->cars()) {
    const auto* partners = from->partners();
    const bool named =
        is_name(from->car()) && (!partners || std::all_of(partners->begin(), partners->end(), [&](const auto* each) {
          return is_name(each->car()) && is_name(each->host());
        }));
    if (!named || session.names.size() > 100'000) {
      refuse(session, "a reaction names a car or a host with an invalid id, or there are over 100000 of them");
      continue;
    }
    if (partners && partners->size() > partners_most) {
      refuse(session, "a reaction names " + std::to_string(partners->size()) + " partners; a car has at most " +
                          std::to_string(partners_most));
      continue;
    }
    Told& told = session.reactions.emplace_back();
    CrumpleReaction& to = told.reaction;
    to.car = name_of(from->car());
    to.tick = message->tick();
    to.time = message->time();
    copy(*from->impulse(), to.impulse);
    copy(*from->angular_impulse(), to.angular_impulse);
    to.pose = pose_of(*from->pose());
    copy(*from->velocity(), to.velocity);
    copy(*from->angular_velocity(), to.angular_velocity);
    to.energy_absorbed = from->energy_absorbed();
    to.energy_stored = from->energy_stored();
    to.deepest = from->deepest();
    to.contacts = from->contacts();
    for (uint32_t k = 0; partners && k < partners->size(); ++k) {
      const schema::Partner& one = *partners->Get(k);
      CrumplePartner& partner = told.partners.emplace_back();
      partner.car = name_of(one.car());
      partner.host = name_of(one.host());
      copy(*one.impulse(), partner.impulse);
      partner.contacts = one.contacts();
    }
    to.partner_count = static_cast<uint32_t>(told.partners.size());
  }
  while (session.reactions.size() > reactions_kept) session.reactions.pop_front();
}

void take_health(Crumple& session, std::span<const uint8_t> bytes) {
  const auto* message = verified<schema::Health>(bytes);
  if (!message) return refuse(session, "health is not a well-formed FlatBuffers table");
  session.following.take_health(*message, Clock::now());
  if (message->rate() >= 1 && message->rate() <= 1000 && static_cast<double>(message->rate()) != session.clock.rate) {
    session.clock = {};
    session.clock.rate = message->rate();
  }
  session.clock.take(message->tick());
  CrumpleHealth& health = session.health;
  health = {message->tick(), message->late(), message->rate(), 0, 0, 0};
  if (message->rooms())
    for (const auto* room : *message->rooms())
      if (room->name()->string_view() == "tick") {
        health.tick_ms = room->milliseconds();
        health.worst_ms = room->worst();
      }
  if (message->refusals())
    for (const auto* count : *message->refusals()) health.refusals += count->value();
}

// failed: the reply is an error sentence of the transport (a timeout) instead of an Answer.
void take_answer(Crumple& session, CommandAnswer& answer, std::span<const uint8_t> bytes, bool failed) {
  if (const auto* message = verified<schema::Answer>(bytes)) {
    answer.ok = message->ok();
    answer.tick = message->tick();
    if (message->sentence()) answer.sentence = message->sentence()->str();
    if (message->state()) answer.state.assign(message->state()->begin(), message->state()->end());
  } else if (failed) {
    answer.sentence.assign(reinterpret_cast<const char*>(bytes.data()), std::min<size_t>(bytes.size(), 500));
  } else {
    answer.sentence = "the answer is not a well-formed FlatBuffers table";
    ++session.statistics.refused;
  }
  answer.arrived = true;
}

void take_sample(Crumple& session, const Key& key, std::span<const uint8_t> bytes) {
  if (key.channel == Channel::health) return take_health(session, bytes);
  if (key.channel == Channel::reactions) return take_reactions(session, bytes);
  take_surface(session, session.following.take_sample(key, bytes, Clock::now()), bytes.size());
}

void take_reply(Crumple& session, uint64_t ticket, std::span<const uint8_t> bytes, bool failed) {
  if (const auto command = session.answers.find(ticket); command != session.answers.end()) {
    if (!command->second.arrived) take_answer(session, command->second, bytes, failed);
  } else if (auto news = session.fetching.take_reply(ticket, bytes, failed, Clock::now())) {
    take_asset(session, std::move(*news));
  } else {
    take_surface(session, session.following.take_reply(ticket, bytes, failed, Clock::now()), bytes.size());
  }
}

// Ends a ticket: nothing more comes for it.
void end_ticket(Crumple& session, uint64_t ticket) {
  if (const auto command = session.answers.find(ticket); command != session.answers.end()) {
    if (!command->second.arrived) command->second.sentence = "the server did not answer within the timeout of the session";
    command->second.arrived = true;
  } else if (auto news = session.fetching.end(ticket)) {
    take_asset(session, std::move(*news));
  } else {
    session.following.end(ticket);
  }
}

// Sends obstacles again: they are sent only once, and the line may have been down. A server that has them drops them by their
// number.
void send_obstacles_again(Crumple& session) {
  if (session.obstacles.empty()) return;
  const std::string key = session.root + "host/" + session.host + "/obstacles";
  net_put(session.net, key.c_str(), session.obstacles.data(), session.obstacles.size(), NET_REAL_TIME);
}

void take_liveliness(Crumple& session, const Key& key, bool alive) {
  if (key.channel == Channel::server) {
    session.server_alive = alive;
    if (!alive) session.clock = {};  // the ticks of the next server begin elsewhere
  }
  if (key.channel == Channel::owner || (key.channel == Channel::server && alive)) send_obstacles_again(session);
  session.following.take_token(key, alive, Clock::now());
}

}  // namespace

void ServerClock::take(uint64_t at) {
  const auto arrived = Clock::now();
  if (arrived - begun > std::chrono::seconds(1)) {
    before = std::exchange(least, std::numeric_limits<double>::infinity());
    begun = arrived;
  }
  tick = std::max(tick, at);
  least = std::min(least, std::chrono::duration<double>(arrived.time_since_epoch()).count() - static_cast<double>(at) / rate);
}

double ServerClock::now() const {
  if (tick == 0) return 0;
  return std::chrono::duration<double>(Clock::now().time_since_epoch()).count() - std::min(least, before);
}

bool held(const FollowedCar& car) { return !car.surface.quanta.empty() && !(car.doubtful && car.alive); }

void take(Crumple& session, const NetEvent& event) {
  const std::span<const uint8_t> bytes(event.data, event.size);
  if (event.kind == NET_REPLY || event.kind == NET_REPLY_END) {
    if (event.kind == NET_REPLY_END) return end_ticket(session, event.ticket);
    session.statistics.received_bytes += bytes.size();
    return take_reply(session, event.ticket, bytes, event.failed != 0);
  }
  const auto key = parse_key(event.key, session.root);
  if (!key) return;
  if (event.kind == NET_SAMPLE) {
    ++session.statistics.received;
    session.statistics.received_bytes += bytes.size();
    take_sample(session, *key, bytes);
  } else if (event.kind == NET_ALIVE || event.kind == NET_GONE) {
    take_liveliness(session, *key, event.kind == NET_ALIVE);
  }
}

}  // namespace crumple::client

#include "recording/replay.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <stdexcept>
#include <thread>

#include "recording/playback.h"
#include "recording/recording.h"
#include "schema/message_generated.h"
#include "tick/hash.h"
#include "tick/health.h"
#include "tick/levels.h"
#include "tick/snapshot.h"
#include "wire/decode.h"

namespace crumple {
namespace {

struct Verdict {
  uint64_t identical = 0;                  // ticks
  uint64_t differs = 0;                    // first differing tick; 0: none
  std::string how;                         // in which way it differs
  uint64_t lost = 0;                       // first tick that lost inputs or whose predecessor is missing; 0: none
  uint64_t outputs_lost = 0, lost_in = 0;  // outputs that are missing in the file; first tick with such a loss
  uint64_t messages = 0;                   // in the file
  // Not compared:
  bool health = false, before = false, inputs = false;  // before: hosts' messages from before the first tick; inputs: old files
  uint64_t others = 0, behind = 0;                      // messages on other programs' keys; messages after the last TickEnd
  std::string first_other, first_behind;
};

// One output of a tick.
struct Output {
  std::string key;
  std::vector<std::byte> bytes;
  uint32_t tick = 0;
  bool operator==(const Output&) const = default;
};

void add_outputs(const Outbox& outbox, uint64_t tick, std::vector<Output>& told) {
  for (const Message& message : outbox)
    if (const std::string key = recorded_key(message); !key.empty()) told.push_back({key, message.bytes, uint32_t(tick)});
}

void sort_by_key(std::vector<Output>& told) {
  std::stable_sort(told.begin(), told.end(), [](const Output& a, const Output& b) { return a.key < b.key; });
}

// Compares the outputs that ticks gave with the recorded ones. Returns the first key with a difference, and the difference; ""
// if there is none. Up to `lost` outputs may be missing in the recording. Keys may come in any order, but the messages of one
// key must have the same order.
std::string difference(std::vector<Output>& given, std::vector<Output>& recorded, uint64_t lost) {
  sort_by_key(given);
  sort_by_key(recorded);
  auto want = given.begin(), has = recorded.begin();
  while (want != given.end() || has != recorded.end()) {
    const bool missing = has == recorded.end() || (want != given.end() && want->key < has->key);
    if (!missing && want != given.end() && *want == *has) {
      ++want, ++has;
    } else if (want != given.end() && lost > 0 && want->key <= (missing ? want : has)->key) {
      ++want, --lost;
    } else if (missing) {
      return want->key + " (missing)";
    } else if (want == given.end() || has->key < want->key) {
      return has->key + " (the tick gives none)";
    } else {
      return has->key + (has->bytes == want->bytes ? " (of another tick)" : " (other bytes)");
    }
  }
  return "";
}

bool is_told(Channel channel) {
  return !is_input(channel) && channel != Channel::health && channel != Channel::tick_end && channel != Channel::other;
}

// Compares those parts of health that the world knows; the others depend on machine and network. Returns "" if they are equal.
std::string difference_in_health(const RecordingReader::Item& item, World& world, double rate) {
  flatbuffers::Verifier verifier(item.bytes.data(), item.bytes.size());
  if (!verifier.VerifyBuffer<schema::Health>(nullptr)) return "health (damaged)";
  const auto* said = flatbuffers::GetRoot<schema::Health>(item.bytes.data());
  const uint64_t now = tick_count(world);
  if (said->tick() != now || item.tick != uint32_t(now) || said->rate() != float(rate))
    return "health (of another tick or rate)";
  const Message known = health(world, 0, {});
  for (const auto* of_world : *flatbuffers::GetRoot<schema::Health>(known.bytes.data())->counts()) {
    const std::string_view name = of_world->name()->string_view();
    if (name != "cars" && name != "hosts" && name != "obstacles") continue;
    const auto same = [&](const schema::Count* one) {
      return one->name() && one->name()->string_view() == name && one->value() == of_world->value();
    };
    if (!said->counts() || std::none_of(said->counts()->begin(), said->counts()->end(), same))
      return "health (another number of " + std::string(name) + ")";
  }
  return "";
}

void differ(Verdict& verdict, uint64_t tick, std::string how) {
  verdict.differs = tick;
  verdict.how = std::move(how);
}

void verify(RecordingReader& file, int threads, const std::atomic<bool>& stop, Verdict& verdict) {
  const RecordingHead& head = file.head();
  const WorldHandle world = make_world(head.rate, head.quantum, head.limits);
  for (const auto& car : head.cars) add_asset(*world, car);
  if (!head.world.empty()) load_world(head.world, *world);
  Inbox inbox;
  Outbox outbox;
  std::vector<Output> given, recorded;
  uint64_t inputs = 0;  // sum of the hashes of the inputs
  shown(*world, outbox);
  add_outputs(outbox, tick_count(*world), given);
  for (RecordingReader::Item item; !stop && file.next(item);) {
    ++verdict.messages;
    const auto bytes = std::as_bytes(item.bytes);
    const uint64_t now = tick_count(*world), next = now + 1;
    if (item.channel != Channel::tick_end && item.channel != Channel::health && verdict.behind++ == 0)
      verdict.first_behind = item.key;
    if (is_input(item.channel)) inputs += hash_of_input(item.key, item.bytes.data(), item.bytes.size());
    if (is_told(item.channel)) {
      recorded.push_back({std::string(item.key), {bytes.begin(), bytes.end()}, item.tick});
    } else if (is_input(item.channel) && item.tick == uint32_t(next)) {
      // Any ticket but 0 will do: it only says that an answer is wanted.
      inbox.push_back({std::string(item.key), {bytes.begin(), bytes.end()}, item.channel == Channel::command ? 1u : 0u});
    } else if (is_input(item.channel)) {
      verdict.before = verdict.identical == 0 && !head.world.empty() && item.tick == uint32_t(now);
      if (!verdict.before)
        return differ(verdict, next, " in " + std::string(item.key) + " (an input of tick " + std::to_string(item.tick) + ")");
    } else if (item.channel == Channel::health) {
      verdict.health = true;
      const std::string key = difference_in_health(item, *world, head.rate);
      if (!key.empty()) return differ(verdict, now, " in " + key);
    } else if (item.channel == Channel::other) {
      if (verdict.others++ == 0) verdict.first_other = item.key;
    } else if (item.channel == Channel::tick_end) {
      TickEnd end;
      if (decode(bytes, end)) throw std::runtime_error("a TickEnd is damaged");
      if (end.lost_inputs > 0 || end.tick != next) {
        verdict.lost = end.tick;
        return;
      }
      if (item.tick != uint32_t(next)) return differ(verdict, next, " in tick (of another tick)");
      tick(*world, inbox, outbox, threads);
      inbox.clear();
      add_outputs(outbox, end.tick, given);
      std::string key = difference(given, recorded, end.lost_outputs);
      if (key.empty() && end.inputs != 0 && end.inputs != inputs) key = "its inputs (others were recorded)";
      verdict.inputs |= inputs != 0 && end.inputs == 0;
      inputs = 0;
      given.clear();
      recorded.clear();
      const bool same = hash(*world) == end.hash;
      if (!same || !key.empty())
        return differ(
            verdict, end.tick,
            (key.empty() ? "" : " in " + key) + (same ? "; the world's hash is the same" : "; the world's hash differs"));
      if (end.lost_outputs > 0 && verdict.outputs_lost == 0) verdict.lost_in = end.tick;
      verdict.outputs_lost += end.lost_outputs;
      ++verdict.identical;
      verdict.behind = 0;
    }
  }
}

std::string not_compared(const Verdict& verdict) {
  std::string out = "; not compared: times";
  if (verdict.health) out += ", health except its counts of cars, hosts and obstacles";
  if (verdict.before) out += ", messages that hosts sent before the first tick";
  if (verdict.inputs) out += ", whether inputs are missing";
  if (verdict.others > 0)
    out +=
        ", " + std::to_string(verdict.others) + " messages of another program, the first on " + printable(verdict.first_other);
  if (verdict.behind > 0)
    out += ", " + std::to_string(verdict.behind) + " messages of a tick without an end, the first on " +
           printable(verdict.first_behind);
  return out;
}

// One sentence about the result. good: nothing is wrong in the part that the file has.
std::string sentence_of(const RecordingReader& file, const Verdict& verdict, const std::string& time, bool& good) {
  const std::string ticks = std::to_string(verdict.identical), &recorder = file.head().program;
  good = false;
  if (verdict.lost)
    return ticks + " ticks identical; tick " + std::to_string(verdict.lost) +
           " lost inputs when it was recorded: it and the later ticks cannot be verified";
  if (verdict.differs)
    return "tick " + std::to_string(verdict.differs) + " differs" + verdict.how + ", after " + ticks + " identical ones; " +
           recorder + " recorded it, and this is " +
           (recorder == program_name ? "the same program: the file was changed, or this machine computes differently"
                                     : std::string(program_name) + ": verify it with the program that recorded it");
  const RecordingEnd end = file.end();
  std::string trouble = file.cut() ? "" : trouble_at_end(end, verdict.identical, verdict.messages);
  if (verdict.identical == 0)
    return "the file has no whole tick, so there is nothing to verify" +
           std::string(file.cut() ? "; the file was cut off" : "");
  if (trouble.empty() && verdict.outputs_lost > 0)
    trouble = "the recording lost " + std::to_string(verdict.outputs_lost) + " messages of these ticks, the first in tick " +
              std::to_string(verdict.lost_in);
  if (trouble.empty() && verdict.behind > 0 && !file.cut())
    trouble = "after them the file has " + std::to_string(verdict.behind) +
              " messages of a tick without an end, the first on " + printable(verdict.first_behind);
  good = trouble.empty();
  if (!good || file.cut())
    return "the first " + ticks + (end.ticks > verdict.identical ? " of " + std::to_string(end.ticks) : "") +
           " ticks are identical" + time + "; " +
           (good ? "the file was cut off, or is still being written: it has no later ticks" + not_compared(verdict) : trouble);
  std::string note;
  if (end.recovered)
    note = "; recovered: the original recording had more";
  else if (!end.there)
    note = "; an older program recorded it, so nothing shows whether its end is missing";
  return "every tick identical: " + ticks + " ticks" + time + note + not_compared(verdict);
}

bool verify_file(const std::string& path, int threads, const std::atomic<bool>& stop) {
  RecordingReader file(path);
  const auto start = std::chrono::steady_clock::now();
  Verdict verdict;
  try {
    verify(file, threads, stop, verdict);
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(error.what() + ("; the first " + std::to_string(verdict.identical) + " ticks are identical"));
  }
  if (stop) return false;
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  char time[100];
  std::snprintf(time, sizeof time, " (%.1f s) in %.1f s, %d thread%s",
                static_cast<double>(verdict.identical) / file.head().rate, seconds, threads, threads == 1 ? "" : "s");
  bool good = false;
  std::printf("%s: %s\n", path.c_str(), sentence_of(file, verdict, time, good).c_str());
  std::fflush(stdout);
  return good;
}

}  // namespace

int replay(const ReplayOptions& options, const std::atomic<bool>& stop) {
  const int threads =
      options.threads > 0 ? options.threads : std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  bool good = true;
  if (options.verify)
    for (const std::string& path : options.files) good &= verify_file(path, threads, stop);
  if (options.publish) serve_playback(options, stop);
  return good ? 0 : 1;
}

}  // namespace crumple

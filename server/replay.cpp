#include "replay.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <stdexcept>
#include <thread>

#include "film.h"
#include "recording.h"
#include "schema/message_generated.h"
#include "snapshot.h"

namespace crumple {
namespace {

struct Verdict {
  uint64_t identical = 0;
  uint64_t differs = 0;  // first differing tick; 0: none
  uint64_t lost = 0;     // first tick before whose end something is not in the file; 0: none
};

const schema::TickEnd& tick_end_of(const RecordingReader::Item& item) {
  flatbuffers::Verifier verifier(item.bytes.data(), item.bytes.size());
  if (!verifier.VerifyBuffer<schema::TickEnd>(nullptr)) throw std::runtime_error("a TickEnd is damaged");
  return *flatbuffers::GetRoot<schema::TickEnd>(item.bytes.data());
}

Verdict verify(RecordingReader& file, int threads, const std::atomic<bool>& stop) {
  const RecordingHead& head = file.head();
  const WorldHandle world = make_world(head.rate, head.quantum, head.limits);
  for (const auto& car : head.cars) add_asset(*world, car);
  if (!head.world.empty()) load_world(head.world, *world);
  Verdict verdict;
  Inbox inbox;
  Outbox outbox;
  for (RecordingReader::Item item; !stop && file.next(item);) {
    if (is_input(item.channel)) {
      const auto* bytes = reinterpret_cast<const std::byte*>(item.bytes.data());
      // Any ticket will do: it only asks for an answer.
      inbox.push_back({std::string(item.key), {bytes, bytes + item.bytes.size()}, item.channel == Channel::command ? 1u : 0u});
    } else if (item.channel == Channel::tick_end) {
      const schema::TickEnd& end = tick_end_of(item);
      if (end.lost_inputs() > 0 || end.tick() != tick_count(*world) + 1) {
        verdict.lost = end.tick();
        break;
      }
      tick(*world, inbox, outbox, threads);
      inbox.clear();
      if (hash(*world) != end.hash()) {
        verdict.differs = end.tick();
        break;
      }
      ++verdict.identical;
    }
  }
  return verdict;
}

bool verify_file(const std::string& path, int threads, const std::atomic<bool>& stop) {
  RecordingReader file(path);
  const auto start = std::chrono::steady_clock::now();
  const Verdict verdict = verify(file, threads, stop);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  const auto number = [](uint64_t value) { return static_cast<unsigned long long>(value); };
  if (verdict.lost) {
    std::printf("%s: %llu ticks identical; tick %llu lost inputs when it was recorded: what follows cannot be verified\n",
                path.c_str(), number(verdict.identical), number(verdict.lost));
  } else if (verdict.differs && file.head().program == program_name) {
    std::printf(
        "%s: tick %llu differs, after %llu identical ones; recorded by %s, as this is: the file was changed, or this "
        "machine computes otherwise\n",
        path.c_str(), number(verdict.differs), number(verdict.identical), program_name);
  } else if (verdict.differs) {
    std::printf("%s: tick %llu differs, after %llu identical ones; recorded by %s, this is %s: verify it with that one\n",
                path.c_str(), number(verdict.differs), number(verdict.identical), file.head().program.c_str(), program_name);
  } else if (verdict.identical == 0) {
    std::printf("%s: holds no whole tick, there is nothing to verify%s\n", path.c_str(),
                file.cut() ? "; the file was cut off" : "");
  } else {
    std::printf("%s: every tick identical: %llu ticks (%.1f s) in %.1f s, %d thread%s%s\n", path.c_str(),
                number(verdict.identical), static_cast<double>(verdict.identical) / file.head().rate, seconds, threads,
                threads == 1 ? "" : "s", file.cut() ? "; the file was cut off, verified up to its last whole tick" : "");
  }
  std::fflush(stdout);
  return !verdict.lost && !verdict.differs && verdict.identical > 0 && !stop;
}

}  // namespace

int replay(const ReplayOptions& options, const std::atomic<bool>& stop) {
  const int threads =
      options.threads > 0 ? options.threads : std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  bool good = true;
  if (options.verify)
    for (const std::string& path : options.files) good &= verify_file(path, threads, stop);
  if (options.publish) show_films(options, stop);
  return good ? 0 : 1;
}

}  // namespace crumple

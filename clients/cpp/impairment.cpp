// Makes a bad line, on which a game can be tested (crumple_impair): messages are late, lost or repeated.
#include <algorithm>
#include <cstring>
#include <utility>

#include "cpp/session.h"

namespace crumple::client {

bool impair(Impaired& impaired, bool outgoing, std::string_view key, std::span<const uint8_t> bytes) {
  const CrumpleImpairment& line = impaired.line;
  if (line.delay == 0 && line.jitter == 0 && line.loss == 0 && line.repeat == 0) return false;
  const auto draw = [&] { return double(impaired.draw()) / 4294967296.0; };
  for (int copies = draw() < double(line.repeat) ? 2 : 1; copies > 0; --copies) {
    const bool lost = draw() < double(line.loss);
    const double late = double(line.delay) + double(line.jitter) * (2 * draw() - 1);
    if (lost) continue;
    Impaired::Message message{outgoing, std::string(key), std::vector<uint64_t>((bytes.size() + 7) / 8), bytes.size()};
    if (!bytes.empty()) std::memcpy(message.words.data(), bytes.data(), bytes.size());
    const auto wait = std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(std::max(0.0, late)));
    impaired.under_way.emplace(Clock::now() + wait, std::move(message));
  }
  return true;
}

int take_impaired(Crumple& session) {
  auto& under_way = session.impaired.under_way;
  int came = 0;
  while (!under_way.empty() && under_way.begin()->first <= Clock::now()) {
    const Impaired::Message message = std::move(under_way.extract(under_way.begin()).mapped());
    const auto* bytes = reinterpret_cast<const uint8_t*>(message.words.data());
    if (message.outgoing) {
      net_put(session.net, message.key.c_str(), bytes, message.size, NET_REAL_TIME);
    } else {
      take(session, NetEvent{NET_SAMPLE, 0, message.key.c_str(), bytes, message.size, 0});
      ++came;
    }
  }
  return came;
}

uint64_t until_next(const Impaired& impaired, uint64_t timeout_us) {
  if (impaired.under_way.empty()) return timeout_us;
  const auto left = std::chrono::duration_cast<std::chrono::microseconds>(impaired.under_way.begin()->first - Clock::now());
  return std::min(timeout_us, uint64_t(std::max<int64_t>(0, left.count())));
}

}  // namespace crumple::client

using namespace crumple::client;

int crumple_impair(Crumple* handle, const CrumpleImpairment* line) {
  return with(handle, {{"line", line}}, [&](Crumple* session) -> int {
    if (!session->net) return fail(CRUMPLE_CLOSED, no_network);
    const auto within = [](float value, float most) { return value >= 0 && value <= most; };
    if (!within(line->delay, 60) || !within(line->jitter, 60) || !within(line->loss, 1) || !within(line->repeat, 1))
      return fail(CRUMPLE_BAD_ARGUMENT,
                  "delay or jitter of an impairment is not from 0 to 60 s, or loss or repeat is not from 0 to 1");
    session->impaired.line = *line;
    session->impaired.draw.seed(line->seed);
    return CRUMPLE_OK;
  });
}

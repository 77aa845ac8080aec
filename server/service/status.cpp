#include "service/status.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>

#include "tick/health.h"

namespace crumple {

Message health_report(World& world, uint64_t late, Net* net, const Admission& admission, const Series* recording) {
  NetStats stats;
  net_stats(net, &stats);
  return health(world, late,
                {{"sent", stats.put},
                 {"sent_bytes", stats.put_bytes},
                 {"sent_dropped", stats.put_dropped},
                 {"received", stats.received},
                 {"received_bytes", stats.received_bytes},
                 {"received_dropped", stats.received_dropped},
                 {"replaced", stats.replaced},
                 {"keys_published", stats.keys, NET_KEYS},
                 {"oversized", stats.oversized},
                 {"keys_refused", admission.keys_refused()},
                 {"frames_refused", stats.frames_refused},
                 {"queries_waiting", admission.waiting(), line_count * query_limit},
                 {"queries_refused", stats.queries_refused + admission.queries_refused()},
                 {"recording_lost", recording ? recording->lost() : 0}});
}

void print_line(const World& world, uint64_t late, const Work& last, Net* net) {
  if (!isatty(STDOUT_FILENO)) return;
  NetStats stats;
  net_stats(net, &stats);
  std::printf("\rtick %llu  cars %zu  late %llu  shed %.0f %%  refused %llu  sent %.1f MB \x1b[K",
              static_cast<unsigned long long>(tick_count(world)), cars(world).size(), static_cast<unsigned long long>(late),
              100.0 * static_cast<double>(last.shed) / std::max(1.0, static_cast<double>(last.done + last.shed)),
              static_cast<unsigned long long>(refusal_count(world)), 1e-6 * static_cast<double>(stats.put_bytes));
  std::fflush(stdout);
}

void tell_refusals(const World& world, uint64_t& told) {
  const uint64_t refused = refusal_count(world);
  if (refused == told) return;
  std::fprintf(stderr, "crumple serve: refused %llu message%s; the last: %s\n", static_cast<unsigned long long>(refused - told),
               refused - told == 1 ? "" : "s", last_refusal(world).c_str());
  told = refused;
}

}  // namespace crumple

// What an operator sees of a server: health, which viewers and Prometheus read as well, one line on a terminal, and a sentence
// where something is refused.
#pragma once

#include <cstdint>

#include "io/net.h"
#include "recording/series.h"
#include "service/admission.h"
#include "tick/world.h"

namespace crumple {

// recording: null where nothing is recorded. late: ticks.
Message health_report(World&, uint64_t late, Net*, const Admission&, const Series* recording);
// Overwrites the terminal's line; nothing if stdout is none.
void print_line(const World&, uint64_t late, const Work& last_tick, Net*);
// What was refused since the last call goes to stderr as one sentence; health counts the rest.
void tell_refusals(const World&, uint64_t& told);

}  // namespace crumple

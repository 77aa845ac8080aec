// What an operator sees of a server: health (which viewers and Prometheus read too), one line on the terminal, and a sentence
// when something is refused.
#pragma once

#include <cstdint>

#include "io/net.h"
#include "recording/series.h"
#include "service/admission.h"
#include "tick/world.h"

namespace crumple {

// recording: null if nothing is recorded. late: late ticks.
Message health_report(World&, uint64_t late, Net*, const Admission&, const Series* recording);
// Overwrites the line on the terminal; does nothing if stdout is not a terminal.
void print_line(const World&, uint64_t late, const Work& last_tick, Net*);
// Prints the last refusal since the previous call to stderr, and how many there were. told: the refusals printed before.
void tell_refusals(const World&, uint64_t& told);

}  // namespace crumple

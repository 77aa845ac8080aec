#include "service/metrics.h"

#include <array>
#include <cstdio>

#include "recording/recording.h"
#include "schema/message_generated.h"

namespace crumple {
namespace {

struct Metric {
  const char* count;  // its name in health
  const char* name;
  const char* help;
  double unit = 1;  // one unit of health's count, in the metric's unit
};
constexpr std::array metrics = {
    Metric{"cars", "cars", "Cars that live in the scene."},
    Metric{"hosts", "hosts", "Hosts that have cars or obstacles."},
    Metric{"obstacles", "obstacles", "Obstacles of all hosts."},
    Metric{"messages", "messages_total", "Messages that ticks took in."},
    Metric{"contacts_per_node_overflows", "contact_overflows_total", "Ticks of a car in which a node met too many obstacles."},
    Metric{"recoveries", "recoveries_total", "Ticks of a car that ended non-finite and were undone."},
    Metric{"work_most", "work_most", "Tet visits of the last second's busiest tick."},
    Metric{"work_shed", "work_shed_total", "Tet visits that the budget did not allow."},
    Metric{"islands", "islands", "Islands of several cars that may touch, most in one tick of the last second."},
    Metric{"largest_island", "largest_island_cars", "Cars of the last second's largest island."},
    Metric{"residual_mean_nm", "residual_mean_meters", "What the last sweeps still moved, over the last second's ticks.", 1e-9},
    Metric{"residual_worst_nm", "residual_worst_meters", "The same of the worst tick of a car.", 1e-9},
    Metric{"sent", "sent_messages_total", "Samples published."},
    Metric{"sent_bytes", "sent_bytes_total", "Bytes of them."},
    Metric{"sent_dropped", "sent_dropped_total", "Samples that the session's full queue did not take."},
    Metric{"received", "received_messages_total", "Samples received."},
    Metric{"received_bytes", "received_bytes_total", "Bytes of them."},
    Metric{"received_dropped", "received_dropped_total", "Samples that found too much waiting."},
    Metric{"replaced", "replaced_total", "Samples that a newer one of their host replaced before a tick took them."},
    Metric{"keys_published", "keys_published", "Keys that samples are published on: four a car that moved, one a host."},
    Metric{"oversized", "oversized_total", "Samples and queries that were too long to be looked at."},
    Metric{"keys_refused", "keys_refused_total",
           "Samples and queries under keys that nobody has, or of too many unknown hosts."},
    Metric{"frames_refused", "frames_refused_total",
           "Network messages under keys that are none, or of sessions that declare or leave unfinished too much."},
    Metric{"queries_waiting", "queries_waiting", "Queries that no tick has let in yet."},
    Metric{"queries_refused", "queries_refused_total", "Queries that found too many waiting."},
    Metric{"recording_lost", "recording_lost_total", "Messages that are missing in the recording."},
};

struct Page {
  std::string text;

  void head(const std::string& name, const char* help) {
    const char* type = name.ends_with("_total") ? "counter" : "gauge";
    text += "# HELP crumple_" + name + " " + help + "\n# TYPE crumple_" + name + " " + type + "\n";
  }
  void value(const std::string& name, double number) {
    char digits[32];
    std::snprintf(digits, sizeof digits, " %.17g\n", number);
    text += "crumple_" + name + digits;
  }
  void whole(const std::string& name, const char* help, double number) {
    head(name, help);
    value(name, number);
  }
};

std::string labelled(const std::string& name, const char* label, const std::string& value) {
  return name + "{" + label + "=\"" + value + "\"}";
}

void put_counts(const schema::Health& health, Page& page) {
  for (const Metric& metric : metrics) {
    for (const auto* count : *health.counts()) {
      if (count->name()->string_view() != metric.count) continue;
      page.whole(metric.name, metric.help, metric.unit * static_cast<double>(count->value()));
      if (count->limit() > 0)
        page.whole(std::string(metric.name) + "_limit", "What the one above may be.", static_cast<double>(count->limit()));
    }
  }
}

void put_rooms(const schema::Health& health, Page& page) {
  page.head("room_mean_seconds", "Time of a tick by room, mean over the last second; room tick is the whole.");
  for (const auto* room : *health.rooms())
    page.value(labelled("room_mean_seconds", "room", room->name()->str()), 1e-3 * double{room->milliseconds()});
  page.head("room_worst_seconds", "The same of the longest tick.");
  for (const auto* room : *health.rooms())
    page.value(labelled("room_worst_seconds", "room", room->name()->str()), 1e-3 * double{room->worst()});
}

}  // namespace

std::string metrics_page(const Message& message, const std::string& scene) {
  const auto& health = *flatbuffers::GetRoot<schema::Health>(message.bytes.data());
  Page page;
  page.head("info", "Always 1.");
  page.value("info{scene=\"" + scene + "\",program=\"" + program_name + "\"}", 1);
  page.whole("ticks_total", "Ticks done.", static_cast<double>(health.tick()));
  page.whole("late_ticks_total", "Ticks that could not start in time.", static_cast<double>(health.late()));
  page.whole("ticks_per_second", "Ticks that are wanted a second.", double{health.rate()});
  put_rooms(health, page);
  put_counts(health, page);
  page.head("refusals_total", "Messages refused, by reason.");
  for (const auto* refusal : *health.refusals())
    page.value(labelled("refusals_total", "reason", refusal->name()->str()), static_cast<double>(refusal->value()));
  return page.text;
}

}  // namespace crumple

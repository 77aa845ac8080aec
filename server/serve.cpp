// The only place that knows both the clock and the world. The tick itself never waits: the network publishes and the recorder
// writes on threads of their own, and what their queues cannot take is counted.
#include "serve.h"

#include <unistd.h>

#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <ctime>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <thread>

#include "answer.h"
#include "recording.h"
#include "schema/message_generated.h"

namespace crumple {
namespace {

using Clock = std::chrono::steady_clock;

// Messages that one tick takes; further ones wait in the transport's own bounded queues.
constexpr size_t inbox_limit = 20'000;
constexpr uint32_t command_depth = 1'000;  // queries waiting
// A tick that starts later than this share of its period counts as late, and the schedule moves on with it: a server that
// cannot keep up slows down, and never runs a burst of ticks to catch up.
constexpr double late_share = 0.25;

// What the budget is in tet visits, which is all that the world knows. Learned from ticks that say something about it: those
// that took long, and those that were cut short. Until there is one there is no limit.
struct Pace {
  double limit = 0;   // s a tick; 0: none
  double visit = 0;   // s, with all threads and what else a tick does; 0: not known yet
  uint64_t said = 0;  // the last budget

  void learn(double seconds, const Work& work) {
    if (work.done == 0 || (seconds < 0.5 * limit && work.shed == 0)) return;
    const double now = seconds / double(work.done);
    visit = visit > 0 ? 0.8 * visit + 0.2 * now : now;
  }
  // A new budget, if it is another by more than 5 %.
  std::optional<uint64_t> next() {
    if (limit == 0 || visit == 0) return std::nullopt;
    const double budget = std::max(1.0, limit / visit);
    if (std::abs(budget - double(said)) <= 0.05 * double(said)) return std::nullopt;
    return said = uint64_t(budget);
  }
};

struct Server {
  const ServeOptions& options;
  std::string root;
  std::vector<std::shared_ptr<const Car>> cars;
  WorldHandle world;
  Net* net = nullptr;
  std::optional<Recording> recording;
  std::string recording_told;                    // the last sentence about its trouble
  std::set<std::string, std::less<>> announced;  // cars
  Inbox inbox;
  Outbox outbox;
  Pace pace;
  uint64_t late = 0;
  int threads = 1;

  explicit Server(const ServeOptions& o) : options(o) {}
  ~Server() {
    if (net) net_close(net);
  }
};

uint64_t wall_ns() {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::system_clock::now().time_since_epoch()).count());
}

std::string utc() {
  const std::time_t now = std::time(nullptr);
  char text[32];
  std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", std::gmtime(&now));
  return text;
}

void need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
}

void start_world(Server& server) {
  const ServeOptions& options = server.options;
  const auto quantum = static_cast<float>(1e-3 * options.quantum_mm);
  for (const std::string& file : options.cars) server.cars.push_back(load_car(file));
  server.world = make_world(options.rate, quantum);
  for (const auto& car : server.cars) add_asset(*server.world, car);
  set_clock(*server.world, [start = Clock::now()] { return std::chrono::duration<double>(Clock::now() - start).count(); });
  if (options.record.empty()) return;
  RecordingHead head;
  head.scene = options.scene;
  head.started = utc();
  head.rate = options.rate;
  head.quantum = quantum;
  head.cars = server.cars;
  server.recording.emplace(options.record, head);
}

void open_network(Server& server) {
  need(net_open("peer", server.options.listen.c_str(), nullptr, nullptr, 0, &server.net));
  for (const char* what : {"host/*/poses", "host/*/obstacles"})
    need(net_subscribe(server.net, (server.root + what).c_str(), 0));
  for (const char* what : {"car/*", "car/*/key"}) need(net_queryable(server.net, (server.root + what).c_str(), command_depth));
  need(net_queryable(server.net, "crumple/1/asset/*", command_depth));
  need(net_announce(server.net, (server.root + "server").c_str()));
}

void take(Server& server, const NetEvent& event) {
  const std::string_view key = event.key;
  if (event.kind == NET_QUERY && key.starts_with("crumple/1/asset/")) return answer_asset(server.net, event, server.cars);
  if ((event.kind != NET_SAMPLE && event.kind != NET_QUERY) || !key.starts_with(server.root)) return;
  Message message;
  message.key = key.substr(server.root.size());
  const auto* bytes = reinterpret_cast<const std::byte*>(event.data);
  message.bytes.assign(bytes, bytes + event.size);
  message.ticket = event.kind == NET_QUERY ? event.ticket : 0;
  server.inbox.push_back(std::move(message));
}

// Takes in what arrives until the tick is due.
void collect(Server& server, Clock::time_point due, const std::atomic<bool>& stop) {
  NetEvent events[256];
  while (!stop) {
    const auto left = std::chrono::duration_cast<std::chrono::microseconds>(due - Clock::now());
    if (server.inbox.size() >= inbox_limit) {
      if (left.count() > 0) std::this_thread::sleep_for(left);
      return;
    }
    const int got = net_poll(server.net, events, 256, left.count() > 0 ? static_cast<uint64_t>(left.count()) : 0);
    need(got);
    for (int i = 0; i < got; ++i) take(server, events[i]);
    if (Clock::now() >= due && got < 256) return;
  }
}

// Viewers learn from its token that a car lives. A car shows itself by its first keyframe, and goes by a Despawn that was
// answered with ok.
void announce_cars(Server& server) {
  for (const Message& message : server.outbox) {
    const Channel channel = channel_of(message.key);
    if (message.ticket == 0 && channel == Channel::keyframe) {
      const std::string car = message.key.substr(0, message.key.size() - 4);
      if (server.announced.insert(car).second) net_announce(server.net, (server.root + car).c_str());
    } else if (message.ticket != 0 && channel == Channel::command) {
      if (!flatbuffers::GetRoot<schema::Answer>(message.bytes.data())->ok()) continue;
      for (const Message& asked : server.inbox) {
        if (asked.ticket != message.ticket) continue;
        const auto order = flatbuffers::GetRoot<schema::Command>(asked.bytes.data())->order_type();
        if (order == schema::Order::Despawn && server.announced.erase(message.key) > 0)
          net_retract(server.net, (server.root + message.key).c_str());
      }
    }
  }
}

void publish(Server& server, const Message& message) {
  if (message.ticket != 0) {
    net_reply(server.net, message.ticket, message.bytes.data(), message.bytes.size(), message.failed);
    return;
  }
  const Channel channel = channel_of(message.key);
  const NetPriority priority = channel == Channel::reactions ? NET_REAL_TIME : channel == Channel::health ? NET_LOW : NET_DATA;
  net_put(server.net, (server.root + message.key).c_str(), message.bytes.data(), message.bytes.size(), priority);
}

void run_tick(Server& server) {
  const uint64_t number = tick_count(*server.world) + 1;
  if (const auto budget = server.pace.next()) server.inbox.push_back(budget_message(*budget));
  if (server.recording)
    for (const Message& message : server.inbox) server.recording->input(number, message, wall_ns());
  const auto begun = Clock::now();
  tick(*server.world, server.inbox, server.outbox, server.threads);
  server.pace.learn(std::chrono::duration<double>(Clock::now() - begun).count(), work(*server.world));
  announce_cars(server);
  for (const Message& message : server.outbox) publish(server, message);
  if (server.recording) {
    const uint64_t time = wall_ns();
    for (const Message& message : server.outbox) server.recording->output(number, message, time);
    server.recording->end_tick(number, hash(*server.world), time);
  }
  server.inbox.clear();
}

void publish_health(Server& server) {
  NetStats stats;
  net_stats(server.net, &stats);
  const Message report = health(*server.world, server.late,
                                {{"sent", stats.put},
                                 {"sent_bytes", stats.put_bytes},
                                 {"sent_dropped", stats.put_dropped},
                                 {"received", stats.received},
                                 {"received_bytes", stats.received_bytes},
                                 {"received_dropped", stats.received_dropped + stats.queries_refused},
                                 {"replaced", stats.replaced},
                                 {"recording_lost", server.recording ? server.recording->lost() : 0}});
  publish(server, report);
  if (server.recording) server.recording->output(tick_count(*server.world), report, wall_ns());
  if (isatty(STDOUT_FILENO)) {
    const Work last = work(*server.world);
    std::printf("\rtick %llu  cars %zu  late %llu  shed %.0f %%  refused %llu  sent %.1f MB \x1b[K",
                static_cast<unsigned long long>(tick_count(*server.world)), server.announced.size(),
                static_cast<unsigned long long>(server.late),
                100.0 * static_cast<double>(last.shed) / std::max(1.0, static_cast<double>(last.done + last.shed)),
                static_cast<unsigned long long>(refusal_count(*server.world)), 1e-6 * static_cast<double>(stats.put_bytes));
    std::fflush(stdout);
  }
}

// What was refused for the first time since the last look is said once: the rest is in health.
void tell_refusals(Server& server, uint64_t& told) {
  const uint64_t refused = refusal_count(*server.world);
  if (refused == told) return;
  std::fprintf(stderr, "crumple serve: refused %llu message%s; the last: %s\n", static_cast<unsigned long long>(refused - told),
               refused - told == 1 ? "" : "s", last_refusal(*server.world).c_str());
  told = refused;
}

// What is wrong with the recording is said when it begins; how much it costs is in health.
void tell_recording(Server& server) {
  std::string trouble = server.recording->trouble();
  if (trouble.empty() && server.recording->lost() > 0)
    trouble = server.options.record +
              ": loses messages, because the disk is slower than the recording; the server goes on, "
              "replay --verify names the tick; record to a faster disk";
  if (trouble.empty() || trouble == server.recording_told) return;
  std::fprintf(stderr, "crumple serve: %s\n", trouble.c_str());
  server.recording_told = trouble;
}

void run(Server& server, const std::atomic<bool>& stop) {
  const auto period = std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(1 / server.options.rate));
  const auto slack = std::chrono::duration_cast<Clock::duration>(late_share * period);
  const auto begun = Clock::now();
  auto due = begun + period, next_health = begun + std::chrono::seconds(1);
  uint64_t told = 0;
  while (!stop &&
         (server.options.seconds <= 0 || std::chrono::duration<double>(due - begun).count() <= server.options.seconds)) {
    collect(server, due, stop);
    if (stop) break;
    const auto now = Clock::now();
    if (now > due + slack) {
      ++server.late;
      due = now;
    }
    due += period;
    run_tick(server);
    if (now < next_health) continue;
    next_health += std::chrono::seconds(1);
    publish_health(server);
    tell_refusals(server, told);
    if (server.recording) tell_recording(server);
  }
}

int finish(Server& server) {
  std::printf("%s%llu ticks, %llu late, %llu messages refused\n", isatty(STDOUT_FILENO) ? "\n" : "",
              static_cast<unsigned long long>(tick_count(*server.world)), static_cast<unsigned long long>(server.late),
              static_cast<unsigned long long>(refusal_count(*server.world)));
  if (!server.recording) return 0;
  const uint64_t lost = server.recording->lost();
  const std::string trouble = server.recording->close();
  if (!trouble.empty() && trouble != server.recording_told) std::fprintf(stderr, "crumple serve: %s\n", trouble.c_str());
  if (lost > 0)
    std::fprintf(stderr, "crumple serve: the recording lost %llu messages\n", static_cast<unsigned long long>(lost));
  if (lost > 0 || !trouble.empty()) return 1;
  std::printf("recorded %s\n", server.options.record.c_str());
  return 0;
}

}  // namespace

int serve(const ServeOptions& options, const std::atomic<bool>& stop) {
  // A recording may meet a limit on file sizes, or be a pipe whose reader goes: like a full disk, that does not end the server.
  std::signal(SIGXFSZ, SIG_IGN);
  std::signal(SIGPIPE, SIG_IGN);
  Server server(options);
  server.root = "crumple/1/" + options.scene + "/";
  server.threads = options.threads > 0 ? options.threads : std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  server.pace.limit = 1e-3 * options.budget_ms;
  start_world(server);
  open_network(server);
  std::printf("scene %s at %s, %g ticks a second, %d thread%s\n", options.scene.c_str(), net_endpoint(server.net), options.rate,
              server.threads, server.threads == 1 ? "" : "s");
  for (const auto& car : server.cars)
    std::printf("car %s  %s  %zu nodes  %zu vertices  %zu coarser levels: %s\n", car->hash.c_str(), car->name.c_str(),
                car->model.node.size(), car->model.vertex.size(), coarser_levels(*server.world, car->hash),
                car->attribution.c_str());
  std::fflush(stdout);
  run(server, stop);
  return finish(server);
}

}  // namespace crumple

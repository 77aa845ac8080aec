// Starts the ticks by the clock. The tick never waits: the network publishes and the recorder writes on
// threads of their own. Messages for which their queues have no room are dropped and counted.
#include "service/serve.h"

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <iterator>
#include <span>
#include <stdexcept>
#include <thread>
#include <utility>

#include "bake/load_car.h"
#include "io/metrics.h"
#include "recording/recording.h"
#include "recording/series.h"
#include "service/admission.h"
#include "service/budget_estimator.h"
#include "service/metrics.h"
#include "service/owner.h"
#include "service/standby.h"
#include "service/status.h"
#include "tick/budget.h"
#include "tick/hash.h"
#include "tick/health.h"
#include "tick/levels.h"

namespace crumple {
namespace {

using Clock = std::chrono::steady_clock;

constexpr uint32_t events_limit = 20'000;  // most events per tick; the rest waits in the transport's bounded queues
constexpr uint32_t connect_ms = 10'000;    // a router must answer within this time
// A tick that starts later than this share of its period counts as late, and the schedule shifts by the delay: a server that
// cannot keep up slows down and never runs a burst of ticks to catch up.
constexpr double late_share = 0.25;

struct Server {
  const ServeOptions& options;
  std::string root = root_of(options.scene);  // "crumple/1/{scene}/"
  int threads = options.threads > 0 ? options.threads : std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  std::vector<std::shared_ptr<const Car>> cars;
  WorldHandle world;
  Net* net = nullptr;
  Metrics* metrics = nullptr;
  Admission admission{root, cars};
  BudgetEstimator budget{1e-3 * options.budget_ms};
  std::unique_ptr<Series> recording;
  Owner owner{1, random_id()};
  bool replaced = false;  // by a server with a later epoch
  Inbox inbox;
  Outbox outbox;
  Work last_work;
  uint64_t late = 0, overtaken = 0;
  std::vector<NetEvent> events = std::vector<NetEvent>(events_limit);

  explicit Server(const ServeOptions& o) : options(o) {}
  ~Server() {
    if (net) net_close(net);
    metrics_close(metrics);
  }
};

uint64_t wall_ns() {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::system_clock::now().time_since_epoch()).count());
}

void need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
}

// ---- before the first tick ----

void make_scene(Server& server) {
  const ServeOptions& options = server.options;
  const auto quantum = static_cast<float>(1e-3 * options.quantum_mm);
  for (const std::string& file : options.cars) server.cars.push_back(load_car(file));
  server.world = make_world(options.rate, quantum);
  for (const auto& car : server.cars) add_asset(*server.world, car);
  set_clock(*server.world, [start = Clock::now()] { return std::chrono::duration<double>(Clock::now() - start).count(); });
}

void warm_up(Server& server) {
  warm_up(*server.world, server.threads);
  const auto begun = Clock::now();
  const uint64_t visits = warm_up(*server.world, server.threads);
  server.budget.warm_up(std::chrono::duration<double>(Clock::now() - begun).count(), visits);
}

// Opens the file, even for a standby: a bad path should fail at startup, and no disk may delay a takeover.
void open_recording(Server& server) {
  const ServeOptions& options = server.options;
  if (options.record.empty()) return;
  SeriesOptions series{options.record, options.record_minutes, {}};
  if (options.record_most > 0) series.most = static_cast<uint64_t>(1e9 * options.record_most);
  series.head.scene = options.scene;
  series.head.rate = options.rate;
  series.head.quantum = static_cast<float>(1e-3 * options.quantum_mm);
  series.head.cars = server.cars;
  series.tell = [](const std::string& sentence) { std::fprintf(stderr, "crumple serve: %s\n", sentence.c_str()); };
  server.recording = std::make_unique<Series>(std::move(series), *server.world, server.admission.latest());
}

// Whether another machine can reach one of the endpoints.
bool is_public(std::string_view endpoints) {
  while (!endpoints.empty()) {
    const std::string_view one = endpoints.substr(0, endpoints.find(','));
    const std::string_view address = one.substr(std::min(one.size(), one.find('/') + 1));
    const bool here = one.starts_with("unixsock") || address.starts_with("127.") || address.starts_with("localhost:") ||
                      address.starts_with("[::1]");
    if (!here) return true;
    endpoints.remove_prefix(std::min(endpoints.size(), one.size() + 1));
  }
  return false;
}

// At routers a server is a client: routers route between clients, but between peers only if these know each other.
void open_network(Server& server) {
  const ServeOptions& options = server.options;
  const char* network = options.network.empty() ? nullptr : options.network.c_str();
  if (!options.connect.empty()) {
    need(net_open("client", nullptr, options.connect.c_str(), network, connect_ms, &server.net));
  } else {
    if (!network && is_public(options.listen))
      std::fprintf(stderr,
                   "crumple serve: every program that reaches %s may command this scene; --network FILE can restrict this\n",
                   options.listen.c_str());
    need(net_open("peer", options.listen.c_str(), nullptr, network, 0, &server.net));
  }
  if (!options.metrics.empty()) need(metrics_open(options.metrics.c_str(), &server.metrics));
}

// A server that listens by itself is the only one in its scene: it claims nothing and watches no tokens.
bool become_owner(Server& server, const std::atomic<bool>& stop) {
  const ServeOptions& options = server.options;
  return options.connect.empty() || claim_scene(server.net, options.scene, server.owner, stop);
}

// Waits for the end of the scene's owner and goes on with its world. If the recording fails, the server goes on without it: it
// is the only one that holds the world. Returns false if `stop` came first.
bool take_over(Server& server, const std::atomic<bool>& stop) {
  const auto epoch = stand_by(server.net, {server.root, server.owner.id, server.threads}, *server.world, stop);
  if (!epoch) return false;
  server.owner.epoch = *epoch;
  renew(*server.world);
  if (!server.budget.is_limited()) server.inbox.push_back(budget_message(0));  // removes the limit of the previous owner
  try {
    if (server.recording) server.recording->begin(Clock::now());
  } catch (const std::exception& error) {
    server.recording.reset();
    std::fprintf(stderr, "crumple serve: %s; the server goes on without a recording\n", error.what());
  }
  return true;
}

void print_start(const Server& server) {
  const ServeOptions& options = server.options;
  std::printf("scene %s at %s, %g ticks a second, %d thread%s\n", options.scene.c_str(),
              !options.connect.empty() ? options.connect.c_str()
              : server.net             ? net_endpoint(server.net)
                                       : options.listen.c_str(),
              options.rate, server.threads, server.threads == 1 ? "" : "s");
  for (const auto& car : server.cars)
    std::printf("car %s  %s  %zu nodes  %zu vertices  %zu coarser levels: %s\n", car->hash.c_str(), car->name.c_str(),
                car->model.node.size(), car->model.vertex.size(), coarser_levels(*server.world, car->hash),
                car->attribution.c_str());
  if (server.metrics) std::printf("metrics at http://%s/metrics\n", metrics_address(server.metrics));
  if (options.check) std::printf("the configuration is good\n");
  if (options.standby && !options.check) std::printf("stands by for the server of scene %s\n", options.scene.c_str());
  std::fflush(stdout);
}

void open_scene(Server& server) {
  server.admission.open(server.net, *server.world);
  need(net_announce(server.net, (server.root + "server").c_str()));
  for (const std::string& car : cars(*server.world)) need(net_announce(server.net, (server.root + "car/" + car).c_str()));
}

// ---- a tick ----

// Counts the samples that the transport refused for the reason for which a tick would have refused them.
void count_overtaken(Server& server) {
  NetStats stats;
  net_stats(server.net, &stats);
  const uint64_t more = stats.overtaken - std::exchange(server.overtaken, stats.overtaken);
  if (more == 0) return;
  count(*server.world,
        {Reason::stale_sequence,
         "poses or obstacles: another message of the host, with the same sequence or a later one, waits for the same tick"},
        more);
}

// Takes the messages that have arrived when the tick is due, not earlier: until then the transport replaces a host's older
// message by its newer one, so a host that sends faster than the ticks costs no more than any other.
void collect(Server& server, Clock::time_point due) {
  std::this_thread::sleep_until(due);
  const int got = net_poll(server.net, server.events.data(), events_limit, 0);
  need(got);
  for (const NetEvent& event : std::span(server.events).first(static_cast<size_t>(got))) {
    const Key key = parse_key(event.key, server.root).value_or(Key{});
    server.admission.take(server.net, event, key);
    if (event.kind == NET_ALIVE) server.replaced |= is_replaced(server.owner, key);
  }
  count_overtaken(server);
  Inbox admitted = server.admission.admit(server.net, *server.world);
  std::move(admitted.begin(), admitted.end(), std::back_inserter(server.inbox));
}

// A car's token tells viewers that it lives. Ends all publications for despawned cars.
void announce_cars(Server& server, const TickResult& result) {
  for (const std::string& id : result.despawned) {
    const std::string key = server.root + "car/" + id;
    net_retract(server.net, key.c_str());
    net_withdraw(server.net, (key + "/").c_str());
  }
  for (const std::string& id : result.spawned) net_announce(server.net, (server.root + "car/" + id).c_str());
}

void publish(Server& server, const Message& message) {
  if (message.ticket != 0) {
    net_reply(server.net, message.ticket, message.bytes.data(), message.bytes.size(), message.failed);
    return;
  }
  const Channel channel = channel_of(message.key);
  const bool first = channel == Channel::reactions || message.key == "replica/inputs";
  const NetPriority priority = first ? NET_REAL_TIME : channel == Channel::health ? NET_LOW : NET_DATA;
  net_put(server.net, (server.root + message.key).c_str(), message.bytes.data(), message.bytes.size(), priority);
}

void run_tick(Server& server) {
  const uint64_t number = tick_count(*server.world) + 1;
  if (const auto budget = server.budget.next()) server.inbox.push_back(budget_message(*budget));
  if (server.recording)
    for (const Message& message : server.inbox) server.recording->input(number, message, wall_ns());
  const auto begun = Clock::now();
  const TickResult result = tick(*server.world, server.inbox, server.outbox, server.threads);
  const uint64_t time = wall_ns();  // time of the outputs; a viewer's delay counts from here
  server.budget.learn(std::chrono::duration<double>(Clock::now() - begun).count(), result.work);
  server.last_work = result.work;
  server.admission.keep_latest(result, server.inbox);
  const bool replicated = net_matching(server.net, (server.root + "replica/inputs").c_str()) == 1;
  uint64_t sum = replicated ? hash(*server.world) : 0;  // takes 0.3 ms with a thousand cars
  if (replicated) publish(server, inputs_message(number, server.inbox, sum));
  announce_cars(server, result);
  for (const Message& message : server.outbox) publish(server, message);
  if (server.recording && !replicated) sum = hash(*server.world);
  if (server.recording) {
    for (const Message& message : server.outbox) server.recording->output(number, message, time);
    server.recording->end_tick(number, sum, time);
  }
  server.inbox.clear();
}

// Once a second.
void report(Server& server, uint64_t& told) {
  const Message health = health_report(*server.world, server.late, server.net, server.admission, server.recording.get());
  if (server.metrics) metrics_set(server.metrics, metrics_page(health, server.options.scene).c_str());
  publish(server, health);
  if (server.recording) server.recording->output(tick_count(*server.world), health, wall_ns());
  print_line(*server.world, server.late, server.last_work, server.net);
  server.admission.forget_hosts(server.net, *server.world);
  tell_refusals(*server.world, told);
  if (server.recording) server.recording->tell();
}

void run(Server& server, const std::atomic<bool>& stop) {
  const auto period = std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(1 / server.options.rate));
  const auto slack = std::chrono::duration_cast<Clock::duration>(late_share * period);
  const auto begun = Clock::now();
  auto due = begun + period, next_report = begun + std::chrono::seconds(1);
  uint64_t told = 0;
  while (!stop && !server.replaced &&
         (server.options.seconds <= 0 || std::chrono::duration<double>(due - begun).count() <= server.options.seconds)) {
    collect(server, due);
    if (stop || server.replaced) break;
    const auto now = Clock::now();
    if (now > due + slack) {
      ++server.late;
      due = now;
    }
    due += period;
    run_tick(server);
    if (server.recording) server.recording->go_on(now);
    if (now < next_report) continue;
    next_report += std::chrono::seconds(1);
    report(server, told);
  }
}

int finish(Server& server) {
  std::printf("%s%llu ticks, %llu late, %llu messages refused\n", isatty(STDOUT_FILENO) ? "\n" : "",
              static_cast<unsigned long long>(tick_count(*server.world)), static_cast<unsigned long long>(server.late),
              static_cast<unsigned long long>(refusal_count(*server.world)));
  if (server.replaced)
    std::fprintf(stderr, "crumple serve: another server has taken over scene %s: this server ends\n",
                 server.options.scene.c_str());
  if (!server.recording) return server.replaced ? 1 : 0;
  if (!server.recording->close() || server.replaced) return 1;
  std::printf("recorded %s\n", server.recording->file().c_str());
  return 0;
}

}  // namespace

int serve(const ServeOptions& options, const std::atomic<bool>& stop) {
  // A recording may reach a limit on file sizes, or be a pipe whose reader ends. Like a full disk, neither ends the server.
  std::signal(SIGXFSZ, SIG_IGN);
  std::signal(SIGPIPE, SIG_IGN);
  if (options.standby && options.connect.empty())
    throw std::runtime_error("--standby needs --connect: give the router that the scene's server is connected to");
  Server server(options);
  make_scene(server);
  if (options.check) return print_start(server), 0;
  warm_up(server);
  open_network(server);
  if (!options.standby && !become_owner(server, stop)) return 0;
  open_recording(server);
  if (server.recording && !options.standby) server.recording->begin(Clock::now());
  print_start(server);
  if (options.standby && !take_over(server, stop)) return 0;
  open_scene(server);
  run(server, stop);
  return finish(server);
}

}  // namespace crumple

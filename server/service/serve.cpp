// The only place that knows both the clock and the world. The tick itself never waits: the network publishes and the recorder
// writes on threads of their own, and what their queues cannot take is counted.
#include "service/serve.h"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <deque>
#include <iterator>
#include <optional>
#include <stdexcept>
#include <thread>
#include <utility>

#include "bake/load_car.h"
#include "io/metrics.h"
#include "protocol/key.h"
#include "recording/answer.h"
#include "recording/recording.h"
#include "recording/series.h"
#include "schema/message_generated.h"
#include "service/metrics.h"
#include "service/standby.h"
#include "tick/budget.h"
#include "tick/hash.h"
#include "tick/health.h"
#include "tick/levels.h"
#include "tick/uploads.h"

namespace crumple {
namespace {

using Clock = std::chrono::steady_clock;

// What one tick takes, so that no sender can make it long. Of each host the latest poses and the latest obstacles: that is all
// the transport keeps between two ticks. Further messages wait in its own bounded queues.
constexpr size_t inbox_limit = 20'000;
constexpr size_t sample_limit = size_t{1} << 20;  // bytes; Poses of 1000 cars have 200 kB
// Queries wait in line, and a tick lets in as many as this pays for. A keyframe is copied and packed: some 20 us. A command may
// copy a whole body (spawn, save, load), a query for an asset copies 256 KiB: some ms at 50,000 nodes. A baked car that is
// given is checked whole, which takes as long at a tenth of them, and what hosts told last may be 16 MiB: one a tick.
constexpr uint32_t query_limit = 1'000;                  // waiting; beyond it they are refused, and beyond
constexpr size_t query_bytes_limit = size_t{256} << 20;  // four of the longest that may be
constexpr int queries_pay = 256, keyframe_costs = 1, other_query_costs = 16;
constexpr size_t long_asset = size_t{64} << 10;  // what is shorter is no car, and refused at once
// Samples of hosts of which nothing is known yet, a second. Whoever may publish may invent hosts, and each has two channels in
// the recording, which may have 60,000 in the 10 s that a file lasts at least. The 64 hosts of a scene need 128.
constexpr size_t newcomers_limit = 2'048;
constexpr size_t command_limit = size_t{32} << 20;  // bytes: the state of a car of 100,000 nodes that is loaded
constexpr uint32_t connect_ms = 10'000;             // until a router must have answered
// How long a server that connects to others looks for one that owns its scene already.
constexpr std::chrono::milliseconds look{2000};
// A tick that starts later than this share of its period counts as late, and the schedule moves on with it: a server that
// cannot keep up slows down, and never runs a burst of ticks to catch up.
constexpr double late_share = 0.25;

// What the budget is in tet visits, which is all that the world knows. Learned from ticks that say something about it: those
// that took long, and those that were cut short; before the first one, from warming up.
struct BudgetEstimator {
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

// One that waits. Of the key its channel is known, and the baked car that a piece is asked of.
struct Query {
  Channel channel;
  std::string hash;
  Message message;
};

struct Server {
  const ServeOptions& options;
  std::string root;
  std::vector<std::shared_ptr<const Car>> cars;
  WorldHandle world;
  Net* net = nullptr;
  std::unique_ptr<Series> recording;
  Metrics* metrics = nullptr;
  std::vector<std::string> heard;  // ids of the hosts that a second ago had something
  size_t newcomers = 0;            // samples of others, in this second
  std::deque<Query> queries;       // waiting
  size_t queries_bytes = 0;        // of them
  uint64_t queries_refused = 0, keys_refused = 0;
  LatestInputs latest;
  Inbox inbox;
  Outbox outbox;
  BudgetEstimator budget;
  Owner owner{1, random_id()};
  bool replaced = false;  // by a server of a later epoch
  WorldAnswers world_answers;
  Work last_work;
  uint64_t late = 0;
  int threads = 1;

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

void start_world(Server& server) {
  const ServeOptions& options = server.options;
  const auto quantum = static_cast<float>(1e-3 * options.quantum_mm);
  for (const std::string& file : options.cars) server.cars.push_back(load_car(file));
  server.world = make_world(options.rate, quantum);
  for (const auto& car : server.cars) add_asset(*server.world, car);
  set_clock(*server.world, [start = Clock::now()] { return std::chrono::duration<double>(Clock::now() - start).count(); });
}

// Who stands by opens its file at once too: that it could not record should show before it is needed, and when it takes over
// no disk may hold it up.
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
  server.recording = std::make_unique<Series>(std::move(series), *server.world, server.latest);
}

// Whether one of the endpoints can be reached from another machine.
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

// Beside routers as a client of them: they route between clients, and between peers only where those know one another.
void open_network(Server& server) {
  const ServeOptions& options = server.options;
  const char* network = options.network.empty() ? nullptr : options.network.c_str();
  if (!options.connect.empty()) {
    need(net_open("client", nullptr, options.connect.c_str(), network, connect_ms, &server.net));
  } else {
    if (!network && is_public(options.listen))
      std::fprintf(stderr, "crumple serve: whoever reaches %s may command this scene; --network FILE says who may\n",
                   options.listen.c_str());
    need(net_open("peer", options.listen.c_str(), nullptr, network, 0, &server.net));
  }
  if (!options.metrics.empty()) need(metrics_open(options.metrics.c_str(), &server.metrics));
}

// Only where others could take over: a server that listens alone watches no tokens.
void watch_owners(Server& server, const Key& key) {
  server.replaced |= key.channel == Channel::owner && Owner{key.number, std::string(key.id)} > server.owner;
}

// Waits for the end of the scene's owner, or makes sure that there is none: a server that listens alone has no other beside it.
// Returns whether this server is to own the scene.
bool become_owner(Server& server, const std::atomic<bool>& stop) {
  if (server.options.standby) {
    const auto epoch = stand_by(server.net, {server.root, server.owner.id, server.threads}, *server.world, stop);
    if (!epoch) return false;
    server.owner.epoch = *epoch;
    return true;
  }
  if (server.options.connect.empty()) return true;
  need(net_watch(server.net, (server.root + "owner/*").c_str()));
  for (auto looked = Clock::now(), until = looked + look; looked < until && !stop;) {
    NetEvent events[16];
    const int got = net_poll(server.net, events, 16, 50'000);
    need(got);
    // Where the own line is cut, or this process slept, nobody was seen: it is looked anew.
    const auto before = std::exchange(looked, Clock::now());
    if (net_connected(server.net) != 1 || looked - before > longest_blink) until = looked + look;
    for (int k = 0; k < got; ++k)
      if (events[k].kind == NET_ALIVE && parse_key(events[k].key, server.root).value_or(Key{}).channel == Channel::owner)
        throw std::runtime_error("scene " + server.options.scene +
                                 " has a server already: wait for its end with --standby, or serve another --scene");
  }
  if (!stop) need(net_announce(server.net, (server.root + owner_key(server.owner.epoch, server.owner.id)).c_str()));
  return !stop;
}

// Of those that have nothing in the scene any more neither what they told last is kept, nor the keys of what they were told.
void forget_hosts(Server& server) {
  std::vector<std::string> now = hosts(*server.world);
  for (const std::string& host : server.heard)
    if (!std::binary_search(now.begin(), now.end(), host))
      net_withdraw(server.net, (server.root + "host/" + host + "/").c_str());
  server.latest.forget_others(now);
  std::string keys;  // of those who are known: a flood of others must not deafen the server to them
  for (const std::string& host : now)
    for (const char* what : {"/poses", "/obstacles"}) keys += (keys.empty() ? "" : ",") + server.root + "host/" + host + what;
  need(net_prefer(server.net, keys.c_str()));
  server.heard = std::move(now);
  server.newcomers = 0;
}

void open_scene(Server& server) {
  for (const char* what : {"host/*/poses", "host/*/obstacles"})
    need(net_subscribe(server.net, (server.root + what).c_str(), 0, sample_limit));
  need(net_queryable(server.net, (server.root + "asset").c_str(), query_limit, largest_upload + question_limit));
  need(net_queryable(server.net, (server.root + "car/*").c_str(), query_limit, command_limit));
  for (const char* what : {"car/*/key/*", "replica/world", "inputs"})
    need(net_queryable(server.net, (server.root + what).c_str(), query_limit, question_limit));
  need(net_queryable(server.net, (std::string(asset_root) + "*").c_str(), query_limit, question_limit));
  forget_hosts(server);  // those of a server that was replaced are known
  need(net_announce(server.net, (server.root + "server").c_str()));
  for (const std::string& car : cars(*server.world)) need(net_announce(server.net, (server.root + "car/" + car).c_str()));
}

void refuse_query(Server& server, uint64_t ticket, const std::string& sentence) {
  ++server.queries_refused;
  net_reply(server.net, ticket, sentence.data(), sentence.size(), 1);
}

void take_query(Server& server, const NetEvent& event, const Key& key) {
  constexpr std::array asked = {Channel::asset,  Channel::command, Channel::keyframe,
                                Channel::latest, Channel::world,   Channel::piece};
  if (std::find(asked.begin(), asked.end(), key.channel) == asked.end()) {
    ++server.keys_refused;
    return refuse_query(
        server, event.ticket,
        "nothing is asked under " + printable(event.key) + ": schema/README.md lists the keys; ids are " + id_rule);
  }
  if (server.queries.size() >= query_limit || server.queries_bytes + event.size > query_bytes_limit)
    return refuse_query(server, event.ticket, "too many questions wait here: ask again later");
  const auto* bytes = reinterpret_cast<const std::byte*>(event.data);
  const std::string_view below = key.channel == Channel::piece ? "" : std::string_view(event.key).substr(server.root.size());
  server.queries_bytes += event.size;
  server.queries.push_back({key.channel, std::string(key.id), {std::string(below), {bytes, bytes + event.size}, event.ticket}});
}

void take_sample(Server& server, const NetEvent& event, const Key& key) {
  const bool known = std::binary_search(server.heard.begin(), server.heard.end(), key.id);
  if ((key.channel != Channel::poses && key.channel != Channel::obstacles) ||
      (!known && ++server.newcomers > newcomers_limit)) {
    ++server.keys_refused;
    return;
  }
  const auto* bytes = reinterpret_cast<const std::byte*>(event.data);
  Message message{event.key + server.root.size(), {bytes, bytes + event.size}};
  server.latest.keep(message);
  server.inbox.push_back(std::move(message));
}

// The door: here a key that came is parsed, once. What it cannot be is refused.
void take(Server& server, const NetEvent& event) {
  const Key key = parse_key(event.key, server.root).value_or(Key{});
  if (event.kind == NET_QUERY) return take_query(server, event, key);
  if (event.kind == NET_SAMPLE) return take_sample(server, event, key);
  if (event.kind == NET_ALIVE) return watch_owners(server, key);
}

std::vector<std::shared_ptr<const Car>> all_cars(const Server& server) {
  auto cars = uploaded_cars(*server.world);
  cars.insert(cars.end(), server.cars.begin(), server.cars.end());
  return cars;
}

// The queries that this tick pays for, before its samples: who spawns a car and moves it at once is understood.
void admit_queries(Server& server) {
  Inbox admitted;
  for (int left = queries_pay; !server.queries.empty(); server.queries.pop_front()) {
    auto& [channel, hash, next] = server.queries.front();
    const bool long_one = channel == Channel::latest || (channel == Channel::asset && next.bytes.size() > long_asset);
    left -= long_one ? queries_pay : channel == Channel::keyframe ? keyframe_costs : other_query_costs;
    if (left < 0) break;
    server.queries_bytes -= next.bytes.size();
    const auto* bytes = reinterpret_cast<const uint8_t*>(next.bytes.data());
    const NetEvent query{NET_QUERY, 0, next.key.c_str(), bytes, next.bytes.size(), next.ticket};
    if (channel == Channel::latest)
      server.latest.answer(server.net, next.ticket);
    else if (channel == Channel::world)
      server.world_answers.answer(server.net, query, *server.world);
    else if (channel == Channel::piece)
      answer_asset(server.net, query, hash, all_cars(server));
    else
      admitted.push_back(std::move(next));
  }
  server.inbox.insert(server.inbox.begin(), std::make_move_iterator(admitted.begin()), std::make_move_iterator(admitted.end()));
}

// What has come when the tick is due. Nothing is taken before: until then the transport lets a host's newer message replace its
// older one, so that a host that sends faster than the ticks costs no more than one that does not.
void collect(Server& server, Clock::time_point due) {
  std::this_thread::sleep_until(due);
  NetEvent events[256];
  size_t total = 0;
  int got = 0;
  do {
    got = net_poll(server.net, events, 256, 0);
    need(got);
    for (int i = 0; i < got; ++i) take(server, events[i]);
    total += static_cast<size_t>(got);
  } while (got == 256 && total < inbox_limit);
  admit_queries(server);
}

// Viewers learn from its token that a car lives. Of one that went nothing is published any more.
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
  const uint64_t time = wall_ns();  // of what it gives: a viewer's delay counts from here
  server.budget.learn(std::chrono::duration<double>(Clock::now() - begun).count(), result.work);
  server.last_work = result.work;
  const bool replicated = net_matching(server.net, (server.root + "replica/inputs").c_str()) == 1;
  uint64_t sum = replicated ? hash(*server.world) : 0;  // 0.3 ms where cars are a thousand
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

void publish_health(Server& server) {
  NetStats stats;
  net_stats(server.net, &stats);
  const Message report = health(*server.world, server.late,
                                {{"sent", stats.put},
                                 {"sent_bytes", stats.put_bytes},
                                 {"sent_dropped", stats.put_dropped},
                                 {"received", stats.received},
                                 {"received_bytes", stats.received_bytes},
                                 {"received_dropped", stats.received_dropped},
                                 {"replaced", stats.replaced},
                                 {"keys_published", stats.keys, NET_KEYS},
                                 {"oversized", stats.oversized},
                                 {"keys_refused", server.keys_refused},
                                 {"frames_refused", stats.frames_refused},
                                 {"queries_waiting", server.queries.size(), query_limit},
                                 {"queries_refused", stats.queries_refused + server.queries_refused},
                                 {"recording_lost", server.recording ? server.recording->lost() : 0}});
  if (server.metrics) metrics_set(server.metrics, metrics_page(report, server.options.scene).c_str());
  publish(server, report);
  if (server.recording) server.recording->output(tick_count(*server.world), report, wall_ns());
  if (isatty(STDOUT_FILENO)) {
    const Work last = server.last_work;
    std::printf("\rtick %llu  cars %zu  late %llu  shed %.0f %%  refused %llu  sent %.1f MB \x1b[K",
                static_cast<unsigned long long>(tick_count(*server.world)), cars(*server.world).size(),
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

void run(Server& server, const std::atomic<bool>& stop) {
  const auto period = std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(1 / server.options.rate));
  const auto slack = std::chrono::duration_cast<Clock::duration>(late_share * period);
  const auto begun = Clock::now();
  auto due = begun + period, next_health = begun + std::chrono::seconds(1);
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
    if (now < next_health) continue;
    next_health += std::chrono::seconds(1);
    publish_health(server);
    forget_hosts(server);
    tell_refusals(server, told);
    if (server.recording) server.recording->tell();
  }
}

int finish(Server& server) {
  std::printf("%s%llu ticks, %llu late, %llu messages refused\n", isatty(STDOUT_FILENO) ? "\n" : "",
              static_cast<unsigned long long>(tick_count(*server.world)), static_cast<unsigned long long>(server.late),
              static_cast<unsigned long long>(refusal_count(*server.world)));
  if (server.replaced)
    std::fprintf(stderr, "crumple serve: another has taken over scene %s: this server ends here\n",
                 server.options.scene.c_str());
  if (!server.recording) return server.replaced ? 1 : 0;
  if (!server.recording->close() || server.replaced) return 1;
  std::printf("recorded %s\n", server.recording->file().c_str());
  return 0;
}

// Of a world that another server had until now. Trouble with the recording must not end the one server that holds it.
void take_over(Server& server) {
  renew(*server.world);
  if (server.budget.limit == 0) server.inbox.push_back(budget_message(0));  // not the limit of the other
  try {
    if (server.recording) server.recording->begin(Clock::now());
  } catch (const std::exception& error) {
    server.recording.reset();
    std::fprintf(stderr, "crumple serve: %s; goes on without\n", error.what());
  }
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

}  // namespace

int serve(const ServeOptions& options, const std::atomic<bool>& stop) {
  // A recording may meet a limit on file sizes, or be a pipe whose reader goes: like a full disk, that does not end the server.
  std::signal(SIGXFSZ, SIG_IGN);
  std::signal(SIGPIPE, SIG_IGN);
  Server server(options);
  server.root = root_of(options.scene);
  server.threads = options.threads > 0 ? options.threads : std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  server.budget.limit = 1e-3 * options.budget_ms;
  if (options.standby && options.connect.empty())
    throw std::runtime_error("--standby needs --connect: it meets the scene's server at a router");
  start_world(server);
  if (!options.check) {
    warm_up(*server.world, server.threads);
    const auto begun = Clock::now();
    const uint64_t work = warm_up(*server.world, server.threads);
    if (work > 0) server.budget.visit = std::chrono::duration<double>(Clock::now() - begun).count() / double(work);
    open_network(server);
    if (!options.standby && !become_owner(server, stop)) return 0;
    open_recording(server);
    if (server.recording && !options.standby) server.recording->begin(Clock::now());
  }
  print_start(server);
  if (options.check) return 0;
  if (options.standby) {
    if (!become_owner(server, stop)) return 0;
    take_over(server);
  }
  open_scene(server);
  run(server, stop);
  return finish(server);
}

}  // namespace crumple

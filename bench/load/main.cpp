// crumple_load makes one run of the load harness. bench/load/run plays the scenarios in its folder and makes the page.
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <crumple.hpp>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>
#include <thread>

#include "bake/load_car.h"
#include "car/car.h"
#include "load.h"

namespace crumple::load {
namespace {

using Clock = std::chrono::steady_clock;

constexpr double calm = 3;       // s from the last pose until the comparison: a crash rings for one second
constexpr double calm_far = 10;  // s, on impaired links: detecting a lost connection takes 3 s, and reconnecting 3 s
constexpr double frozen = 3;     // s
constexpr const char* datagrams = "?rel=1";
constexpr double start_patience = 120;  // s for the server to start and spawn all cars

std::atomic<bool> interrupted{false};

struct Process {
  pid_t id = 0;
  ~Process() {
    if (id > 0) kill(id, SIGKILL), waitpid(id, nullptr, 0);
  }
  Process() = default;
  Process(Process&& other) noexcept : id(std::exchange(other.id, 0)) {}
  Process& operator=(Process&&) = delete;

  void start(const std::vector<std::string>& words, const std::string& log) {
    std::vector<char*> arguments;
    for (const std::string& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    id = fork();
    if (id != 0) return;
    if (!std::freopen(log.c_str(), "w", stdout) || dup2(fileno(stdout), fileno(stderr)) < 0) _exit(127);
    execv(arguments[0], arguments.data());
    _exit(127);
  }
  // Asks the process to end and returns its exit code; negative if a signal killed it.
  int end(int signal) {
    int status = 0;
    if (id <= 0) return 0;
    kill(id, signal);
    kill(id, SIGCONT);  // in case it is frozen
    waitpid(std::exchange(id, 0), &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }
  bool alive() {
    if (id > 0 && waitpid(id, nullptr, WNOHANG) == id) id = 0;
    return id > 0;
  }
};

std::string text_of(const std::string& file) {
  std::ifstream in(file);
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

// Returns utime + stime of a process or thread, s: fields 14 and 15. The name before them may contain spaces.
double cpu_of(const std::string& folder) {
  const std::string text = text_of(folder + "/stat");
  std::istringstream rest(text.substr(std::min(text.size(), text.rfind(')') + 1)));
  std::string skip;
  for (int field = 3; field < 14; ++field) rest >> skip;
  double user = 0, system = 0;
  rest >> user >> system;
  return (user + system) / double(sysconf(_SC_CLK_TCK));
}

Sample sample(pid_t server) {
  const std::filesystem::path folder = "/proc/" + std::to_string(server);
  Sample out;
  out.ns = wall_ns();
  out.cpu = cpu_of(folder);
  std::error_code gone;
  for (const auto& thread : std::filesystem::directory_iterator(folder / "task", gone))
    if (text_of(thread.path() / "comm") == "recorder\n") out.recorder_cpu = cpu_of(thread.path());
  std::istringstream pages(text_of(folder / "statm"));
  uint64_t all = 0;
  pages >> all >> out.memory;
  out.memory *= uint64_t(sysconf(_SC_PAGESIZE));
  for ([[maybe_unused]] const auto& one : std::filesystem::directory_iterator(folder / "fd", gone)) ++out.descriptors;
  return out;
}

void sleep_until(Clock::time_point when) {
  while (!interrupted && Clock::now() < when)
    std::this_thread::sleep_for(std::min<Clock::duration>(when - Clock::now(), std::chrono::milliseconds(50)));
}

// The server's endpoints, comma separated: TCP, and QUIC over UDP if requested.
std::string start_server(const Options& options, const std::string& recording, Process& server) {
  std::vector<std::string> words = {options.program,   "serve",    "--scene", scene,  "--listen",
                                    "tcp/127.0.0.1:0", "--record", recording, "--car"};
  words.insert(words.end(), options.cars.begin(), options.cars.end());
  if (options.udp) words[5] += ",udp/127.0.0.1:0" + std::string(datagrams);
  std::istringstream further(options.serve);
  for (std::string word; further >> word;) words.push_back(word);
  const std::string log = options.folder + "/server.log";
  server.start(words, log);
  const auto until = Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(start_patience));
  while (Clock::now() < until && !interrupted) {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    const std::string text = text_of(log);
    const size_t at = text.find("tcp/"), end = text.find(", ", at);
    if (at != std::string::npos && end != std::string::npos) return text.substr(at, end - at);
    if (!server.alive()) throw std::runtime_error("load: the server did not start: " + text);
  }
  throw std::runtime_error("load: the server did not say where it listens; see " + log);
}

// Everything that a run needs. The destructor stops and joins the hosts.
struct Stage {
  const Options& options;
  Process server;
  std::string endpoint, viewers_endpoint;
  std::unique_ptr<ImpairedLink> link;  // the viewers'
  std::vector<Process> viewers;
  std::atomic<uint32_t> ready{0};
  std::atomic<bool> go{false}, stop{false};
  std::vector<std::thread> hosts;
  std::vector<std::string> troubles;
  Run run;

  explicit Stage(const Options& o) : options(o) {}
  ~Stage() { end_hosts(); }
  void end_hosts() {
    stop = true;
    for (std::thread& host : hosts)
      if (host.joinable()) host.join();
  }
};

void start_hosts(Stage& stage, const std::string& asset) {
  const Options& options = stage.options;
  std::vector<HostTask> tasks(options.hosts);
  const auto share = [&](uint32_t count, std::vector<uint32_t> HostTask::*list) {
    for (uint32_t k = 0; k < count; ++k) (tasks[k % options.hosts].*list).push_back(k);
  };
  share(options.crashing, &HostTask::crashing);
  share(options.driving, &HostTask::driving);
  share(options.asleep, &HostTask::asleep);
  stage.troubles.resize(options.hosts);
  for (uint32_t k = 0; k < options.hosts; ++k) {
    tasks[k].endpoint = stage.endpoint;
    tasks[k].id = "host" + std::to_string(k);
    tasks[k].asset = asset;
    tasks[k].speed = options.speed_kmh / 3.6;
    tasks[k].period = options.period;
    tasks[k].importance = options.importance;
    tasks[k].meeting = meeting_of(options);
    stage.hosts.emplace_back([&stage, k, task = tasks[k]] {
      try {
        play_host(task, stage.ready, stage.go, stage.stop);
      } catch (const std::exception& error) {
        stage.troubles[k] = error.what();
        stage.stop = true;
      }
    });
  }
}

void check(const Stage& stage) {
  for (const std::string& trouble : stage.troubles)
    if (stage.stop && !trouble.empty()) throw std::runtime_error(trouble);
}

void start_viewer(Stage& stage, const std::string& part, uint32_t number) {
  const Options& options = stage.options;
  ViewerRun viewer;
  viewer.part = part;
  viewer.file = options.folder + "/viewer" + std::to_string(stage.viewers.size()) + ".csv";
  const bool is_far = part == "far";
  std::vector<std::string> words = {"/proc/self/exe",       "--view",  viewer.file,        "--connect",
                                    stage.viewers_endpoint, "--level", is_far ? "1" : "0", "--follow"};
  for (uint32_t k = 0; k < (is_far ? options.crashing : std::min(options.follow, options.crashing)); ++k)
    viewer.cars.push_back(car_id('c', (number * options.follow + k) % options.crashing));
  words.insert(words.end(), viewer.cars.begin(), viewer.cars.end());
  stage.viewers.emplace_back().start(words, viewer.file + ".log");
  stage.run.viewers.push_back(viewer);
}

// Separates the server's endpoints, and creates the viewers' impaired links if there are any.
void open_links(Stage& stage, const std::string& endpoints) {
  const size_t comma = endpoints.find(',');
  stage.endpoint = stage.viewers_endpoint = endpoints.substr(0, comma);
  if (!stage.options.impaired()) return;
  const std::string to = stage.options.udp ? endpoints.substr(comma + 1, endpoints.find('?') - comma - 1) : stage.endpoint;
  stage.link = std::make_unique<ImpairedLink>(to, stage.options.weather);
  stage.viewers_endpoint = stage.link->endpoint() + (stage.options.udp ? datagrams : "");
}

// Freezes, kills, cuts and starts viewers at fixed shares of the time.
void disturb(Stage& stage, double time) {
  const Options& options = stage.options;
  const auto passed = [&, last = time - 1](double when) { return last < when && when <= time; };
  const double freeze_at = std::floor(0.25 * options.seconds), kill_at = std::floor(0.5 * options.seconds),
               join_at = std::floor(0.6 * options.seconds);
  for (uint32_t k = 0; k < options.frozen; ++k) {
    if (passed(freeze_at)) kill(stage.viewers[k].id, SIGSTOP);
    if (passed(freeze_at + frozen)) {
      kill(stage.viewers[k].id, SIGCONT);
      stage.run.viewers[k].thawed_ns = wall_ns();
    }
  }
  if (passed(kill_at)) {
    for (uint32_t k = options.frozen; k < options.frozen + options.killed; ++k) {
      stage.viewers[k].end(SIGKILL);
      start_viewer(stage, "late", k);
    }
  }
  if (options.cut > 0 && passed(kill_at)) {
    stage.run.cut_ns = wall_ns();
    stage.link->set(LinkState::cut);
  }
  if (options.cut > 0 && passed(kill_at + options.cut)) {
    stage.run.back_ns = wall_ns();
    stage.link->set(LinkState::up);
  }
  if (passed(join_at + std::ceil(options.cut)))
    for (uint32_t k = 0; k < options.late; ++k) start_viewer(stage, "late", options.viewers + k);
}

// The surfaces that a viewer gets if it starts after the load.
void ask_for_truth(Stage& stage, int level) {
  client::Session session({stage.endpoint, scene, "", "", patience});
  std::vector<std::string> cars;
  for (uint32_t k = 0; k < stage.options.crashing; ++k) {
    cars.push_back(car_id('c', k));
    session.follow(cars.back(), level);
  }
  const auto until = Clock::now() + std::chrono::seconds(20);
  for (const std::string& car : cars) {
    std::optional<CrumpleSurface> surface;
    while (!(surface = session.surface(car)) && Clock::now() < until) session.poll(std::chrono::milliseconds(10));
    if (!surface) throw std::runtime_error("load: no surface of car " + car + " came within 20 s");
    char digits[17];
    std::snprintf(digits, sizeof digits, "%016llx", static_cast<unsigned long long>(surface->hash));
    stage.run.truth[level][car] = digits;
  }
}

void watch_over(Stage& stage) {
  const Options& options = stage.options;
  client::Session session({stage.endpoint, scene, "", "", patience});
  const auto begun = Clock::now();
  stage.run.begin_ns = wall_ns();
  stage.run.samples.push_back(sample(stage.server.id));
  stage.go = true;
  for (double time = 1; time <= options.seconds && !interrupted && !stage.stop; ++time) {
    sleep_until(begun + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(time)));
    if (!stage.server.alive()) throw std::runtime_error("load: the server ended: " + text_of(options.folder + "/server.log"));
    stage.run.samples.push_back(sample(stage.server.id));
    disturb(stage, time);
    session.poll();
    const CrumpleHealth health = session.health().value_or(CrumpleHealth{});
    const auto& samples = stage.run.samples;
    const double cpu = samples.back().cpu - samples[samples.size() - 2].cpu;
    const bool terminal = isatty(STDOUT_FILENO);
    if (terminal || int(time) % 10 == 0) {
      std::printf("%s%3.0f s of %.0f  tick %llu: %.1f ms, worst %.1f  late %llu  server %.0f %% of a core, %.0f MB%s",
                  terminal ? "\r" : "", time, options.seconds, static_cast<unsigned long long>(health.tick),
                  double(health.tick_ms), double(health.worst_ms), static_cast<unsigned long long>(health.late), 100 * cpu,
                  1e-6 * double(samples.back().memory), terminal ? " \x1b[K" : "\n");
      std::fflush(stdout);
    }
  }
  stage.run.end_ns = wall_ns();
  if (isatty(STDOUT_FILENO)) std::printf("\n");
}

int play(const Options& options) {
  std::filesystem::create_directories(options.folder);
  for (const auto& file : std::filesystem::directory_iterator(options.folder))  // files of an earlier run
    if (file.path().filename().string().starts_with("viewer")) std::filesystem::remove(file);
  const auto car = load_car(options.cars.front());
  Stage stage(options);
  stage.run.recording = options.folder + "/load.mcap";
  open_links(stage, start_server(options, stage.run.recording, stage.server));
  std::printf(
      "%u cars of %zu nodes: %u crash at once every %g s at %g km/h, %u drive, %u sleep; %u hosts, %u viewers of %u cars\n",
      options.asleep + options.driving + options.crashing, car->model.node.size(), options.crashing, options.period,
      options.speed_kmh, options.driving, options.asleep, options.hosts, options.viewers,
      std::min(options.follow, options.crashing));
  if (const Meeting meeting = meeting_of(options); meeting.cars > 0)
    std::printf("%u of the crashing cars hit cars of other hosts: %u in one place, the others in pairs\n", meeting.cars,
                meeting.pile);
  std::fflush(stdout);
  start_hosts(stage, car->hash);
  const auto until = Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(start_patience));
  while (stage.ready < options.hosts && Clock::now() < until && !interrupted && !stage.stop)
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  check(stage);
  if (stage.ready < options.hosts) throw std::runtime_error("load: the cars were not spawned within 120 s");
  for (uint32_t k = 0; k < options.viewers; ++k)
    start_viewer(stage, k < options.frozen ? "frozen" : k < options.viewers - options.far ? "steady" : "far", k);
  sleep_until(Clock::now() + std::chrono::seconds(2));
  watch_over(stage);
  stage.end_hosts();
  check(stage);
  sleep_until(Clock::now() +
              std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(stage.link ? calm_far : calm)));
  for (int level : {0, 1}) ask_for_truth(stage, level);
  if (stage.link) stage.run.packets = stage.link->counts();
  for (size_t k = 0; k < stage.viewers.size(); ++k)
    if (stage.viewers[k].id > 0 && stage.viewers[k].end(SIGTERM) != 0)
      throw std::runtime_error("load: a viewer failed: " + text_of(stage.run.viewers[k].file + ".log"));
  if (stage.server.end(SIGTERM) != 0)
    std::fprintf(stderr, "load: the server did not end well: %s\n", text_of(options.folder + "/server.log").c_str());
  return report(options, stage.run);
}

int run(int argc, char** argv) {
  Options options;
  ViewerTask viewer;
  CLI::App app{"Plays hosts and viewers against a server of its own, over real zenoh, and reports how it held", "crumple_load"};
  app.set_config("--scenario", "", "a file with any of these options, as in bench/load/ten.toml; flags come before it");
  app.add_option("--program", options.program, "the crumple to start")->default_val(CRUMPLE_PROGRAM)->configurable(false);
  app.add_option("--car", options.cars, "baked cars: the first is spawned, further ones are its levels")
      ->check(CLI::ExistingFile)
      ->configurable(false);
  app.add_option("--out", options.folder, "folder for the recording, what viewers saw, and load.json")
      ->configurable(false)
      ->capture_default_str();
  app.add_option("--serve", options.serve, "further options of crumple serve, in one word: \"--budget 0\"");
  app.add_option("--seconds", options.seconds, "of load")->check(CLI::Range(5.0, 86'400.0))->capture_default_str();
  app.add_option("--hosts", options.hosts, "that share the cars")->check(CLI::Range(1u, 64u))->capture_default_str();
  app.add_option("--asleep", options.asleep, "cars that stand where they were spawned")->capture_default_str();
  app.add_option("--driving", options.driving, "cars that drive and meet nothing")->capture_default_str();
  app.add_option("--crashing", options.crashing, "cars that hit a wall, all at the same time")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--speed", options.speed_kmh, "of the crashes, km/h")->check(CLI::Range(1.0, 300.0))->capture_default_str();
  app.add_option("--period", options.period, "seconds from crash to crash")
      ->check(CLI::Range(2.5, 60.0))
      ->capture_default_str();
  app.add_option("--importance", options.importance, "of crashing cars: chooses their level")
      ->check(CLI::Range(0.001, 1.0))
      ->capture_default_str();
  app.add_option("--meeting", options.meeting, "share of the crashing cars that hit cars of other hosts instead of walls")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--pile", options.pile, "so many of them meet in one place, from both sides; the others meet head-on in pairs")
      ->check(CLI::Range(2u, 100u))
      ->capture_default_str();
  app.add_option("--viewers", options.viewers, "processes that follow crashing cars")
      ->check(CLI::Range(1u, 1'000u))
      ->capture_default_str();
  app.add_option("--follow", options.follow, "cars that each viewer follows")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--far", options.far, "of the viewers, that follow all cars as who is far from them")->capture_default_str();
  app.add_option("--frozen", options.frozen, "viewers that are stopped for 3 s at a quarter of the time")
      ->capture_default_str();
  app.add_option("--killed", options.killed, "viewers that are killed half-way; others come for them")->capture_default_str();
  app.add_option("--late", options.late, "further viewers that come late")->capture_default_str();
  Weather& weather = options.weather;
  app.add_option("--delay", weather.delay, "of the viewers' links, one way, ms")->check(CLI::Range(0.0, 10'000.0));
  app.add_option("--jitter", weather.jitter, "of the delay, +- ms")->check(CLI::Range(0.0, 10'000.0));
  app.add_option("--loss", weather.loss, "share of packets that the viewers' links lose")->check(CLI::Range(0.0, 0.9));
  app.add_option("--reorder", weather.reorder, "share of datagrams that overtake")->check(CLI::Range(0.0, 1.0));
  app.add_option("--kbit", weather.kbit, "a second and viewer; 0: no limit")->check(CLI::NonNegativeNumber);
  app.add_option("--cut", options.cut, "seconds that all viewers' links are cut for, half-way")->check(CLI::Range(0.0, 60.0));
  app.add_flag("--udp", options.udp, "viewers come by QUIC over UDP, without a certificate (?rel=1)");
  try {
    app.parse(argc, argv);
    if (options.cars.empty()) throw CLI::RequiredError("--car");
    if (options.frozen + options.killed + options.far > options.viewers)
      throw CLI::ValidationError("--frozen, --killed and --far", "name more viewers than there are");
    if (options.meeting > 0 && options.hosts % 2 != 0)
      throw CLI::ValidationError("--meeting", "needs an even number of --hosts, so that cars that meet have different hosts");
  } catch (const CLI::Success& asked) {
    return app.exit(asked);
  } catch (const CLI::ParseError& error) {
    std::fprintf(stderr, "crumple_load: %s\nTry: crumple_load --help\n", error.what());
    return 2;
  }
  std::signal(SIGINT, [](int) { interrupted = true; });
  std::signal(SIGTERM, [](int) { interrupted = true; });
  return play(options);
}

}  // namespace
}  // namespace crumple::load

// This program starts itself as a viewer process: --view FILE --connect ENDPOINT --level LEVEL --follow CAR...
int main(int argc, char** argv) {
  using namespace crumple::load;
  try {
    if (argc > 8 && std::string_view(argv[1]) == "--view")
      return view({argv[4], argv[2], argv[6] == std::string_view("1"), {argv + 8, argv + argc}});
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple_load: %s\n", error.what());
    return 1;
  }
}

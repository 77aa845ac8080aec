// crumple_weather [--seed N] [--schedules N | --seconds N]
// Reproducible bad weather for the program's logic: many schedules, each from one number. If a schedule breaks a law, the
// program prints its number. With this number it plays the same schedule again and prints all its events.
#include <fcntl.h>
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <string>

#include "box_car.h"
#include "network.h"
#include "schedule.h"

namespace crumple::weather {
namespace {

constexpr unsigned patience = 60;        // s of wall time for one schedule, which normally takes a tenth
constexpr size_t last_lines = 60;        // lines to print of a failing schedule
constexpr uint64_t twice_each = 20;      // one in so many schedules runs twice, and must give the same events
constexpr long memory_limit = 64 << 10;  // KiB that the process may grow by after the first schedules

FILE* out = nullptr;
volatile uint64_t current_seed = 0;

double wall() {
  timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return double(time.tv_sec) + 1e-9 * double(time.tv_nsec);
}

long memory_kib() {
  std::ifstream status("/proc/self/statm");
  long all = 0, resident = 0;
  status >> all >> resident;
  return resident * (sysconf(_SC_PAGESIZE) >> 10);
}

extern "C" void died(int signal) {
  char text[100];
  const int size = std::snprintf(text, sizeof text, "seed %llu: %s\n", static_cast<unsigned long long>(current_seed),
                                 signal == SIGALRM   ? "does not end"
                                 : signal == SIGABRT ? "aborted"
                                                     : "crashed");
  if (write(fileno(out), text, size_t(size)) < 0) _exit(4);
  _exit(3);
}

ssize_t take_words(void*, const char* text, size_t size) {
  if (tracing() && size > 1) trace("  | " + std::string(text, size - (text[size - 1] == '\n')));
  return ssize_t(size);
}

struct Options {
  uint64_t seed = 1, schedules = 0;
  double seconds = 0;
  bool one = true;
};

Ended run_one(uint64_t seed, const std::string& file, const std::string& asset) {
  current_seed = seed;
  alarm(patience);
  const Ended ended = run_schedule(seed, file, asset);
  alarm(0);
  return ended;
}

void print_lines(size_t most) {
  const auto& lines = traced();
  for (size_t i = lines.size() > most ? lines.size() - most : 0; i < lines.size(); ++i)
    std::fprintf(out, "%s\n", lines[i].c_str());
}

int run(const Options& options, const std::string& file, const std::string& asset) {
  set_tracing(options.one);
  const double begun = wall();
  uint64_t done = 0, failed = 0;
  double simulated = 0;
  long memory = 0;
  for (uint64_t seed = options.seed; options.one         ? done < 1
                                     : options.schedules ? done < options.schedules
                                                         : wall() - begun < options.seconds;
       ++seed) {
    Ended ended = run_one(seed, file, asset);
    ++done;
    simulated += ended.seconds;
    if (options.one) print_lines(SIZE_MAX);
    if (!options.one && ended.broken.empty() && seed % twice_each == 0 && run_one(seed, file, asset).digest != ended.digest)
      ended.broken = "the same seed gave another schedule";
    if (!ended.broken.empty()) {
      ++failed;
      if (!options.one) {
        set_tracing(true);
        run_one(seed, file, asset);
        print_lines(last_lines);
        set_tracing(false);
      }
      std::fprintf(out, "seed %llu, schedule %llu: %s\n", static_cast<unsigned long long>(seed),
                   static_cast<unsigned long long>(done), ended.broken.c_str());
      std::fflush(out);
    }
    if (done == 20) memory = memory_kib();
  }
  std::fprintf(out, "%llu schedules, %llu broken; %.0f simulated seconds in %.1f s; %ld MiB\n",
               static_cast<unsigned long long>(done), static_cast<unsigned long long>(failed), simulated, wall() - begun,
               memory_kib() >> 10);
  if (memory > 0 && memory_kib() - memory > memory_limit) {
    std::fprintf(out, "memory grew from %ld to %ld KiB\n", memory, memory_kib());
    ++failed;
  }
  return failed == 0 ? 0 : 1;
}

}  // namespace
}  // namespace crumple::weather

int main(int count, char** arguments) {
  using namespace crumple::weather;
  out = fdopen(dup(STDOUT_FILENO), "w");
  Options options;
  for (int i = 1; i < count; i += 2) {
    const std::string name = arguments[i];
    const char* value = i + 1 < count ? arguments[i + 1] : nullptr;
    if (value && name == "--seed") {
      options.seed = std::strtoull(value, nullptr, 10);
    } else if (value && (name == "--schedules" || name == "--seconds")) {
      options.one = false;
      if (name == "--seconds")
        options.seconds = std::strtod(value, nullptr);
      else
        options.schedules = std::strtoull(value, nullptr, 10);
    } else {
      std::fprintf(stderr, "crumple_weather [--seed N] [--schedules N | --seconds N]\n");
      return 2;
    }
  }
  for (const int signal : {SIGALRM, SIGABRT, SIGSEGV, SIGBUS, SIGFPE}) std::signal(signal, died);
  // The output of servers is part of the events.
  const cookie_io_functions_t words{nullptr, take_words, nullptr, nullptr};
  stdout = fopencookie(nullptr, "w", words);
  stderr = fopencookie(nullptr, "w", words);
  std::setvbuf(stdout, nullptr, _IOLBF, 4096);
  std::setvbuf(stderr, nullptr, _IOLBF, 4096);
  char folder[] = "/tmp/crumple_weather_XXXXXX";
  if (!mkdtemp(folder)) return 2;
  const std::string file = std::string(folder) + "/box.car";
  const auto bytes = crumple::box_car_bytes({3, 2, 2});
  std::ofstream(file, std::ios::binary).write(reinterpret_cast<const char*>(bytes.data()), std::streamsize(bytes.size()));
  const std::string asset = crumple::read_car(bytes, "box")->hash;
  const int code = run(options, file, asset);
  std::filesystem::remove_all(folder);
  std::fflush(out);
  return code;
}

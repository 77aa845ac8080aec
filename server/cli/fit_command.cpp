#include "cli/fit_command.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <set>
#include <stdexcept>

#include "bake/load_car.h"
#include "bake/script.h"
#include "fit/fit.h"
#include "io/files.h"

namespace crumple {
namespace {

using Cars = std::vector<std::shared_ptr<const Car>>;

// Coarsest first.
Cars load_levels(const std::vector<std::string>& files) {
  Cars cars;
  for (const std::string& file : files) cars.push_back(load_car(file));
  std::stable_sort(cars.begin(), cars.end(),
                   [](const auto& a, const auto& b) { return a->model.node.size() < b->model.node.size(); });
  return cars;
}

std::string number(double value, const char* format = "%.4g") {
  char text[48];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

// For JSON: other people's names, without what would need an escape.
std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) out += c < ' ' || c == '"' || c == '\\' || c == 127 ? '?' : c;
  return out + '"';
}

std::string names_of(const std::vector<PublishedCar>& tests) {
  constexpr size_t most = 12;
  std::string out;
  size_t count = 0;
  for (const PublishedCar& each : tests) {
    for (const PublishedHit& hit : each.hits) {
      if (++count <= most) out += (count > 1 ? ", " : "") + hit.test;
    }
  }
  return count > most ? out + " and " + std::to_string(count - most) + " more" : out;
}

void print_comparisons(const std::vector<PublishedCar>& tests, const std::vector<Comparison>& comparisons) {
  std::printf("%-24s %6s  %-36s %9s %9s %7s\n", "test", "km/h", "", "published", "ours", "off");
  for (const Comparison& each : comparisons) {
    const PublishedHit& hit = tests[each.car].hits[each.hit];
    const bool small = each.measured < 2;
    std::printf("%-24.24s %6.1f  %-36.36s %9.*f %9.*f %+6.1f%%\n", hit.test.c_str(), 3.6 * hit.speed, each.what.c_str(),
                small ? 3 : 1, each.measured, small ? 3 : 1, each.ours, 100 * (each.ours / each.measured - 1));
  }
}

void print_constants(const Fit& fit) {
  for (const FittedConstant& each : fit.constants)
    std::printf("%s: %.3f times the default (68 %%: %.3f to %.3f)%s\n", each.constant->name, each.factor,
                each.factor * std::exp(-each.deviation), each.factor * std::exp(each.deviation),
                each.determined ? "" : "; the tests hardly say it");
}

// What these tests leave open, one sentence a line.
void print_open(const std::vector<PublishedCar>& tests, const Fit& fit) {
  std::set<int> speeds;
  size_t hits = 0;
  bool rebound = false, pulse = false, derived = false;
  for (const PublishedCar& each : tests) {
    for (const PublishedHit& hit : each.hits) {
      speeds.insert(int(std::lround(3.6 * hit.speed / 5))), ++hits;
      rebound |= hit.restitution >= 0, pulse |= !hit.force.empty(), derived |= hit.derived;
    }
  }
  std::printf("What the tests do not say:\n");
  for (const FittedConstant& each : fit.constants) {
    if (!each.determined) std::printf("  %s (%s): other values fit as well.\n", each.constant->decides, each.constant->name);
  }
  for (const Constant& each : fit_constants().subspan(fit.constants.size()))
    std::printf("  %s (%s): it is the default's.\n", each.decides, each.name);
  if (speeds.size() < 2) std::printf("  The crush at other speeds: all hits have about the same speed.\n");
  if (!rebound) std::printf("  The rebound: add the column restitution.\n");
  if (!pulse) std::printf("  When the force acts: add a pulse.\n");
  if (derived) std::printf("  More than A and B do: they are a straight line through other people's tests.\n");
  std::printf("  Anything to better than 5 %%: that is how much two tests of the same car differ.\n");
  if (hits == 1) std::printf("  How typical the tested car was: this is one hit.\n");
}

std::string preset_of(const Fit& fit, const std::string& about) {
  std::string fields;
  for (const Range& range : parameter_ranges()) {
    const std::string name = range.name;
    // `friction` is not of the crush; the others are of `classic`.
    if (!range.of_region || name == "friction" || name == "distance_stiffness" || name == "volume_stiffness" ||
        name == "plasticity")
      continue;
    fields += (fields.empty() ? "" : ", ") + quoted(name) + ": " + number(double(range.value(fit.parameters, 0)), "%.5g");
  }
  return "{\n  \"about\": " + quoted(about) + ",\n  \"parameters\": [\n    {" + fields + "}\n  ]\n}\n";
}

std::string list_of(const auto& items, const auto& text) {
  std::string out;
  for (const auto& each : items) out += (out.empty() ? "" : ",") + text(each);
  return '[' + out + ']';
}

// What the picture shows (clients/python: crumple.fit_chart).
std::string chart_of(const std::vector<PublishedCar>& tests, const std::vector<std::vector<HitResult>>& results,
                     const std::string& title) {
  std::string hits;
  for (size_t k = 0; k < tests.size(); ++k) {
    for (size_t i = 0; i < tests[k].hits.size(); ++i) {
      const PublishedHit& hit = tests[k].hits[i];
      const HitResult& ours = results[k][i];
      const auto pulse = [&](double Instant::*value) {
        return list_of(ours.pulse, [&](const Instant& each) { return number(each.*value, "%.6g"); });
      };
      hits += (hits.empty() ? "" : ",\n") + ("{\"test\": " + quoted(hit.test)) + ", \"car\": " + std::to_string(k) +
              ", \"kmh\": " + number(3.6 * hit.speed) + ", \"crush\": " + number(hit.crush, "%.6g") +
              ", \"ours\": " + number(ours.crush, "%.6g") +
              ", \"published_force\": " + list_of(hit.force, [](double g) { return number(g, "%.6g"); }) +
              ", \"force_by_sixtieth\": " + list_of(ours.force_by_sixtieth(), [](double g) { return number(g, "%.6g"); }) +
              ", \"seconds\": " + pulse(&Instant::seconds) + ", \"force\": " + pulse(&Instant::force) +
              ", \"travel\": " + pulse(&Instant::travel) + "}";
    }
  }
  return "{\"title\": " + quoted(title) + ", \"hits\": [\n" + hits + "]}\n";
}

void draw(const std::string& chart, const std::string& picture) {
  constexpr char script[] = R"(
import sys
try:
    from crumple.fit_chart import main
except ImportError as error:
    sys.exit(f"{error}: run server/setup python_package, or `pip install clients/python[render]` where CRUMPLE_PYTHON is")
main()
)";
  const TemporaryFolder folder;
  const std::filesystem::path data = folder.path / "fit.json";
  write_array<char>(data, chart);
  std::string said;
  if (run_script(script, {data.string(), picture}, [&](const std::string& line) { said = line; }) != 0)
    throw std::runtime_error(picture + ": the preset is written, but not its picture: " + said);
}

void write_text(const std::string& file, const std::string& text) {
  FileWriter writer(file);
  writer.put(text);
  writer.finish();
}

}  // namespace

int fit_command(const FitCommandOptions& options) {
  const std::vector<PublishedCar> tests = read_tests(options.tests);
  const Cars cars = load_levels(options.cars);
  const bool terminal = isatty(STDERR_FILENO);
  const Fit found = fit(cars[0], tests, options.scale ? 1 : constants_for(tests), {}, [&](int hits) {
    if (terminal) std::fprintf(stderr, "\r%d hits computed\x1b[K", hits);
  });
  if (terminal) std::fprintf(stderr, "\r\x1b[K");
  std::printf("%s, %zu nodes; %d hits computed\n", cars[0]->name.c_str(), cars[0]->model.node.size(), found.runs);
  print_comparisons(tests, found.comparisons);
  std::printf("rms of ours / published - 1: %.1f %%\n", 100 * found.rms);
  print_constants(found);
  print_open(tests, found);
  for (size_t k = 1; k < cars.size(); ++k) {
    const std::vector<Comparison> finer = compare(tests, play_tests(cars[k], tests, found.parameters));
    double off = 0;
    for (size_t i = 0; i < finer.size(); ++i) {
      if (finer[i].what == "crush, mm") off = std::max(off, std::fabs(finer[i].ours / found.comparisons[i].ours - 1));
    }
    std::printf("checked on %s, %zu nodes: rms %.1f %%; no crush differs by over %.1f %% from that of %zu nodes\n",
                cars[k]->name.c_str(), cars[k]->model.node.size(), 100 * rms_of(finer), 100 * off, cars[0]->model.node.size());
  }
  const std::string about = options.about.empty() ? "Fitted to " + names_of(tests) + "." : options.about;
  write_text(options.output, preset_of(found, about));
  std::printf("%s: for `crumple drive --preset`, or a host's parameters\n", options.output.c_str());
  if (options.picture.empty()) return 0;
  constexpr double rate = 240;  // of the curves; the crush is that of 60
  draw(chart_of(tests, play_tests(cars[0], tests, found.parameters, rate), cars[0]->name + ": " + about), options.picture);
  return 0;
}

}  // namespace crumple

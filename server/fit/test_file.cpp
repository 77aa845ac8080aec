#include "fit/test_file.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <stdexcept>

#include "fit/crash_test.h"
#include "fit/csv.h"
#include "io/files.h"

namespace crumple {
namespace {

struct Column {
  const char* name;
  double low, high;  // both 0: text
  bool required;
  const char* meaning;
};
constexpr Column columns[] = {
    {"test", 0, 0, true, "name or number of the test"},
    {"car", 0, 0, false, "rows with the same word here are hits of one car, one after the other; empty: a new car"},
    {"mass_kg", 10, 100'000, true, "mass as tested"},
    {"length_mm", 500, 25'000, false, "length of the car; empty: as baked"},
    {"width_mm", 300, 10'000, false, "width of the car; empty: as baked"},
    {"speed_kmh", 1, 300, false, "speed into a rigid wall that covers the whole front"},
    {"damage_mm", 100, 10'000, false, "width over which C1 to C6 are equally spaced; empty: nine tenths of the car's width"},
    {"c1_mm", -500, 5'000, false, "residual crush at the left end"},
    {"c2_mm", -500, 5'000, false, ""},
    {"c3_mm", -500, 5'000, false, ""},
    {"c4_mm", -500, 5'000, false, ""},
    {"c5_mm", -500, 5'000, false, ""},
    {"c6_mm", -500, 5'000, false, "residual crush at the right end"},
    {"crush_mm", 5, 5'000, false, "mean of c1_mm to c6_mm (both ends count half), instead of these"},
    {"travel_mm", 5, 10'000, false, "longest way of the car after contact (dynamic crush)"},
    {"restitution", 0, 1, false, "speed of the rebound / speed before"},
    {"pulse", 0, 0, false, "file in the same folder with the columns t_s and F_barrier_kN"},
    {"A_kN_m", 0, 2'000, false, "linear model, force / width = A + B crush, instead of a speed and a crush"},
    {"B_kN_m2", 10, 100'000, false, ""},
};

[[noreturn]] void refuse(const std::string& name, size_t line, const std::string& fact) {
  throw std::runtime_error(name + ":" + std::to_string(line) + ": " + fact + ".");
}

// In a sentence: only letters that can be read, and not too many.
std::string shown(const std::string& text) {
  std::string out;
  for (const char c : text.substr(0, 40)) out += c >= ' ' && c < 127 ? c : '?';
  return '"' + out + (text.size() > 40 ? "...\"" : "\"");
}

std::string short_number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", value);
  return text;
}

double number_in(const std::string& text, const Column& column, const std::string& name, size_t line) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc{} || end != text.data() + text.size() || !(value >= column.low && value <= column.high))
    refuse(name, line,
           std::string(column.name) + " is " + shown(text) + "; give a number from " + short_number(column.low) + " to " +
               short_number(column.high) + ", with a point for decimals");
  return value;
}

// Column -> its place in a row. Throws if a required one is missing, or one is there twice.
std::map<std::string, size_t> header_of(const std::vector<CsvRow>& rows, const std::string& name) {
  if (rows.empty()) refuse(name, 1, "it is empty; its first row names the columns, as `crumple fit --help` shows");
  std::map<std::string, size_t> out;
  for (size_t k = 0; k < rows[0].field.size(); ++k) {
    if (!out.emplace(rows[0].field[k], k).second)
      refuse(name, rows[0].line, "the column " + shown(rows[0].field[k]) + " is there twice; remove one");
  }
  return out;
}

const Column& column_of(const char* name) {
  return *std::find_if(std::begin(columns), std::end(columns),
                       [&](const Column& c) { return std::string_view(c.name) == name; });
}

// The cells of one row by column.
struct Cells {
  const std::map<std::string, size_t>& header;
  const CsvRow& row;
  const std::string& name;

  std::string text(const char* column) const {
    const auto at = header.find(column);
    return at == header.end() ? "" : row.field[at->second];
  }
  bool has(const char* column) const { return !text(column).empty(); }
  // 0 if it is empty.
  double number(const char* column) const {
    return has(column) ? number_in(text(column), column_of(column), name, row.line) : 0;
  }
};

double crush_of(const Cells& row) {
  constexpr const char* stations[] = {"c1_mm", "c2_mm", "c3_mm", "c4_mm", "c5_mm", "c6_mm"};
  const auto given = std::count_if(std::begin(stations), std::end(stations), [&](const char* c) { return row.has(c); });
  if (given == 0) return row.number("crush_mm") / 1000;
  if (given < 6) refuse(row.name, row.row.line, "some of c1_mm to c6_mm are empty; give all six, or their mean as crush_mm");
  if (row.has("crush_mm")) refuse(row.name, row.row.line, "it gives c1_mm to c6_mm and crush_mm; remove one of them");
  Profile profile;
  for (size_t k = 0; k < 6; ++k) profile[k] = row.number(stations[k]) / 1000;
  const double mean = mean_crush(profile);
  if (mean < 0.005)
    refuse(row.name, row.row.line, "the mean of c1_mm to c6_mm is below 5 mm; leave out hits that leave no crush");
  return mean;
}

// Hits of new cars that crush as the linear model says. Crush energy over width = B / 2 (C + A / B)^2.
std::vector<PublishedCar> from_linear_model(const Cells& row, const Measures& measures) {
  const double a = 1000 * row.number("A_kN_m"), b = 1000 * row.number("B_kN_m2");
  for (const char* other : {"speed_kmh", "c1_mm", "crush_mm", "travel_mm", "restitution", "pulse", "car"}) {
    if (row.has(other))
      refuse(row.name, row.row.line, std::string("it gives A_kN_m and ") + other + "; A and B stand alone: use a row for each");
  }
  if (!row.has("A_kN_m") || !row.has("B_kN_m2")) refuse(row.name, row.row.line, "A_kN_m and B_kN_m2 come together; give both");
  if (measures.width == 0) refuse(row.name, row.row.line, "A and B are forces over width; give width_mm");
  std::vector<PublishedCar> out;
  for (const double kmh : {24.0, 40.0, 56.0}) {
    const double speed = kmh / 3.6, crush = std::sqrt(measures.mass * speed * speed / (measures.width * b)) - a / b;
    if (crush < 0.02) continue;
    PublishedHit hit;
    hit.test = row.text("test") + " at " + short_number(kmh) + " km/h";
    hit.mass = measures.mass, hit.speed = speed, hit.crush = crush, hit.derived = true;
    out.push_back({measures, {hit}});
  }
  if (out.empty())
    refuse(row.name, row.row.line, "with these A and B nothing is crushed at 56 km/h; check their units: kN/m and kN/m^2");
  return out;
}

PublishedHit hit_of(const Cells& row, const std::filesystem::path& folder) {
  PublishedHit hit;
  hit.test = row.text("test");
  hit.mass = row.number("mass_kg");
  hit.speed = row.number("speed_kmh") / 3.6;
  if (hit.speed == 0) refuse(row.name, row.row.line, "speed_kmh is empty; give it, or A_kN_m and B_kN_m2 instead");
  hit.damaged_width = row.number("damage_mm") / 1000;
  hit.crush = crush_of(row);
  hit.travel = row.number("travel_mm") / 1000;
  if (row.has("restitution")) hit.restitution = row.number("restitution");
  if (row.has("pulse")) {
    const std::filesystem::path file = folder / row.text("pulse");
    try {
      hit.force = parse_pulse(read_file(file, text_limit, "name a file beside the table of tests"), file.string(), hit.mass);
    } catch (const std::runtime_error& refused) {
      throw std::runtime_error(row.name + ":" + std::to_string(row.row.line) + ": pulse: " + refused.what());
    }
  }
  if (hit.crush == 0 && hit.travel == 0 && hit.force.empty())
    refuse(row.name, row.row.line, "it says nothing of the crush; give c1_mm to c6_mm, crush_mm, travel_mm or pulse");
  return hit;
}

}  // namespace

std::vector<double> parse_pulse(std::string_view text, const std::string& name, double mass) {
  constexpr Column time{"t_s", -10, 100, true, ""}, barrier{"F_barrier_kN", -100, 20'000, true, ""};
  const std::vector<CsvRow> rows = parse_csv(text, name, most_samples + 1);
  const auto header = header_of(rows, name);
  for (const Column& column : {time, barrier}) {
    if (!header.contains(column.name))
      refuse(name, rows[0].line, std::string("it has no column ") + column.name + "; name the columns t_s and F_barrier_kN");
  }
  std::vector<double> sum, seconds;
  double before = -1e9, last = 0;
  for (size_t k = 1; k < rows.size(); ++k) {
    if (rows[k].field.size() != rows[0].field.size())
      refuse(name, rows[k].line,
             "it has " + std::to_string(rows[k].field.size()) + " fields and the first row " +
                 std::to_string(rows[0].field.size()) + "; give each row the same");
    const double now = number_in(rows[k].field[header.at("t_s")], time, name, rows[k].line);
    const double force = number_in(rows[k].field[header.at("F_barrier_kN")], barrier, name, rows[k].line);
    if (!(now > before)) refuse(name, rows[k].line, "t_s does not rise; sort the rows by time, each time once");
    // The trapezoid between two samples belongs to the sixtieth of its middle.
    const double middle = 0.5 * (now + before);
    if (k > 1 && middle >= 0 && middle < most_pulse_seconds) {
      const auto slot = size_t(60 * middle);
      if (slot >= sum.size()) sum.resize(slot + 1), seconds.resize(slot + 1);
      sum[slot] += (now - before) * 0.5 * (force + last) * 1000 / mass;
      seconds[slot] += now - before;
    }
    before = now, last = force;
  }
  for (size_t k = 0; k < sum.size(); ++k) sum[k] /= std::max(seconds[k], 1e-9);
  if (sum.size() < 3) refuse(name, rows.back().line, "it ends within 50 ms of time 0; time 0 is first contact, in seconds");
  // Only whole sixtieths, and only as long as the barrier is pushed: after that a test's channels drift.
  if (seconds.back() < 0.9 / 60) sum.pop_back();
  const double most = *std::max_element(sum.begin(), sum.end());
  if (!(most > 0))
    refuse(name, rows.back().line, "F_barrier_kN is never above 0; give the barrier's force on the car as positive");
  while (sum.size() > 1 && sum.back() < 0.2 * most) sum.pop_back();
  return sum;
}

std::vector<PublishedCar> parse_tests(std::string_view text, const std::string& name, const std::filesystem::path& folder) {
  const std::vector<CsvRow> rows = parse_csv(text, name, most_tests + 1);
  const auto header = header_of(rows, name);
  for (const auto& [given, at] : header) {
    if (std::none_of(std::begin(columns), std::end(columns), [&name = given](const Column& c) { return name == c.name; }))
      refuse(name, rows[0].line, "there is no column " + shown(given) + "; `crumple fit --help` lists them");
  }
  for (const Column& column : columns) {
    if (column.required && !header.contains(column.name))
      refuse(name, rows[0].line, std::string("the column ") + column.name + " is missing; add it to the first row");
  }
  if (rows.size() < 2) refuse(name, rows[0].line, "it has no test; add a row for each");
  std::vector<PublishedCar> out;
  std::map<std::string, size_t> known;  // word of the column car -> its place in `out`
  for (size_t k = 1; k < rows.size(); ++k) {
    if (rows[k].field.size() != rows[0].field.size())
      refuse(name, rows[k].line,
             "it has " + std::to_string(rows[k].field.size()) + " fields and the first row " +
                 std::to_string(rows[0].field.size()) + "; give each row the same");
    const Cells row{header, rows[k], name};
    for (const Column& column : columns) {
      if (column.required && !row.has(column.name)) refuse(name, row.row.line, std::string(column.name) + " is empty; give it");
    }
    const Measures measures{row.number("length_mm") / 1000, row.number("width_mm") / 1000, row.number("mass_kg")};
    if (row.has("A_kN_m") || row.has("B_kN_m2")) {
      for (PublishedCar& car : from_linear_model(row, measures)) out.push_back(std::move(car));
      continue;
    }
    const PublishedHit hit = hit_of(row, folder);
    const std::string word = row.text("car");
    const auto [at, fresh] = word.empty() ? std::pair(known.end(), true) : known.emplace(word, out.size());
    if (fresh) {
      out.push_back({measures, {hit}});
      continue;
    }
    PublishedCar& car = out[at->second];
    if (car.measures.length != measures.length || car.measures.width != measures.width)
      refuse(name, row.row.line,
             "length_mm or width_mm differs from the first hit of the car " + shown(word) + "; give the same");
    if (hit.crush > 0 && hit.crush < car.hits.back().crush)
      refuse(name, row.row.line,
             "its crush is less than after the hit before; crush of a car that is hit again counts from the undamaged car");
    car.hits.push_back(hit);
  }
  return out;
}

std::vector<PublishedCar> read_tests(const std::filesystem::path& file) {
  return parse_tests(read_file(file, text_limit, "give a CSV file of tests, as `crumple fit --help` shows"), file.string(),
                     file.parent_path());
}

std::string explain_columns() {
  std::string out;
  for (const Column& column : columns) {
    char line[200];
    if (column.low == column.high)
      std::snprintf(line, sizeof line, "  %-12s %s%s\n", column.name, column.meaning, column.required ? " (always)" : "");
    else
      std::snprintf(line, sizeof line, "  %-12s %s%s%g to %g%s\n", column.name, column.meaning, *column.meaning ? "; " : "",
                    column.low, column.high, column.required ? " (always)" : "");
    out += line;
  }
  return out;
}

}  // namespace crumple

// Fuzzes the tables of published crash tests that people write for `crumple fit`, and the pulses beside them.
#include <cmath>
#include <filesystem>
#include <stdexcept>

#include "fit/test_file.h"
#include "fuzz/entries.h"
#include "paths.h"

namespace crumple::fuzz {

// The table may name itself as a pulse, so both readers are reached.
bool crash_tests_run(Input input) {
  const MemoryFile file(input);
  try {
    const std::vector<PublishedCar> tests = read_tests(file.path());
    expect(!tests.empty() && tests.size() <= 3 * most_tests, "a table has a test, and no more than it may have");
    for (const PublishedCar& car : tests) {
      expect(!car.hits.empty(), "a car has a hit");
      for (const PublishedHit& hit : car.hits) {
        expect(hit.mass >= 10 && hit.speed > 0.2 && hit.crush >= 0 && hit.crush < 100, "numbers are in their ranges");
        expect(hit.crush > 0 || hit.travel > 0 || !hit.force.empty(), "a hit says something of the crush");
        for (const double force : hit.force) expect(std::isfinite(force), "forces are finite");
      }
    }
    return true;
  } catch (const std::runtime_error& refused) {
    const std::string_view sentence = refused.what();
    saw(sentence.substr(std::min(sentence.size(), file.path().size())));
    return false;
  }
}

std::vector<std::vector<uint8_t>> crash_tests_seeds() {
  std::vector<std::vector<uint8_t>> seeds;
  for (const char* folder : {"bench/crash_tests", "clients/presets/classes"}) {
    for (const auto& file : std::filesystem::directory_iterator(in_repository(folder))) {
      const std::string name = file.path().filename();
      // The Camry's table names a pulse beside it, which a file in memory has not.
      if (name.ends_with(".csv") && !name.starts_with("camry")) seeds.push_back(bytes_of_file(file.path()));
    }
  }
  const std::string_view linear = "test,mass_kg,width_mm,A_kN_m,B_kN_m2,speed_kmh\n\"median, of many\",1500,1800,64,769,\n";
  seeds.emplace_back(linear.begin(), linear.end());
  return seeds;
}

}  // namespace crumple::fuzz

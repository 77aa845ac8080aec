// Runs every entry of tests/fuzz with the inputs in the corpus and with the good inputs. So every build tests again the errors
// that libFuzzer once found.
#include <gtest/gtest.h>

#include <cstdio>
#include <filesystem>
#include <ostream>

#include "fuzz/entries.h"
#include "paths.h"

namespace crumple::fuzz {

void PrintTo(const Entry& entry, std::ostream* out) { *out << entry.name; }

namespace {

class Fuzz : public testing::TestWithParam<Entry> {};

// Whether nothing of it was refused.
bool run(const Entry& entry, Input input, const std::string& name) {
  SCOPED_TRACE(name);
  std::fprintf(stderr, "%s\n", name.c_str());  // in case the entry ends the program
  testing::internal::CaptureStdout();
  std::string broken;
  bool taken = false;
  try {
    taken = entry.run(input);
  } catch (const Broken& what) {
    broken = what.promise;
  }
  testing::internal::GetCapturedStdout();
  EXPECT_EQ(broken, "");
  return taken;
}

// The good inputs must reach the code that each entry tests.
TEST_P(Fuzz, BeginsWithGoodInputs) {
  const auto seeds = GetParam().seeds();
  EXPECT_FALSE(seeds.empty());
  for (size_t i = 0; i < seeds.size(); ++i) EXPECT_TRUE(run(GetParam(), seeds[i], "seed")) << i;
}

TEST_P(Fuzz, EveryKeptInputEndsWell) {
  const auto folder = in_repository("tests/fuzz/corpus/" + std::string(GetParam().name));
  size_t kept = 0;
  for (const auto& file : std::filesystem::directory_iterator(folder)) {
    run(GetParam(), bytes_of_file(file.path()), file.path());
    ++kept;
  }
  EXPECT_GT(kept, 0u) << folder;
}

std::string name_of(const testing::TestParamInfo<Entry>& entry) { return entry.param.name; }
INSTANTIATE_TEST_SUITE_P(Entry, Fuzz, testing::ValuesIn(entries().begin(), entries().end()), name_of);

}  // namespace
}  // namespace crumple::fuzz

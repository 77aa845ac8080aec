// The inputs that fuzzing has kept, and the good ones that it begins with, through every entry (tests/fuzz). What clang's
// libFuzzer found once is so guarded by every build.
#include <gtest/gtest.h>

#include <cstdio>
#include <filesystem>
#include <ostream>

#include "fuzz/entries.h"

namespace crumple::fuzz {

void PrintTo(const Entry& entry, std::ostream* out) { *out << entry.name; }

namespace {

class Fuzz : public testing::TestWithParam<Entry> {};

// Whether nothing of it was refused.
bool run(const Entry& entry, Input input, const std::string& name) {
  SCOPED_TRACE(name);
  std::fprintf(stderr, "%s\n", name.c_str());  // should it end the program
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

// What fuzzing begins with reaches what it is for.
TEST_P(Fuzz, BeginsWithGoodInputs) {
  const auto seeds = GetParam().seeds();
  EXPECT_FALSE(seeds.empty());
  for (size_t i = 0; i < seeds.size(); ++i) EXPECT_TRUE(run(GetParam(), seeds[i], "seed")) << i;
}

TEST_P(Fuzz, EveryKeptInputEndsWell) {
  const auto folder = std::filesystem::path(CRUMPLE_SOURCE_DIR) / "tests/fuzz/corpus" / GetParam().name;
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

// Replay: each recording that comes with the project gives its hashes again, at any thread count.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>

namespace {

namespace fs = std::filesystem;

TEST(Recordings, GiveEveryTickAgainAt1And2And4Threads) {
  int files = 0;
  for (const auto& entry : fs::directory_iterator(fs::path(CRUMPLE_SOURCE_DIR) / "recordings")) {
    if (entry.path().extension() != ".mcap") continue;
    ++files;
    EXPECT_LT(fs::file_size(entry.path()), 1'000'000u) << entry.path();
    for (const char* threads : {"1", "2", "4"}) {
      const std::string command =
          std::string(CRUMPLE_PROGRAM) + " replay " + entry.path().string() + " --verify --threads " + threads + " > /dev/null";
      EXPECT_EQ(std::system(command.c_str()), 0) << command;
    }
  }
  EXPECT_GE(files, 3);
}

}  // namespace

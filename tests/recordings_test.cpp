// Replay: each recording that comes with the project gives its hashes again, at any thread count.
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>

namespace {

namespace fs = std::filesystem;

#if defined(__SANITIZE_ADDRESS__)  // fifteen times slower: once is enough to see a fault in memory
constexpr const char* thread_counts[] = {"2"};
constexpr const char* only = "built_in_pole";
#else
constexpr const char* thread_counts[] = {"1", "2", "4"};
constexpr const char* only = "";
#endif

TEST(Recordings, GiveEveryTickAgainAt1And2And4Threads) {
  int files = 0;
  for (const auto& entry : fs::directory_iterator(fs::path(CRUMPLE_SOURCE_DIR) / "recordings")) {
    if (entry.path().extension() != ".mcap") continue;
    ++files;
    EXPECT_LT(fs::file_size(entry.path()), 1'000'000u) << entry.path();
    if (entry.path().string().find(only) == std::string::npos) continue;
    for (const char* threads : thread_counts) {
      const std::string command =
          std::string(CRUMPLE_PROGRAM) + " replay " + entry.path().string() + " --verify --threads " + threads + " > /dev/null";
      EXPECT_EQ(std::system(command.c_str()), 0) << command;
    }
  }
  EXPECT_GE(files, 3);
}

}  // namespace

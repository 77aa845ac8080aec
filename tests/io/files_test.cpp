// Tests paths that are no regular files, files that never end or that change while they are used, and full disks: each gives an
// error sentence and leaves nothing half done.
#include "io/files.h"

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <csignal>
#include <set>
#include <thread>

#include "bake/bake.h"
#include "bake/load_car.h"
#include "box_car.h"
#include "io/obj.h"
#include "paths.h"
#include "program.h"
#include "protocol/asset.h"
#include "recording/gltf.h"
#include "refusal.h"

namespace crumple {
namespace {

// While this object lives, no file of this process and its children grows beyond 1 KiB.
struct FullDisk {
  rlimit before{};
  sighandler_t handler = std::signal(SIGXFSZ, SIG_IGN);
  FullDisk() {
    getrlimit(RLIMIT_FSIZE, &before);
    const rlimit little{1024, before.rlim_max};
    setrlimit(RLIMIT_FSIZE, &little);
  }
  ~FullDisk() {
    setrlimit(RLIMIT_FSIZE, &before);
    std::signal(SIGXFSZ, handler);
  }
};

std::set<std::string> names_in(const std::filesystem::path& folder) {
  std::set<std::string> names;
  for (const auto& file : std::filesystem::directory_iterator(folder)) names.insert(file.path().filename());
  return names;
}

TEST(Files, ACarStaysWhatItWasWhenItsFileIsCutOrWrittenOver) {
  const Files files;
  const auto path = files.folder.path / "live.car";
  write_car(*box_car(), path);
  const auto car = load_car(path);
  std::ofstream(path, std::ios::trunc | std::ios::binary) << "another";
  const auto again = read_car(car->bytes, "again");
  EXPECT_EQ(again->hash, car->hash);
  EXPECT_EQ(again->hash, box_car()->hash);
}

TEST(Files, OfALargerFileThanThereIsRoomForNothingIsTaken) {
  const Files files;
  const auto path = files.write("text", std::string(1000, 'x'));
  EXPECT_EQ(read_file(path, 1000, "no").size(), 1000u);
  expect_sentence(refusal([&] { (void)read_file(path, 999, "make it smaller"); }), "text", "larger than the 999 bytes");
  EXPECT_EQ(read_file("/proc/self/stat", 100'000, "no").empty(), false);  // claims to have 0 bytes
  expect_sentence(refusal([&] { (void)read_file("/proc/self/stat", 3, "make it smaller"); }), "stat",
                  "larger than the 3 bytes");
  std::filesystem::resize_file(files.write("large.car", ""), asset_limit + 1);
  expect_sentence(refusal([&] { (void)load_car(files.folder.path / "large.car"); }), "large.car", "larger than the 256 MiB");
}

TEST(Files, ADiskWithoutRoomIsSaidAndNothingIsLeftOnIt) {
  const Files files;
  const auto path = files.write("old.car", "as it was");
  const auto car = box_car();
  const Model& model = car->model;
  const std::vector<float> rest(300);
  const std::vector<uint32_t> triangle(300);
  Animation film;
  film.vertex = model.vertex;
  film.triangle = model.triangle;
  film.keys.push_back({0, {}, 0});
  std::vector<std::string> said;
  {
    const FullDisk disk;
    said.push_back(refusal([&] { write_car(*box_car({6, 3, 2}), path); }));
    said.push_back(refusal([&] { write_obj(files.folder.path / "old.obj", "", "", 0, rest, rest, triangle); }));
    said.push_back(refusal([&] { write_glb(files.folder.path / "old.glb", film); }));
  }
  for (const std::string& sentence : said) expect_sentence(sentence, "/old.", "File too large");
  EXPECT_EQ(names_in(files.folder.path), std::set<std::string>{"old.car"});
  EXPECT_EQ(read_file(path, 100, "no"), "as it was");
}

TEST(Files, ADeviceIsWrittenToAndStays) {
  const Files files;
  const auto full = files.folder.path / "full";
  std::filesystem::create_symlink("/dev/full", full);  // a link, so that replacing it does no harm
  expect_sentence(refusal([&] { write_car(*box_car(), full); }), "full", "No space left on device");
  EXPECT_EQ(names_in(files.folder.path), std::set<std::string>{"full"});
  EXPECT_TRUE(std::filesystem::is_symlink(full));
}

class FilesOfVerbs : public Program {
 protected:
  // Returns exit code and output. A verb that waits for ever is killed.
  static Outcome ended(std::vector<std::string> arguments) {
    Process process(std::move(arguments));
    if (!process.read_until("\n")) process.send(SIGKILL);
    const int code = process.wait();
    return {code, process.text};
  }
};

TEST_F(FilesOfVerbs, EveryVerbRefusesWhatIsNoFileOrIsTooLarge) {
  const std::string car = car_file.string(), out = path("out"), scene = in_repository("clients/scenes/pole.json");
  ASSERT_EQ(mkfifo(path("pipe").c_str(), 0600), 0);
  std::filesystem::create_directory(path("dir"));
  std::filesystem::resize_file(write("vast", ""), uintmax_t{100} << 30);
  for (const std::string& bad : {path("pipe"), path("dir"), path("vast"), std::string("/dev/zero")}) {
    const std::vector<std::vector<std::string>> all = {
        {"serve", "--car", bad, "--check-config"},
        {"serve", "--car", car, "--network", bad, "--check-config"},
        {"serve", "--car", car, "--config", bad, "--check-config"},
        {"drive", bad, "--car", car},
        {"drive", scene, "--preset", bad, "--car", car},
        {"watch", "--network", bad},
        {"bake", car, "--regions", bad, "-o", out},
        {"bake", bad, "-o", out},
        {"map", car, bad},
        {"map", bad, scene},
        {"info", bad},
        {"export", bad, "-o", out},
        {"recover", bad, "-o", out},
        {"replay", bad, "--verify"},
    };
    for (const auto& arguments : all) {
      std::string line;
      for (const auto& argument : arguments) line += argument + " ";
      const Outcome outcome = ended(arguments);
      EXPECT_TRUE(outcome.code == 1 || outcome.code == 2) << line << outcome.code << "\n" << outcome.text;
      EXPECT_TRUE(contains(outcome.text, bad)) << line << "\n" << outcome.text;
    }
  }
}

TEST_F(FilesOfVerbs, AnExportOrARecoveryThatFindsNoRoomLeavesNoFile) {
  const std::string recording = in_repository("recordings/built_in_pole.mcap");
  std::vector<Outcome> outcomes;
  {
    const FullDisk disk;
    outcomes.push_back(ended({"recover", recording, "-o", path("whole.mcap")}));
    outcomes.push_back(ended({"export", recording, "-o", path("films")}));
  }
  for (const Outcome& outcome : outcomes) {
    EXPECT_EQ(outcome.code, 1) << outcome.text;
    EXPECT_TRUE(contains(outcome.text, "File too large")) << outcome.text;
  }
  EXPECT_FALSE(std::filesystem::exists(path("whole.mcap")));
  EXPECT_EQ(names_in(path("films")), std::set<std::string>{});
}

// The writer of the pipe may be broken and never end.
TEST(Files, APipeIsReadToItsEndOrItsBound) {
  for (const size_t most : {size_t{300'000}, size_t{299'999}, size_t{0}}) {
    int ends[2];
    ASSERT_EQ(pipe(ends), 0);
    std::thread writer([to = ends[1]] {
      const std::string text(300'000, 'x');
      EXPECT_GT(write(to, text.data(), text.size()), 0);
      close(to);
    });
    const auto read = read_pipe(ends[0], most);
    EXPECT_EQ(read.has_value(), most == 300'000) << most;
    EXPECT_EQ(read.value_or(std::string(300'000, 'x')), std::string(300'000, 'x'));
    EXPECT_TRUE(read_pipe(ends[0], 1'000'000)) << "the writer ends";
    writer.join();
    close(ends[0]);
  }
}

}  // namespace
}  // namespace crumple

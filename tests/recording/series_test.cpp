// Tests long recordings: with cars that come and go for ever the server's memory stays flat, and nothing is lost. Ticks are
// real, but the test's own clock drives them. The program verifies their files.
#include "recording/series.h"

#include <gtest/gtest.h>
#include <malloc.h>

#include <filesystem>
#include <fstream>
#include <random>
#include <set>

#include "box_car.h"
#include "host.h"
#include "program.h"
#include "tick/hash.h"
#include "tick/levels.h"

namespace crumple {
namespace {

namespace fs = std::filesystem;

struct Told {
  std::set<std::string> keys;
  uint64_t first_tick = 0, last_tick = 0, messages = 0;
};

Told read(const std::string& path) {
  Told told;
  RecordingReader file(path);
  EXPECT_FALSE(file.cut()) << path;
  for (RecordingReader::Item item; file.next(item); ++told.messages) {
    told.keys.emplace(item.key);
    if (item.channel != Channel::tick_end) continue;
    if (told.first_tick == 0) told.first_tick = item.tick;
    told.last_tick = item.tick;
  }
  return told;
}

// Returns false at the deadline.
bool until(const std::function<bool()>& condition) {
  for (const auto deadline = Clock::now() + patience; !condition();) {
    if (Clock::now() > deadline) return false;
    std::this_thread::yield();
  }
  return true;
}

class LongRun : public testing::Test {
 protected:
  void SetUp() override {
    char name[] = "/tmp/crumple_test_XXXXXX";
    folder = mkdtemp(name);
  }
  void TearDown() override { fs::remove_all(folder); }
  std::string path(const std::string& name) const { return (folder / name).string(); }

  fs::path folder;
};

// A world with one kind of car and ticks of 20 us.
struct Scene {
  std::shared_ptr<const Car> car = box_car({2, 1, 1});
  WorldHandle world = make_world(60, 0.0005f);
  LatestInputs latest;
  Outbox outbox;
  Scene() { add_asset(*world, car); }

  SeriesOptions options(const std::string& pattern) const {
    SeriesOptions options;
    options.pattern = pattern;
    options.head.scene = "main";
    options.head.cars = {car};
    return options;
  }
  Message spawn(const std::string& id) const { return {"car/" + id, host::spawn(car->hash, "tester"), 1}; }
  void tick(Series& series, const Inbox& inbox) {
    const uint64_t number = tick_count(*world) + 1, time = 1'000'000'000 + number * 16'666'667;
    for (const Message& message : inbox) series.input(number, message, time);
    crumple::tick(*world, inbox, outbox, 1);
    for (const Message& message : outbox) series.output(number, message, time);
    series.end_tick(number, hash(*world), time);
  }
};

// Call this between two ticks. The work of threads on the disk takes no time on the test's clock.
void go_on(Series& series, Series::Clock::time_point now) {
  series.go_on(now);
  EXPECT_TRUE(until([&] { return !series.is_opening(); }));
  series.go_on(now);
}

using Seconds = std::chrono::duration<double>;
Series::Clock::time_point at(double seconds) {
  return Series::Clock::time_point(std::chrono::duration_cast<Series::Clock::duration>(Seconds(seconds)));
}

TEST_F(LongRun, CarsThatAreNeverNamedAgainFillNeitherTheMemoryNorAFileAndNothingIsLost) {
  constexpr int cars = 70'000, at_once = 8;
  const std::string foreign = path("many-2.mcap");
  std::ofstream(foreign) << "somebody else's";
  Scene scene;
  std::vector<std::string> told, files;
  SeriesOptions options = scene.options(path("many.mcap"));
  options.shortest = std::chrono::seconds(0);
  options.tell = [&](const std::string& sentence) { told.push_back(sentence); };
  auto series = std::make_unique<Series>(options, *scene.world, scene.latest);
  series->begin(at(0));
  files.push_back(series->file());
  std::vector<size_t> memory;  // bytes, when a file has just begun
  for (int next = 0; next < cars; next += at_once) {
    Inbox inbox;
    for (int k = 0; k < at_once; ++k) {
      inbox.push_back(scene.spawn("c" + std::to_string(next + k)));
      if (next > 0) inbox.push_back({"car/c" + std::to_string(next + k - at_once), host::despawn(), 1});
    }
    scene.tick(*series, inbox);
    go_on(*series, at(double(tick_count(*scene.world)) / 60));
    if (series->file() == files.back()) continue;
    // The clock of this test runs faster than any disk.
    ASSERT_TRUE(until([&] { return !series->is_closing(); })) << files.back();
    files.push_back(series->file());
    memory.push_back(mallinfo2().uordblks);
  }
  EXPECT_EQ(series->lost(), 0u);
  EXPECT_TRUE(series->close());
  series.reset();
  EXPECT_EQ(told, std::vector<std::string>{});
  ASSERT_GE(files.size(), 4u);
  EXPECT_EQ(files[1], path("many-3.mcap"));
  std::string untouched;
  std::getline(std::ifstream(foreign), untouched);
  EXPECT_EQ(untouched, "somebody else's");
  EXPECT_LT(memory.back(), memory.front() + (size_t{4} << 20)) << memory.front();
  uint64_t last = 0;
  std::set<std::string> all;
  for (const std::string& file : files) {
    const Told in = read(file);
    EXPECT_EQ(in.first_tick, last + 1) << file;
    last = in.last_tick;
    EXPECT_LE(in.keys.size(), RecordingBounds{}.next_channels + 8 * at_once) << file;
    for (const std::string& key : in.keys)
      if (key.ends_with("/answer")) all.insert(key);
    const Outcome verified = run({"replay", file, "--verify"});
    EXPECT_EQ(verified.code, 0) << verified.text;
    EXPECT_NE(verified.text.find("every tick identical"), std::string::npos) << verified.text;
  }
  EXPECT_EQ(last, tick_count(*scene.world));
  EXPECT_EQ(all.size(), size_t{cars});
}

TEST_F(LongRun, FilesTogetherTakeNoMoreOfTheDiskThanTheyMayAndTheOldestGo) {
  constexpr uint64_t most = 1'000'000;  // bytes
  const std::string foreign = path("kept-2.mcap"), pattern = path("kept.mcap");
  std::ofstream(foreign) << "somebody else's";
  Scene scene;
  SeriesOptions options = scene.options(pattern);
  options.shortest = std::chrono::seconds(0);
  options.most = most;
  std::vector<std::string> told, files;
  options.tell = [&](const std::string& sentence) { told.push_back(sentence); };
  Series series(options, *scene.world, scene.latest);
  series.begin(at(0));
  std::mt19937 random(1);
  for (int k = 0; k < 300; ++k) {
    Bytes noise(10'000);
    for (std::byte& each : noise) each = std::byte(random());
    scene.tick(series, {{"host/none/poses", noise}});
    go_on(series, at(k));
    ASSERT_TRUE(until([&] { return !series.is_closing(); }));
    if (files.empty() || series.file() != files.back()) files.push_back(series.file());
    uint64_t bytes = 0;
    for (const auto& entry : fs::directory_iterator(folder)) bytes += fs::file_size(entry);
    EXPECT_LE(bytes, most) << k;
  }
  scene.tick(series, {});
  EXPECT_TRUE(series.close());
  EXPECT_EQ(told, std::vector<std::string>{});
  ASSERT_GE(files.size(), 10u);
  EXPECT_FALSE(fs::exists(files.front()));
  EXPECT_TRUE(fs::exists(foreign));
  size_t left = 0;
  for (const std::string& file : files) {
    if (!fs::exists(file)) continue;
    const Outcome verified = run({"replay", file, "--verify"});
    EXPECT_EQ(verified.code, 0) << verified.text;
    ++left;
  }
  EXPECT_GE(left, 3u);
}

TEST_F(LongRun, AFileWhoseIndexHasComeToItsBoundIsFollowedByAnother) {
  Scene scene;
  SeriesOptions options = scene.options(path("%Y-long.mcap"));
  options.bounds.next_index = 20'000;
  Series series(options, *scene.world, scene.latest);
  series.begin(at(0));
  const std::string first = series.file();
  scene.tick(series, {scene.spawn("car")});
  // Three inputs fill a chunk.
  for (int k = 0; k < 200; ++k) {
    scene.tick(series, {{"host/none/poses", Bytes(100'000)}});
    go_on(series, at(9.9));
  }
  EXPECT_EQ(series.file(), first) << "it lasts ten seconds at least";
  ASSERT_TRUE(until([&] {  // the recorder has written enough to make its index too long
    go_on(series, at(10));
    return series.file() != first;
  }));
  const uint64_t ticks = tick_count(*scene.world);
  scene.tick(series, {});
  EXPECT_TRUE(series.close());
  EXPECT_EQ(read(first).last_tick, ticks);
  const Told next = read(series.file());
  EXPECT_EQ(next.first_tick, ticks + 1);
  EXPECT_TRUE(next.keys.contains("car/car/key/0")) << "who opens it sees the car";
}

TEST_F(LongRun, WhereThereCanBeNoOtherFileWhatIsLostIsCountedWithItsReason) {
  Scene scene;
  fs::create_directory(path("gone"));
  SeriesOptions options = scene.options(path("gone/full.mcap"));
  options.bounds.next_channels = 10;
  options.bounds.most_channels = 20;
  options.shortest = std::chrono::seconds(0);
  std::vector<std::string> told;
  options.tell = [&](const std::string& sentence) { told.push_back(sentence); };
  Series series(options, *scene.world, scene.latest);
  series.begin(at(0));
  fs::rename(path("gone"), path("kept"));
  for (int k = 0; k < 10; ++k) {
    scene.tick(series, {scene.spawn("car" + std::to_string(k))});  // a car with six keys
    go_on(series, at(k));
    series.tell();
  }
  EXPECT_GT(series.lost(), 0u);
  EXPECT_FALSE(series.close());
  const auto with = [&](const char* part) {
    return std::count_if(told.begin(), told.end(), [&](const std::string& each) { return each.find(part) != each.npos; });
  };
  EXPECT_GE(with("goes on in "), 1);
  EXPECT_EQ(with("loses messages: cars and hosts have used more than 20 keys"), 1);
  EXPECT_EQ(with("the disk is slower"), 0);
  EXPECT_EQ(read(path("kept/full.mcap")).last_tick, 10u) << "ticks have their end in it all the same";
  const Outcome verified = run({"replay", path("kept/full.mcap"), "--verify"});
  EXPECT_EQ(verified.code, 1);
  EXPECT_NE(verified.text.find("lost inputs when it was recorded"), std::string::npos) << verified.text;
}

TEST_F(LongRun, AnIndexThatNoOtherFileRelievesEndsAtItsLastBound) {
  RecordingHead head;
  head.scene = "main";
  RecordingBounds bounds;
  bounds.next_index = 3'000;  // so small that the queue is not full before
  bounds.most_index = 6'000;
  Recording recording(open_recorder(path("full.mcap")), head, bounds);
  uint64_t tick = 0;
  ASSERT_TRUE(until([&] {
    for (int k = 0; k < 3; ++k) recording.input(tick + 1, {"host/h/poses", Bytes(100'000)}, 1);
    recording.end_tick(++tick, 0, 1);
    return recording.lost() > 0;
  }));
  EXPECT_TRUE(recording.full());
  EXPECT_NE(recording.why_lost().find("its index takes"), std::string::npos) << recording.why_lost();
  EXPECT_EQ(recording.close(), "");
  EXPECT_LT(read(path("full.mcap")).last_tick, tick);
}

TEST_F(LongRun, OutputsThatWereLostAreSaidToBeLostAndNotToDiffer) {
  Scene scene;
  SeriesOptions options = scene.options(path("lossy.mcap"));
  options.bounds.most_channels = 4;  // a command and its answer, one of its two keyframes, the ends of ticks
  Series series(options, *scene.world, scene.latest);
  series.begin(at(0));
  scene.tick(series, {});
  scene.tick(series, {scene.spawn("car")});
  scene.tick(series, {});
  EXPECT_EQ(series.lost(), 1u);
  EXPECT_FALSE(series.close());
  const Outcome verified = run({"replay", path("lossy.mcap"), "--verify"});
  EXPECT_EQ(verified.code, 1) << verified.text;
  EXPECT_NE(verified.text.find("the first 3 ticks are identical"), std::string::npos) << verified.text;
  EXPECT_NE(verified.text.find("the recording lost 1 messages of these ticks, the first in tick 2"), std::string::npos)
      << verified.text;
}

// The bound of the index must limit the real memory.
TEST_F(LongRun, TheIndexTakesNoMoreMemoryThanItIsThoughtTo) {
#if defined(CRUMPLE_SANITIZE)
  GTEST_SKIP() << "the memory is another here";
#endif
  constexpr int channels = 60'000, rounds = 10, at_once = 1'000;
  constexpr size_t buffers = size_t{1} << 20;  // the recorder's buffers, and its queue of simultaneous messages
  const auto held = [] { return mallinfo2().uordblks + mallinfo2().hblkhd; };
  Recorder* recorder = nullptr;
  const size_t before = held();
  ASSERT_EQ(recorder_open(path("index.mcap").c_str(), "", "", &recorder), 0);
  const int schema = recorder_schema(recorder, "S", nullptr, 0);
  std::map<std::string, int> ids;  // as in a Recording
  uint64_t written = 0;            // in the index
  const auto wait_after = [&](int k) {
    return k % at_once < at_once - 1 || until([&] { return recorder_index(recorder) >= written; });
  };
  for (int k = 0; k < channels; ++k) {
    const std::string key = "car/c" + std::to_string(k) + "/delta/0", topic = "crumple/1/main/" + key;
    ASSERT_EQ(recorder_channel(recorder, topic.c_str(), schema), k);
    ids.emplace(key, k);
    written += 448 + 2 * topic.size();
    ASSERT_TRUE(wait_after(k));
  }
  RecordProperty("bytes_per_channel", static_cast<int>((held() - before) / channels));
  EXPECT_LT(held() - before, recorder_index(recorder) + buffers);
  EXPECT_GT(held() - before, recorder_index(recorder) / 2);
  const Bytes data(40);  // 3,700 such messages fill a chunk
  const size_t declared = held();
  for (int k = 0; k < rounds * channels; ++k) {
    ASSERT_EQ(recorder_write(recorder, k % channels, 0, 0, 0, data.data(), data.size()), 0) << transport_error();
    written += 30;
    ASSERT_TRUE(wait_after(k));
  }
  RecordProperty("bytes_per_channel_in_chunk", static_cast<int>((held() - declared) / (rounds * channels)));
  EXPECT_LT(held() - before, recorder_index(recorder) + buffers);
  EXPECT_EQ(recorder_close(recorder), 0);
}

TEST_F(LongRun, AFileThatASignalLeftBeforeItBeganIsSaidToBeEmpty) {
  Scene scene;
  const Series standby(scene.options(path("standby.mcap")), *scene.world, scene.latest);
  ASSERT_TRUE(until([&] { return fs::file_size(path("standby.mcap")) > 0; }));
  fs::copy_file(path("standby.mcap"), path("left.mcap"));  // as SIGKILL would leave it
  try {
    RecordingReader reader(path("left.mcap"));
    FAIL() << "it was read";
  } catch (const std::runtime_error& error) {
    EXPECT_NE(std::string(error.what()).find("the file is empty, because its server was killed before it recorded"),
              std::string::npos)
        << error.what();
  }
}

// Longer than the longest record, and longer than the recorder's queue.
TEST_F(LongRun, AWorldOfManyDamagedCarsIsRecordedInPieces) {
  RecordingHead head;
  head.scene = "main";
  head.world.resize(size_t{140} << 20);
  for (size_t k = 0; k < head.world.size(); k += 4096) head.world[k] = std::byte(k >> 12);
  {
    Recording recording(open_recorder(path("world.mcap")), head);
    recording.end_tick(1, 0, 1);
    EXPECT_EQ(recording.lost(), 0u);
    EXPECT_EQ(recording.close(), "");
  }
  EXPECT_TRUE(RecordingReader(path("world.mcap")).head().world == head.world);
}

}  // namespace
}  // namespace crumple

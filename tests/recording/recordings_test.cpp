// Tests that recordings can be trusted. The recordings of the repository give their hashes again. After a kill, or with a full,
// slow or forbidden disk, the file is readable and its end is reported. Exported files show what viewers saw.
#include <assimp/commonMetaData.h>
#include <assimp/scene.h>
#include <fcntl.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <assimp/Importer.hpp>
#include <random>
#include <sstream>
#include <thread>

#include "io/mcap.h"
#include "io/net.h"
#include "paths.h"
#include "program.h"
#include "schema/message_generated.h"
#include "tick/health.h"
#include "tick/surface_update.h"

namespace crumple {
namespace {

namespace fs = std::filesystem;

#if defined(CRUMPLE_SANITIZE)  // fifteen times slower: once is enough to see a fault in memory
constexpr const char* thread_counts[] = {"2"};
constexpr const char* only = "built_in_pole";
#else
constexpr const char* thread_counts[] = {"1", "2", "4"};
constexpr const char* only = "";
#endif

TEST(Recordings, GiveEveryTickAgainAt1And2And4Threads) {
  int files = 0;
  for (const auto& entry : fs::directory_iterator(in_repository("recordings"))) {
    if (entry.path().extension() != ".mcap") continue;
    ++files;
    EXPECT_LT(fs::file_size(entry.path()), 2'000'000u) << entry.path();
    if (entry.path().string().find(only) == std::string::npos) continue;
    for (const char* threads : thread_counts) {
      const Outcome outcome = run({"replay", entry.path().string(), "--verify", "--threads", threads});
      EXPECT_EQ(outcome.code, 0) << outcome.text;
    }
  }
  EXPECT_GE(files, 3);
}

struct Message {
  std::string topic, schema, bfbs, data;
  uint32_t tick;
  uint64_t log_time, publish_time;
  bool operator==(const Message&) const = default;
  bool is(const char* table) const { return schema == std::string("crumple.schema.") + table; }
  template <class Table>
  const Table* as() const {
    return flatbuffers::GetRoot<Table>(data.data());
  }
};

struct Contents {
  bool cut = false;
  int end = 0;  // result of the last reader_next
  std::vector<Message> messages;
  std::vector<std::string> metadata, attachments;
  uint32_t last_tick() const {
    uint32_t last = 0;
    for (const Message& message : messages)
      if (message.is("TickEnd")) last = message.tick;
    return last;
  }
};

Contents read(const std::string& path) {
  Contents contents;
  Reader* reader = nullptr;
  EXPECT_EQ(reader_open(path.c_str(), &reader), 0) << transport_error();
  if (!reader) return contents;
  contents.cut = reader_cut(reader) == 1;
  const char *name, *type;
  const char* const* pairs;
  const uint8_t* data;
  size_t size;
  for (uint32_t i = 0; reader_metadata(reader, i, &name, &pairs) == 1; ++i)
    for (; *pairs; ++pairs) contents.metadata.push_back(*pairs);
  for (uint32_t i = 0; reader_attachment(reader, i, &name, &type, &data, &size) == 1; ++i)
    contents.attachments.push_back(std::string(name) + type + std::string(data, data + size));
  ReaderMessage m;
  while ((contents.end = reader_next(reader, &m)) == 1)
    contents.messages.push_back({m.topic,
                                 m.schema,
                                 {m.bfbs, m.bfbs + m.bfbs_size},
                                 {m.data, m.data + m.size},
                                 m.sequence,
                                 m.log_time_ns,
                                 m.publish_time_ns});
  reader_close(reader);
  return contents;
}

// Copies a recording as long as `change` returns true. `change` may change a message, or leave it out by clearing its topic.
// `program`, if given, replaces the recorder's name. Then `more` messages follow.
void copy(const std::string& from, const std::string& to, const char* program, const std::function<bool(Message&)>& change,
          const std::vector<Message>& more = {}) {
  Reader* reader = nullptr;
  Recorder* recorder = nullptr;
  EXPECT_EQ(reader_open(from.c_str(), &reader), 0) << transport_error();
  EXPECT_EQ(recorder_open(to.c_str(), "crumple", "test", &recorder), 0) << transport_error();
  const char *name, *type;
  const char* const* pairs;
  const uint8_t* data;
  size_t size;
  for (uint32_t i = 0; reader_metadata(reader, i, &name, &pairs) == 1; ++i) {
    std::vector<const char*> copied;
    for (; pairs[0]; pairs += 2)
      copied.insert(copied.end(), {pairs[0], program && pairs[0] == std::string("program") ? program : pairs[1]});
    copied.push_back(nullptr);
    recorder_metadata(recorder, name, copied.data());
  }
  for (uint32_t i = 0; reader_attachment(reader, i, &name, &type, &data, &size) == 1; ++i)
    recorder_attach(recorder, name, type, data, size);
  reader_close(reader);
  std::map<std::string, int> channels;
  std::vector<Message> all;
  for (Message& m : read(from).messages) {
    if (!change(m)) break;
    if (!m.topic.empty()) all.push_back(std::move(m));
  }
  all.insert(all.end(), more.begin(), more.end());
  for (const Message& m : all) {
    const auto [channel, fresh] = channels.try_emplace(m.topic);
    if (fresh)
      channel->second = recorder_channel(recorder, m.topic.c_str(),
                                         recorder_schema(recorder, m.schema.c_str(), m.bfbs.data(), m.bfbs.size()));
    EXPECT_EQ(recorder_write(recorder, channel->second, m.tick, m.log_time, m.publish_time, m.data.data(), m.data.size()), 0);
  }
  EXPECT_EQ(recorder_close(recorder), 0);
}

std::string bytes_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void write_bytes(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

size_t count(const std::string& text, const std::string& part) {
  size_t found = 0;
  for (size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++found;
  return found;
}

class Recorded : public Program {
 protected:
  // The server's health, as any program on the network sees it.
  void listen() {
    ASSERT_EQ(net_open("client", nullptr, endpoint.c_str(), nullptr, 30'000, &net), 0) << transport_error();
    ASSERT_EQ(net_subscribe(net, "crumple/1/main/health", 0, NET_LONGEST), 0);
  }
  void TearDown() override {
    if (net) net_close(net);
    Program::TearDown();
  }
  struct Health {
    uint64_t tick, late, lost;
  };
  // Returns the next health for which the condition holds; of tick 0 at the deadline. Repeats `meanwhile` until then.
  Health health(
      const std::function<bool(const Health&)>& condition, const std::function<void()>& meanwhile = [] {}) {
    const auto deadline = Clock::now() + patience;
    while (Clock::now() < deadline) {
      meanwhile();
      NetEvent event{};
      if (net_poll(net, &event, 1, 20'000) < 1 || event.kind != NET_SAMPLE) continue;
      const auto* message = flatbuffers::GetRoot<schema::Health>(event.data);
      Health found{message->tick(), message->late(), 0};
      for (const auto* one : *message->counts())
        if (one->name()->str() == "recording_lost") found.lost = one->value();
      if (condition(found)) return found;
    }
    ADD_FAILURE() << "no such health came";
    return {};
  }
  Health after(uint64_t tick) {
    return health([&](const Health& now) { return now.tick >= tick; });
  }

  Net* net = nullptr;
};

TEST_F(Recorded, AServerKilledInTheMiddleOfACrashLosesASecondAtMost) {
  start_server(path("killed.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  listen();
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  // A kill may lose one second, and on a loaded machine three, so the session must be longer.
  constexpr uint32_t slack = 180;
  after(slack + 60);
  CrumpleCarPose pose{};
  pose.car = "box";
  pose.pose.orientation[3] = 1;
  pose.velocity[0] = 10;
  ASSERT_EQ(crumple_publish_poses(host, 0, &pose, 1), CRUMPLE_OK) << crumple_error();
  CrumpleReaction reaction{};
  ASSERT_TRUE(until(host, [&] {
    while (crumple_take_reactions(host, &reaction, 1) == 1)
      if (reaction.contacts > 0 && reaction.tick > slack + 60) return true;
    return false;
  }));
  server->send(SIGKILL);
  EXPECT_EQ(server->wait(), -SIGKILL);

  const Contents left = read(path("killed.mcap"));
  EXPECT_TRUE(left.cut);
  EXPECT_EQ(left.end, 0) << transport_error();
  EXPECT_GE(left.last_tick() + slack, reaction.tick) << "more than a second is lost";
  RecordProperty("ticks_lost", static_cast<int>(reaction.tick - left.last_tick()));
  const Outcome verified = run({"replay", path("killed.mcap"), "--verify"});
  EXPECT_EQ(verified.code, 0) << verified.text;
  EXPECT_NE(verified.text.find("the first " + std::to_string(left.last_tick()) + " ticks are identical"), std::string::npos)
      << verified.text;
  EXPECT_NE(verified.text.find("cut off"), std::string::npos) << verified.text;
  EXPECT_NE(run({"info", path("killed.mcap")}).text.find("car box  at"), std::string::npos);

  const std::string before = bytes_of(path("killed.mcap"));
  const Outcome itself = run({"recover", path("killed.mcap"), "-o", path("./killed.mcap")});
  EXPECT_EQ(itself.code, 1);
  EXPECT_NE(itself.text.find("this is the input file"), std::string::npos) << itself.text;
  const Outcome recovered = run({"recover", path("killed.mcap"), "-o", path("whole.mcap")});
  EXPECT_EQ(recovered.code, 0) << recovered.text;
  EXPECT_NE(recovered.text.find(std::to_string(left.last_tick()) + " ticks"), std::string::npos) << recovered.text;
  EXPECT_TRUE(bytes_of(path("killed.mcap")) == before) << "the input was changed";
  const Contents whole = read(path("whole.mcap"));
  EXPECT_FALSE(whole.cut);
  EXPECT_EQ(whole.last_tick(), left.last_tick());
  const Outcome again = run({"replay", path("whole.mcap"), "--verify"});
  EXPECT_EQ(again.code, 0) << again.text;
  EXPECT_EQ(again.text.find("cut off"), std::string::npos) << again.text;
}

TEST_F(Recorded, RecoverKeepsWhatIsWholeOfAFileCutOrDamagedAnywhere) {
  const std::string source = in_repository("recordings/built_in_roof_drop.mcap");
  const Contents all = read(source);
  const std::string bytes = bytes_of(source);
  const size_t cars = bytes.find("crumple/1/");  // the first message comes after the schemas
  ASSERT_LT(cars, bytes.size());
  int recovered = 0;
  for (size_t i = 0; i <= 16; ++i) {
    const bool damaged = i % 2;
    const size_t at = cars + (bytes.size() - 1 - cars) * i / 16;
    write_bytes(path("in.mcap"), damaged ? bytes.substr(0, at) + char(~bytes[at]) + bytes.substr(at + 1) : bytes.substr(0, at));
    const Contents in = read(path("in.mcap"));
    const Outcome outcome = run({"recover", path("in.mcap"), "-o", path("out.mcap")});
    if (in.last_tick() == 0) {
      EXPECT_EQ(outcome.code, 1) << at;
      EXPECT_NE(outcome.text.find("no whole tick"), std::string::npos) << outcome.text;
      continue;
    }
    ++recovered;
    ASSERT_EQ(outcome.code, 0) << at << ": " << outcome.text;
    EXPECT_EQ(outcome.text.find("nothing was lost") != std::string::npos, !in.cut && in.end == 0) << outcome.text;
    EXPECT_EQ(outcome.text.find("damaged") != std::string::npos, in.end != 0) << outcome.text;
    const Contents out = read(path("out.mcap"));
    EXPECT_FALSE(out.cut);
    EXPECT_EQ(out.end, 0);
    EXPECT_EQ(out.last_tick(), in.last_tick());
    const auto head_end =
        std::find(all.metadata.begin(), all.metadata.end(), "messages");  // there the record of the end begins
    ASSERT_GE(out.metadata.end() - out.metadata.begin(), head_end - all.metadata.begin());
    EXPECT_TRUE(std::equal(all.metadata.begin(), head_end, out.metadata.begin()));
    EXPECT_EQ(out.attachments, all.attachments);
    // Every message up to the last whole tick must be there with its times and its schema, and none after it.
    std::vector<Message> kept = in.messages;
    std::erase_if(kept, [&](const Message& message) { return message.tick > in.last_tick(); });
    EXPECT_TRUE(out.messages == kept) << at << ": " << out.messages.size() << " of " << kept.size();
  }
  EXPECT_GT(recovered, 8);
}

TEST_F(Recorded, RecoverLeavesATickWithoutItsEndOut) {
  const std::string source = in_repository("recordings/built_in_roof_drop.mcap");
  const Contents all = read(source);
  // Finds a tick with inputs and outputs, and leaves out its end and everything after it.
  uint32_t tick = 0;
  for (const Message& message : all.messages)
    if (tick == 0 && message.is("Reactions")) tick = message.tick;
  size_t of_tick = 0;
  copy(source, path("in.mcap"), nullptr, [&](const Message& message) {
    of_tick += message.tick == tick && !message.is("TickEnd");
    return message.tick < tick || !message.is("TickEnd");
  });
  ASSERT_GE(of_tick, 2u);
  const Outcome outcome = run({"recover", path("in.mcap"), "-o", path("out.mcap")});
  EXPECT_EQ(outcome.code, 0) << outcome.text;
  EXPECT_NE(outcome.text.find("left out: " + std::to_string(of_tick) + " messages of tick " + std::to_string(tick)),
            std::string::npos)
      << outcome.text;
  const Contents out = read(path("out.mcap"));
  EXPECT_EQ(out.last_tick(), tick - 1);
  EXPECT_EQ(out.messages.back().tick, tick - 1);
  EXPECT_EQ(run({"replay", path("out.mcap"), "--verify"}).code, 0);
}

TEST_F(Recorded, AnInputThatWasChangedAfterwardsIsFoundAtItsTickAndAnotherVersionIsNamed) {
  start_server(path("true.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;
  uint32_t tick = 0;
  const auto falsify = [&](Message& message) {
    if (!message.is("Poses")) return true;
    auto* car = flatbuffers::GetMutableRoot<schema::Poses>(message.data.data())->cars()->Get(0);
    *const_cast<schema::Vec3*>(car->velocity()) = schema::Vec3(9.999f, 0, 0);
    tick = message.tick;
    return true;
  };
  copy(path("true.mcap"), path("false.mcap"), nullptr, falsify);
  copy(path("true.mcap"), path("other.mcap"), "crumple 9.9.9+12345678", falsify);
  copy(path("true.mcap"), path("same.mcap"), "crumple 9.9.9+12345678", [](const Message&) { return true; });
  EXPECT_GT(tick, 0u);
  const Outcome outcome =
      run({"replay", path("true.mcap"), path("false.mcap"), path("other.mcap"), path("same.mcap"), "--verify"});
  EXPECT_EQ(outcome.code, 1);
  std::string version = run({"--version"}).text;
  version.pop_back();
  EXPECT_TRUE(version.starts_with("crumple ") && version.find('+') == version.size() - 9) << version;
  const std::string differs = ".mcap: tick " + std::to_string(tick) + " differs";
  for (const std::string& part :
       {std::string("true.mcap: every tick identical"), "false" + differs, "other" + differs,
        version + " recorded it, and this is the same program", "crumple 9.9.9+12345678 recorded it, and this is " + version,
        std::string("same.mcap: every tick identical")})
    EXPECT_EQ(count(outcome.text, part), 1u) << part << "\n" << outcome.text;

  // A recording that cannot be read at all must also name its version.
  copy(path("true.mcap"), path("empty.mcap"), nullptr, [](const Message&) { return false; });
  const Outcome empty = run({"replay", path("empty.mcap"), "--verify"});
  EXPECT_EQ(empty.code, 1);
  EXPECT_NE(empty.text.find("nothing to verify"), std::string::npos) << empty.text;
}

TEST_F(Recorded, WhatWasToldIsComparedTooAndTheFirstTickAndKeyThatDifferAreNamed) {
  start_server(path("true.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  listen();
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  after(150);  // the server has synced the recording twice
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;
  const std::string source = path("true.mcap");
  uint32_t reacted = 0, dented = 0, spawned = 0, healthy = 0;
  for (const Message& message : read(source).messages) {
    const auto first = [&](uint32_t& tick) { tick = tick == 0 ? message.tick : tick; };
    if (message.is("Reactions")) first(reacted);
    if (message.topic.ends_with("/delta/0")) first(dented);
    if (message.is("Answer")) first(spawned);
    if (message.is("Health")) first(healthy);
  }
  ASSERT_TRUE(reacted > 0 && dented > 0 && spawned > 0 && healthy > 0);
  const auto differs = [&](const char* name, uint32_t tick, const std::string& how,
                           const std::function<bool(Message&)>& change) {
    copy(source, path(name), nullptr, change);
    const Outcome outcome = run({"replay", path(name), "--verify"});
    EXPECT_EQ(outcome.code, 1) << name << "\n" << outcome.text;
    const std::string sentence = "tick " + std::to_string(tick) + " differs in " + how + "; the world's hash is the same";
    EXPECT_NE(outcome.text.find(sentence), std::string::npos) << name << ": " << sentence << "\n" << outcome.text;
    EXPECT_EQ(outcome.text.find("every tick identical"), std::string::npos) << name << "\n" << outcome.text;
  };
  differs("weaker.mcap", reacted, "host/tester/reactions (other bytes)", [](Message& message) {
    if (!message.is("Reactions")) return true;
    auto* one = flatbuffers::GetMutableRoot<schema::Reactions>(message.data.data())->cars()->Get(0);
    const auto& was = *one->impulse();
    *const_cast<schema::Vec3*>(one->impulse()) = schema::Vec3(0.1f * was.x(), 0.1f * was.y(), 0.1f * was.z());
    const auto& turn = *one->angular_impulse();
    *const_cast<schema::Vec3*>(one->angular_impulse()) = schema::Vec3(turn.x() + 1, turn.y(), turn.z());
    return true;
  });
  differs("undented.mcap", dented, "car/box/delta/0 (missing)", [](Message& message) {
    if (message.topic.ends_with("/delta/0")) message.topic.clear();
    return true;
  });
  differs("unanswered.mcap", spawned, "car/box/answer (missing)", [](Message& message) {
    if (message.is("Answer")) message.topic.clear();
    return true;
  });
  differs("ghost.mcap", healthy + 1, "car/ghost/delta/0 (the tick gives none)", [](Message& message) {
    if (message.is("Health")) message.topic = "crumple/1/main/car/ghost/delta/0";
    return true;
  });
  differs("later.mcap", reacted, "host/tester/reactions (of another tick)", [&](Message& message) {
    if (message.is("Reactions")) message.tick += 1;
    return true;
  });
}

TEST_F(Recorded, NothingIsPassedOverInSilence) {
  start_server(path("true.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  listen();
  spawn(host);
  // An input that changes nothing, because it is refused.
  ASSERT_EQ(net_put(net, "crumple/1/main/host/stray/poses", "none", 4, NET_DATA), 0);
  crash(host);
  if (HasFatalFailure()) return;
  after(150);
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;
  const std::string source = path("true.mcap");
  const Contents all = read(source);
  const auto is_stray = [](const Message& message) { return message.topic == "crumple/1/main/host/stray/poses"; };
  const auto stray = std::find_if(all.messages.begin(), all.messages.end(), is_stray);
  const auto healthy = std::find_if(all.messages.begin(), all.messages.end(), [](const auto& m) { return m.is("Health"); });
  ASSERT_TRUE(stray != all.messages.end() && healthy != all.messages.end());
  const auto verify = [&](const char* name, int code, const std::vector<std::string>& parts, const auto& change,
                          const std::vector<Message>& more = {}) {
    copy(source, path(name), nullptr, change, more);
    const Outcome outcome = run({"replay", path(name), "--verify"});
    EXPECT_EQ(outcome.code, code) << name << "\n" << outcome.text;
    for (const std::string& part : parts)
      EXPECT_NE(outcome.text.find(part), std::string::npos) << name << ": " << part << "\n" << outcome.text;
  };
  const auto tick = [](uint32_t number) { return "tick " + std::to_string(number); };
  const auto nothing = [](Message&) { return true; };
  verify("same.mcap", 0,
         {"every tick identical", "; not compared: times, health except its counts of cars, hosts and obstacles\n"}, nothing);
  verify("moved.mcap", 1, {tick(stray->tick) + " differs in host/stray/poses (an input of " + tick(stray->tick + 7) + ")"},
         [&](Message& message) {
           if (is_stray(message)) message.tick += 7;
           return true;
         });
  const std::string others = tick(stray->tick) + " differs in its inputs (others were recorded); the world's hash is the same";
  verify("fewer.mcap", 1, {others}, [&](Message& message) {
    if (is_stray(message)) message.topic.clear();
    return true;
  });
  verify("another.mcap", 1, {others}, [&](Message& message) {
    if (is_stray(message)) message.data = "more";
    return true;
  });
  verify("elsewhere.mcap", 1, {others}, [&](Message& message) {
    if (is_stray(message)) message.topic = "elsewhere";
    return true;
  });
  verify("renamed.mcap", 0, {"; not compared: ", "1 messages of another program, the first on \"elsewhere\""},
         [health = 0](Message& message) mutable {
           if (message.is("Health") && health++ == 0) message.topic = "elsewhere";
           return true;
         });
  verify("mistimed.mcap", 1, {tick(healthy->tick) + " differs in health (of another tick or rate)"}, [](Message& message) {
    if (message.is("Health")) message.tick += 1;
    return true;
  });
  verify("crowded.mcap", 1, {tick(healthy->tick) + " differs in health (another number of cars)"}, [](Message& message) {
    if (!message.is("Health")) return true;
    for (const auto* one : *message.as<schema::Health>()->counts())
      if (one->name()->str() == "cars")
        ++*const_cast<uint8_t*>(reinterpret_cast<const flatbuffers::Table*>(one)->GetAddressOf(schema::Count::VT_VALUE));
    return true;
  });
  verify("misended.mcap", 1, {tick(healthy->tick) + " differs in tick (of another tick)"}, [&](Message& message) {
    if (message.is("TickEnd") && message.tick == healthy->tick) message.tick += 1;
    return true;
  });
  Message behind = *stray;
  behind.tick = all.last_tick() + 1;
  verify("more.mcap", 1, {"after them the file has 1 messages of a tick without an end, the first on \"host/stray/poses\""},
         nothing, {behind});
  behind.topic = "crumple/1/main/car/box/delta/0";
  verify("told.mcap", 1, {"the first on \"car/box/delta/0\""}, nothing, {behind});
}

TEST_F(Recorded, WhatIsMissingAtTheEndIsNeitherCalledWholeNorIdentical) {
  start_server(path("true.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  listen();
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  after(150);  // the server has synced the recording twice
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;
  const std::string source = path("true.mcap");
  const Contents all = read(source);
  const std::string ticks = std::to_string(all.last_tick());
  const Outcome whole = run({"replay", source, "--verify"});
  EXPECT_EQ(whole.code, 0) << whole.text;
  EXPECT_NE(whole.text.find("every tick identical: " + ticks + " ticks"), std::string::npos) << whole.text;
  EXPECT_EQ(count(whole.text, "cut off") + count(whole.text, "older program"), 0u) << whole.text;

  // With a footer, as if the recording had ended there.
  const uint32_t half = all.last_tick() / 2;
  copy(source, path("half.mcap"), nullptr, [&](Message& message) { return message.tick <= half; });
  const Outcome closed = run({"replay", path("half.mcap"), "--verify"});
  EXPECT_EQ(closed.code, 1) << closed.text;
  EXPECT_NE(closed.text.find("the first " + std::to_string(half) + " of " + ticks + " ticks are identical"), std::string::npos)
      << closed.text;
  EXPECT_NE(run({"info", path("half.mcap")}).text.find("ENDS EARLY"), std::string::npos);
  // Without all outputs of a tick.
  copy(source, path("calm.mcap"), nullptr, [](Message& message) {
    if (message.is("Health")) message.topic.clear();
    return true;
  });
  const Outcome calm = run({"replay", path("calm.mcap"), "--verify"});
  EXPECT_EQ(calm.code, 1) << calm.text;
  EXPECT_NE(calm.text.find(" messages were recorded"), std::string::npos) << calm.text;

  // Like the file after a kill: sound up to its end.
  const std::string bytes = bytes_of(source);
  write_bytes(path("cut.mcap"), bytes.substr(0, bytes.find("crumple end") - 2000));
  const std::string left = std::to_string(read(path("cut.mcap")).last_tick());
  const Outcome cut = run({"replay", path("cut.mcap"), "--verify"});
  EXPECT_EQ(cut.code, 0) << cut.text;
  EXPECT_NE(cut.text.find("the first " + left + " ticks are identical"), std::string::npos) << cut.text;
  EXPECT_NE(cut.text.find("cut off"), std::string::npos) << cut.text;
  // And like such a file after another program closed it: verify cannot know what is missing, only that our end is missing.
  const auto end = std::find(all.metadata.begin(), all.metadata.end(), "messages");
  EXPECT_NE(end, all.metadata.end()) << "a recording says how many messages it has";
  copy(path("cut.mcap"), path("closed.mcap"), nullptr, [](Message&) { return true; });
  const Outcome without = run({"replay", path("closed.mcap"), "--verify"});
  EXPECT_EQ(without.code, 1) << without.text;
  EXPECT_NE(without.text.find("the first " + left + " ticks are identical"), std::string::npos) << without.text;
  EXPECT_NE(without.text.find("lacks its end"), std::string::npos) << without.text;
  for (const Outcome* each : {&closed, &calm, &cut, &without})
    EXPECT_EQ(each->text.find("every tick identical"), std::string::npos) << each->text;

  // The file from recover must say that it is incomplete.
  EXPECT_EQ(run({"recover", path("closed.mcap"), "-o", path("recovered.mcap")}).code, 0);
  const Outcome recovered = run({"replay", path("recovered.mcap"), "--verify"});
  EXPECT_EQ(recovered.code, 0) << recovered.text;
  EXPECT_NE(recovered.text.find("every tick identical: " + left + " ticks"), std::string::npos) << recovered.text;
  EXPECT_NE(recovered.text.find("recovered: "), std::string::npos) << recovered.text;
}

TEST_F(Recorded, AKillWithinTheFirstSecondsLosesASecondAtMostAndNothingOfTheHead) {
  for (const uint64_t ticks : {uint64_t{30}, uint64_t{90}, uint64_t{150}, uint64_t{200}}) {
    const std::string file = path(("killed" + std::to_string(ticks) + ".mcap").c_str());
    start_server(file);
    ASSERT_EQ(net_open("client", nullptr, endpoint.c_str(), nullptr, 30'000, &net), 0) << transport_error();
    ASSERT_EQ(net_subscribe(net, "crumple/1/main/replica/inputs", 1000, NET_LONGEST), 0);  // one per tick
    uint64_t last = 0;
    for (const auto deadline = Clock::now() + patience; last < ticks && Clock::now() < deadline;) {
      NetEvent events[64];
      const int got = net_poll(net, events, 64, 100'000);
      for (int k = 0; k < got; ++k)
        if (events[k].kind == NET_SAMPLE) last = flatbuffers::GetRoot<schema::Inputs>(events[k].data)->tick();
    }
    ASSERT_GE(last, ticks);
    const auto now = std::chrono::system_clock::now().time_since_epoch();
    server->send(SIGKILL);
    EXPECT_EQ(server->wait(), -SIGKILL);
    net_close(net);
    net = nullptr;
    const Contents left = read(file);
    EXPECT_EQ(left.attachments.size(), 1u) << "the car is not in the file after " << last << " ticks";
    EXPECT_NE(std::find(left.metadata.begin(), left.metadata.end(), "quantum"), left.metadata.end());
    if (ticks < 150) continue;
    // One second, and another for a loaded machine.
    ASSERT_FALSE(left.messages.empty()) << "nothing is in the file after " << last << " ticks";
    const auto lost = std::chrono::nanoseconds(now).count() - int64_t(left.messages.back().log_time);
    EXPECT_LT(lost, 2'000'000'000) << "ns, of " << last << " ticks";
  }
}

TEST_F(Recorded, ADiskThatFillsUpIsToldOnceAndCountedAndTheServerGoesOn) {
  start_server(path("full.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  listen();
  spawn(host);
  const size_t head = bytes_of(car_file.string()).size();
  health([&](const Health& now) { return now.tick > 60 && fs::file_size(path("full.mcap")) > head + 1000; });
  const rlimit no_more{fs::file_size(path("full.mcap")) + 10, RLIM_INFINITY};
  ASSERT_EQ(prlimit(server->id(), RLIMIT_FSIZE, &no_more, nullptr), 0);
  EXPECT_TRUE(server->read_until("full.mcap: the recording ends here")) << server->text;
  const Health at = health([](const Health& now) { return now.lost > 0; });
  const Health then = after(at.tick + 60);
  EXPECT_GT(then.lost, at.lost);
  RecordProperty("late_ticks", static_cast<int>(then.late - at.late));
  crash(host);
  server->send(SIGINT);
  EXPECT_EQ(server->wait(), 1) << server->text;
  EXPECT_EQ(count(server->text, "the recording ends here"), 1u) << server->text;
  EXPECT_EQ(count(server->text, "the recording lost "), 1u) << server->text;
  const Outcome verified = run({"replay", path("full.mcap"), "--verify"});
  EXPECT_EQ(verified.code, 0) << verified.text;
  EXPECT_NE(verified.text.find("cut off"), std::string::npos) << verified.text;
}

TEST_F(Recorded, ADiskThatIsStuckHoldsNoTickUpAndWhatItLostIsNamed) {
  ASSERT_EQ(mkfifo(path("pipe").c_str(), 0600), 0);
  const int pipe = ::open(path("pipe").c_str(), O_RDONLY | O_NONBLOCK);
  ASSERT_GE(pipe, 0);
  ASSERT_EQ(fcntl(pipe, F_SETFL, 0), 0);  // from now on a read waits
  start_server(path("pipe"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  listen();
  // Nobody reads the pipe, which holds 64 KiB; the queue holds 64 MiB. Refused messages are inputs as well.
  std::string noise(1'000'000, '\0');
  std::mt19937 random(1);
  for (char& c : noise) c = static_cast<char>(random());
  uint64_t sent = 0;
  const Health at = health([](const Health& now) { return now.lost > 0; },
                           [&] {
                             const std::string key = "crumple/1/main/host/h" + std::to_string(sent++ % 8) + "/poses";
                             net_put(net, key.c_str(), noise.data(), noise.size(), NET_DATA);
                           });
  EXPECT_TRUE(server->read_until("pipe: loses messages")) << server->text;
  // Messages on keys that are new to the full queue, with tables that it knows and does not know.
  spawn(host);
  CrumpleCarPose still{};
  still.car = "box";
  still.pose.orientation[3] = 1;
  ASSERT_EQ(crumple_publish_poses(host, 0, &still, 1), CRUMPLE_OK) << crumple_error();
  const Health then = after(at.tick + 60);
  EXPECT_GT(then.lost, at.lost);
  RecordProperty("late_ticks", static_cast<int>(then.late - at.late));

  std::thread drain([&] {
    std::ofstream file(path("drained.mcap"), std::ios::binary);
    std::vector<char> chunk(1 << 16);
    for (ssize_t size; (size = ::read(pipe, chunk.data(), chunk.size())) > 0;) file.write(chunk.data(), size);
  });
  health([&, last = then.lost](const Health& now) mutable {
    return std::exchange(last, now.lost) == now.lost;
  });  // the queue has room again
  crash(host);
  server->send(SIGINT);
  EXPECT_EQ(server->wait(), 1) << server->text;
  drain.join();
  close(pipe);
  EXPECT_EQ(count(server->text, "pipe: loses messages"), 1u) << server->text;
  EXPECT_EQ(count(server->text, "the recording lost "), 1u) << server->text;
  size_t keyframes = 0, poses = 0;
  for (const Message& message : read(path("drained.mcap")).messages) {
    keyframes += message.is("Keyframe");
    poses += message.topic == "crumple/1/main/host/tester/poses";
  }
  EXPECT_GT(keyframes, 0u) << "a table that the full queue refused once is never recorded";
  EXPECT_GT(poses, 0u) << "a key that the full queue refused once is never recorded";
  const Outcome verified = run({"replay", path("drained.mcap"), "--verify"});
  EXPECT_EQ(verified.code, 1) << verified.text;
  EXPECT_NE(verified.text.find("lost inputs when it was recorded"), std::string::npos) << verified.text;
}

// A server whose disk can be made to hang, except for the program and the car.
class DiskThatHangs : public Recorded {
 protected:
  void SetUp() override {
#if defined(CRUMPLE_SANITIZE)
    GTEST_SKIP() << "its runtime must be the first library";
#endif
    Recorded::SetUp();
    setenv("LD_PRELOAD", hang_path().c_str(), 1);  // for the programs that this test starts
    setenv("CRUMPLE_HANG", path("hang").c_str(), 1);
  }
  void TearDown() override {
    unsetenv("LD_PRELOAD");
    if (!folder.empty()) fs::remove(path("hang"));
    Recorded::TearDown();
  }
  void hang() const { write("hang", ""); }
};

TEST_F(DiskThatHangs, NoTickWaitsForTheNextFile) {
  start_server(path("long.mcap"), {"--record-minutes", "0.02"});  // 1.2 s
  listen();
  const Health before = after(30);
  hang();
  const Health meanwhile = after(before.tick + 180);
  ASSERT_GE(meanwhile.tick, before.tick + 180);
  fs::remove(path("hang"));
  const auto deadline = Clock::now() + patience;
  while (!fs::exists(path("long-2.mcap")) && Clock::now() < deadline) after(0);
  after(meanwhile.tick + 60);
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;
  uint32_t last = 0;
  for (const char* name : {"long.mcap", "long-2.mcap"})
    for (const Message& message : read(path(name)).messages)
      if (message.is("TickEnd")) {
        EXPECT_EQ(message.tick, ++last) << name;
      }
  EXPECT_GE(last, meanwhile.tick);
}

TEST_F(DiskThatHangs, AServerEndsInTimeAndSaysThatItsRecordingDoesNot) {
  start_server(path("open.mcap"));
  listen();
  after(90);
  hang();
  const auto begun = Clock::now();
  server->send(SIGTERM);
  EXPECT_TRUE(server->read_until("open.mcap: the disk has not written its end within 5 s")) << server->text;
  EXPECT_EQ(server->wait(), 1) << server->text;
  EXPECT_LT(Clock::now() - begun, std::chrono::seconds(20)) << "7 s on a machine that does nothing else";
  fs::remove(path("hang"));
  const Outcome verified = run({"replay", path("open.mcap"), "--verify"});
  EXPECT_EQ(verified.code, 0) << verified.text;
  EXPECT_NE(verified.text.find("cut off"), std::string::npos) << verified.text;
}

TEST_F(DiskThatHangs, WhoStandsByTakesOverAllTheSame) {
  Net* opened = nullptr;
  ASSERT_EQ(net_open("router", "tcp/127.0.0.1:0", nullptr, nullptr, 0, &opened), 0) << transport_error();
  const std::unique_ptr<Net, decltype(&net_close)> router(opened, net_close);
  endpoint = net_endpoint(router.get());
  std::vector<std::string> arguments = {"serve", "--car", car_file.string(), "--connect", endpoint};
  Process owner(arguments);
  ASSERT_TRUE(owner.read_until("levels")) << owner.text;
  arguments.insert(arguments.end(), {"--standby", "--record", path("after.mcap")});
  Process standby(arguments);
  ASSERT_TRUE(standby.read_until("holds the world")) << standby.text;
  hang();
  owner.send(SIGKILL);
  ASSERT_TRUE(standby.read_until("takes over")) << standby.text;
  listen();
  const uint64_t tick = after(1).tick;
  EXPECT_GT(after(tick + 60).tick, tick);
  fs::remove(path("hang"));
  standby.send(SIGTERM);
  EXPECT_EQ(standby.wait(), 0) << standby.text;
  const Outcome verified = run({"replay", path("after.mcap"), "--verify"});
  EXPECT_EQ(verified.code, 0) << verified.text;
}

// The recording of a standby that was never needed.
TEST_F(Recorded, AFileInWhichNothingBeganIsNotLeft) {
  Net* opened = nullptr;
  ASSERT_EQ(net_open("router", "tcp/127.0.0.1:0", nullptr, nullptr, 0, &opened), 0) << transport_error();
  const std::unique_ptr<Net, decltype(&net_close)> router(opened, net_close);
  std::vector<std::string> arguments = {"serve", "--car", car_file.string(), "--connect", net_endpoint(router.get())};
  Process owner(arguments);
  ASSERT_TRUE(owner.read_until("levels")) << owner.text;
  arguments.insert(arguments.end(), {"--standby", "--record", path("none.mcap")});
  Process standby(arguments);
  ASSERT_TRUE(standby.read_until("holds the world")) << standby.text;
  EXPECT_TRUE(fs::exists(path("none.mcap")));
  standby.send(SIGTERM);
  EXPECT_EQ(standby.wait(), 0) << standby.text;
  EXPECT_FALSE(fs::exists(path("none.mcap")));
}

TEST_F(Recorded, GoesOnInNumberedFilesWhereTheNameHasNoTime) {
  write("fixed-2.mcap", "somebody else's");
  const Outcome served = run({"serve", "--car", car_file.string(), "--listen", "tcp/127.0.0.1:0", "--record",
                              path("fixed.mcap"), "--record-minutes", "0.02", "--seconds", "3"});
  EXPECT_EQ(served.code, 0) << served.text;
  EXPECT_EQ(bytes_of(path("fixed-2.mcap")), "somebody else's");
  const Contents first = read(path("fixed.mcap")), next = read(path("fixed-3.mcap"));
  ASSERT_GT(first.last_tick(), 0u);
  ASSERT_FALSE(next.messages.empty());
  EXPECT_EQ(next.messages.front().tick, first.last_tick() + 1);
  const Outcome verified = run({"replay", path("fixed.mcap"), path("fixed-3.mcap"), "--verify"});
  EXPECT_EQ(verified.code, 0) << verified.text;
  EXPECT_EQ(count(verified.text, "every tick identical"), 2u) << verified.text;
}

TEST_F(Recorded, GoesOnInFilesThatReplayByThemselvesAndLackNoTick) {
  fs::create_directory(path("gone"));
  start_server(path("gone/%s.mcap"), {"--record-minutes", "0.05"});  // 3 s
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  const auto files = [&](const char* where) {
    std::vector<std::string> found;
    for (const auto& entry : fs::directory_iterator(path(where))) found.push_back(entry.path().string());
    std::sort(found.begin(), found.end());  // seconds since 1970: all names have as many digits
    return found;
  };
  const auto are_there = [&](const char* where, size_t count) {
    const auto deadline = Clock::now() + patience;
    while (files(where).size() < count && Clock::now() < deadline) crumple_poll(host, 100'000);
    return files(where).size() >= count;
  };
  ASSERT_TRUE(are_there("gone", 2));
  // If the next file cannot be opened, the recording continues in the old one, and changes to the next file as soon as it can.
  fs::rename(path("gone"), path("kept"));
  EXPECT_TRUE(server->read_until("goes on in ")) << server->text;
  fs::create_directory(path("gone"));
  ASSERT_TRUE(are_there("gone", 1));
  server->send(SIGTERM);
  EXPECT_EQ(server->wait(), 0) << server->text;

  auto all = files("kept");
  for (const std::string& file : files("gone")) all.push_back(file);
  uint32_t last = 0;
  for (const std::string& file : all) {
    const Contents contents = read(file);
    EXPECT_FALSE(contents.cut) << file;
    std::map<std::string, int> number;
    for (const Message& message : contents.messages) {
      if (message.is("TickEnd")) {
        EXPECT_EQ(message.tick, ++last) << file;
      }
      ++number[message.topic];
    }
    // A reader of the file sees the car and the wall.
    for (const char* key : {"car/box/key/0", "car/box/key/1", "host/tester/obstacles", "host/tester/poses"})
      EXPECT_GE(number[std::string("crumple/1/main/") + key], 1) << file << " " << key;
    if (number["crumple/1/main/tick"] == 0) continue;  // this file had just begun
    const Outcome verified = run({"replay", file, "--verify"});
    EXPECT_EQ(verified.code, 0) << verified.text;
    EXPECT_EQ(count(verified.text, "messages that hosts sent before the first tick"), file == all.front() ? 0u : 1u)
        << verified.text;
  }
}

TEST_F(Recorded, AFolderThatCannotBeWrittenIsRefusedAtTheStart) {
  for (const char* verb : {"serve", "recover", "export"}) {
    const std::string source = in_repository("recordings/built_in_pole.mcap");
    const std::string there = "/sys/crumple.mcap";  // not even root creates files there
    std::vector<std::string> arguments = {verb, source, "-o", there};
    if (std::string(verb) == "serve")
      arguments = {"serve", "--car", car_file.string(), "--record", there, "--listen", "tcp/127.0.0.1:0"};
    const Outcome outcome = run(arguments);
    EXPECT_EQ(outcome.code, 1) << outcome.text;
    EXPECT_TRUE(outcome.text.starts_with(std::string("crumple ") + verb + ": " + there + ": cannot be ") ||
                outcome.text.starts_with(std::string("crumple ") + verb + ": " + there + ": cannot record "))
        << outcome.text;
    EXPECT_EQ(count(outcome.text, "\n"), 1u) << outcome.text;
  }
}

std::vector<std::array<float, 3>> obj_vertices(const std::string& text) {
  std::vector<std::array<float, 3>> vertices;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    std::array<float, 3> v;
    if (std::sscanf(line.c_str(), "v %f %f %f", &v[0], &v[1], &v[2]) == 3) vertices.push_back(v);
  }
  return vertices;
}

TEST_F(Recorded, ExportShowsOtherProgramsTheCarThatAViewerSaw) {
  start_server(path("show.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  ASSERT_EQ(crumple_follow(host, "box", 0), CRUMPLE_OK);
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  CrumpleMesh mesh{};
  ASSERT_TRUE(until(host, [&] { return crumple_mesh(host, asset.c_str(), &mesh) == CRUMPLE_OK; }));
  server->send(SIGINT);
  EXPECT_EQ(server->wait(), 0) << server->text;
  EXPECT_GT(deepest(host), 40);
  std::vector<float> seen(3 * size_t{mesh.vertex_count});  // m, car's frame
  CrumpleVertices copied{nullptr, seen.data(), nullptr, 12, mesh.vertex_count, 0, 0, 0, 0, nullptr};
  ASSERT_EQ(crumple_copy(host, "box", &copied), CRUMPLE_OK);
  for (size_t i = 0; i < seen.size(); ++i) seen[i] += mesh.vertex[i];

  const Outcome outcome = run({"export", path("show.mcap"), "-o", path("show"), "--fps", "20"});
  ASSERT_EQ(outcome.code, 0) << outcome.text;

  // Reads the film with another reader of glTF.
  Assimp::Importer importer;
  const aiScene* scene = importer.ReadFile(path("show/box.glb"), 0);
  ASSERT_NE(scene, nullptr) << importer.GetErrorString();
  aiString credit;
  ASSERT_TRUE(scene->mMetaData && scene->mMetaData->Get(AI_METADATA_SOURCE_COPYRIGHT, credit));
  EXPECT_STREQ(credit.C_Str(), "made by the tests");
  ASSERT_EQ(scene->mNumMeshes, 1u);
  const aiMesh& body = *scene->mMeshes[0];
  ASSERT_EQ(body.mNumVertices, mesh.vertex_count);
  EXPECT_EQ(body.mNumFaces, mesh.triangle_count);
  ASSERT_GE(body.mNumAnimMeshes, 2u) << "a crash at 20 frames a second has several shapes";
  const aiAnimMesh& dented = *body.mAnimMeshes[body.mNumAnimMeshes - 1];
  for (uint32_t v = 0; v < mesh.vertex_count; ++v) {
    for (unsigned axis = 0; axis < 3; ++axis) {
      EXPECT_EQ(body.mVertices[v][axis], mesh.vertex[3 * v + axis]) << "vertex " << v;
      EXPECT_NEAR(dented.mVertices[v][axis], seen[3 * v + axis], 1e-6f) << "vertex " << v;
    }
  }
  ASSERT_EQ(scene->mNumAnimations, 1u);
  const aiAnimation& animation = *scene->mAnimations[0];
  ASSERT_EQ(animation.mNumMorphMeshChannels, 1u);
  const aiMeshMorphAnim& shapes = *animation.mMorphMeshChannels[0];
  ASSERT_GE(shapes.mNumKeys, 3u);
  const auto weight = [&](uint32_t key, uint32_t shape) { return shapes.mKeys[key].mWeights[shape]; };
  for (uint32_t shape = 0; shape < body.mNumAnimMeshes; ++shape) {
    EXPECT_EQ(weight(0, shape), 0) << "it begins undamaged";
    EXPECT_EQ(weight(shapes.mNumKeys - 1, shape), shape + 1 == body.mNumAnimMeshes ? 1 : 0) << "it ends as it was left";
  }

  // Compares the end of the film and the table of reactions with the recording.
  std::vector<Message> told;
  for (const Message& message : read(path("show.mcap")).messages)
    if (message.is("Reactions")) told.push_back(message);
  ASSERT_FALSE(told.empty());
  const auto& pose = *told.back().as<schema::Reactions>()->cars()->Get(0)->pose();
  ASSERT_EQ(animation.mNumChannels, 1u);
  const aiNodeAnim& motion = *animation.mChannels[0];
  EXPECT_NEAR(motion.mPositionKeys[motion.mNumPositionKeys - 1].mValue.x, pose.position().x(), 1e-5);
  EXPECT_GT(motion.mPositionKeys[motion.mNumPositionKeys - 1].mTime, 50) << "ms";
  EXPECT_LT(motion.mPositionKeys[motion.mNumPositionKeys - 1].mTime, 1000.0 / 60 * told.back().tick + 100) << "ms";
  // In glTF y is up: the height of the roof is our third coordinate and glTF's second.
  const aiMatrix4x4 upright = scene->mRootNode->mTransformation;
  const aiVector3D up = upright * aiVector3D(0, 0, 1), forward = upright * aiVector3D(1, 0, 0);
  EXPECT_NEAR(up.y, 1, 1e-6);
  EXPECT_NEAR(forward.z, 1, 1e-6);
  const std::string table = bytes_of(path("show/reactions.csv"));
  ASSERT_EQ(count(table, "\n"), told.size() + 1);
  std::istringstream lines(table);
  std::string line;
  std::getline(lines, line);
  for (const Message& message : told) {
    std::getline(lines, line);
    const auto& reaction = *message.as<schema::Reactions>()->cars()->Get(0);
    std::vector<std::string> cells;
    std::istringstream row(line);
    for (std::string cell; std::getline(row, cell, ',');) cells.push_back(cell);
    ASSERT_EQ(cells.size(), 22u) << line;
    EXPECT_EQ(cells[0], std::to_string(message.tick));
    EXPECT_EQ(cells[2], "box");
    EXPECT_FLOAT_EQ(std::stof(cells[6]), reaction.velocity()->x());
    EXPECT_FLOAT_EQ(std::stof(cells[12]), reaction.impulse()->x());
    EXPECT_FLOAT_EQ(std::stof(cells[18]), static_cast<float>(reaction.energy_absorbed()));
    EXPECT_EQ(cells[21], std::to_string(reaction.contacts()));
  }

  std::set<std::string> objs;
  for (const auto& entry : fs::directory_iterator(path("show")))
    if (entry.path().extension() == ".obj") objs.insert(entry.path().string());
  ASSERT_EQ(objs.size(), body.mNumAnimMeshes + 1u) << "each shape and the undamaged one";
  const std::string last = bytes_of(*objs.rbegin());
  EXPECT_TRUE(last.starts_with("# made by the tests\n")) << last.substr(0, 80);
  const auto vertices = obj_vertices(last);
  ASSERT_EQ(vertices.size(), mesh.vertex_count);
  for (size_t i = 0; i < seen.size(); ++i) EXPECT_NEAR(vertices[i / 3][i % 3], seen[i], 1e-5f) << "vertex " << i / 3;
}

// A car whose vertices lie inside tets, as a viewer of the film sees it.
TEST_F(Recorded, ExportMovesEveryVertexAsAViewerDoes) {
  const std::string source = in_repository("recordings/m130_wall.mcap");
  uint64_t end = 0;
  for (const Message& message : read(source).messages) {
    if (!message.topic.ends_with("/0")) continue;  // of another surface level
    if (message.is("Keyframe")) end = message.as<schema::Keyframe>()->hash();
    if (message.is("Delta")) end = message.as<schema::Delta>()->hash();
  }
  start({"replay", source, "--publish", "--loop", "--speed", "10", "--listen", "tcp/127.0.0.1:0"});
  Crumple* viewer = open();
  ASSERT_NE(viewer, nullptr);
  ASSERT_EQ(crumple_follow(viewer, "car", 0), CRUMPLE_OK);
  CrumpleSurface surface{};
  CrumpleMesh mesh{};
  ASSERT_TRUE(until(viewer, [&] {
    return crumple_surface(viewer, "car", &surface) == CRUMPLE_OK && surface.hash == end &&
           crumple_mesh(viewer, surface.asset, &mesh) == CRUMPLE_OK;
  }));
  std::vector<float> moved(3 * size_t{mesh.vertex_count});
  CrumpleVertices copied{nullptr, moved.data(), nullptr, 12, mesh.vertex_count, 0, 0, 0, 0, nullptr};
  ASSERT_EQ(crumple_copy(viewer, "car", &copied), CRUMPLE_OK);

  const Outcome outcome = run({"export", source, "-o", path("film")});
  ASSERT_EQ(outcome.code, 0) << outcome.text;
  Assimp::Importer importer;
  const aiScene* scene = importer.ReadFile(path("film/car.glb"), 0);
  ASSERT_TRUE(scene && scene->mNumMeshes > 1) << importer.GetErrorString();  // one for each look, over the same vertices
  const aiMesh& body = *scene->mMeshes[0];
  ASSERT_EQ(body.mNumVertices, mesh.vertex_count);
  ASSERT_GT(body.mNumAnimMeshes, 0u);
  for (uint32_t v = 0; v < mesh.vertex_count; ++v)
    for (unsigned axis = 0; axis < 3; ++axis)
      EXPECT_NEAR(body.mAnimMeshes[body.mNumAnimMeshes - 1]->mVertices[v][axis],
                  mesh.vertex[3 * v + axis] + moved[3 * v + axis], 1e-6f)
          << "vertex " << v;
}

// A forged keyframe with another number of nodes and the correct hash of them.
TEST_F(Recorded, ExportRefusesASurfaceThatLosesItsNodes) {
  const std::string source = in_repository("recordings/built_in_pole.mcap");
  int keyframes = 0;
  copy(source, path("hostile.mcap"), nullptr, [&](Message& message) {
    if (!message.is("Keyframe") || ++keyframes == 1) return true;
    const auto* keyframe = message.as<schema::Keyframe>();
    const Bytes bytes =
        encode_keyframe({keyframe->tick(), keyframe->asset()->str(), keyframe->quantum()}, std::vector<int16_t>{1, 2, 3}).at(0);
    message.data.assign(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    return true;
  });
  ASSERT_GT(keyframes, 1);
  const Outcome outcome = run({"export", path("hostile.mcap"), "-o", path("film")});
  EXPECT_EQ(outcome.code, 1);
  // Whichever comes first: the end of the film, or a delta of the car's own number of nodes.
  EXPECT_TRUE(outcome.text.find("different numbers of nodes") != std::string::npos ||
              outcome.text.find("node_count of a delta differs") != std::string::npos)
      << outcome.text;
}

}  // namespace
}  // namespace crumple

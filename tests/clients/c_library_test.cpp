// Tests the C library with wrong arguments: every function accepts any NULL and any closed session, and returns an error.
#include <crumple_client.h>
#include <gtest/gtest.h>

#include <fstream>
#include <functional>
#include <iterator>
#include <limits>
#include <regex>
#include <set>

#include "cpp/session.h"
#include "paths.h"

namespace crumple {
namespace {

struct Call {
  const char* name;
  std::vector<const char*> needed;  // names in the error sentence of the pointers that must not be NULL
  // Calls the function with NULL for needed[missing]; -1: no pointer is NULL. Returns its status or count.
  std::function<int64_t(Crumple*, int missing)> make;
};

// The value, or NULL if this pointer is the missing one.
template <class T>
T* unless(bool missing, T* value) {
  return missing ? nullptr : value;
}

const std::vector<Call>& calls() {
  static CrumpleSpawn spawn{{{0, 0, 0}, {0, 0, 0, 1}}, 0, {}, {}, 0};
  static const CrumpleParameters parameters = crumple_keep();
  static const CrumpleImpairment line{};
  static const CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 0, nullptr, "main", "h", nullptr};
  static uint64_t ticket;
  static CrumpleAnswer answer;
  static CrumpleStatistics statistics;
  static CrumpleCarPose pose{"c", {{0, 0, 0}, {0, 0, 0, 1}}, {}, {}, 0, 0};
  static CrumpleObstacle obstacle{1, CRUMPLE_BOX, {1, 1, 1}, nullptr, 0, {{0, 0, 0}, {0, 0, 0, 1}}, {}, {}, 1};
  static CrumpleReaction reaction;
  static CrumpleSurface surface;
  static CrumpleVertices vertices{nullptr, nullptr, nullptr, 12, 0, 0, 0, 0, 0, nullptr};
  static CrumpleMesh mesh;
  static CrumpleHealth health;
  static const char* ids[4];
  static const char bytes[8] = {};
  static char hash[17];
  static const char *car = "c", *asset = "0123456789abcdef";
  using Session = Crumple*;
  static const std::vector<Call> all = {
      {"crumple_poll", {}, [](Session s, int) { return crumple_poll(s, 0); }},
      {"crumple_statistics",
       {"out"},
       [](Session s, int k) {
         crumple_statistics(s, unless(k == 0, &statistics));
         return CRUMPLE_BAD_ARGUMENT;
       }},
      {"crumple_time", {}, [](Session s, int) { return int64_t(crumple_time(s)); }},
      {"crumple_impair", {"line"}, [](Session s, int k) { return crumple_impair(s, unless(k == 0, &line)); }},
      {"crumple_feed",
       {"key", "bytes"},
       [](Session s, int k) { return crumple_feed(s, unless(k == 0, "key"), unless(k == 1, bytes), sizeof bytes); }},
      {"crumple_spawn",
       {"car", "asset", "spawn", "ticket"},
       [](Session s, int k) {
         return crumple_spawn(s, unless(k == 0, car), unless(k == 1, asset), unless(k == 2, &spawn), unless(k == 3, &ticket));
       }},
      {"crumple_despawn",
       {"car", "ticket"},
       [](Session s, int k) { return crumple_despawn(s, unless(k == 0, car), unless(k == 1, &ticket)); }},
      {"crumple_repair",
       {"car", "ticket"},
       [](Session s, int k) { return crumple_repair(s, unless(k == 0, car), 1, unless(k == 1, &ticket)); }},
      {"crumple_set_parameters",
       {"car", "parameters", "ticket"},
       [](Session s, int k) {
         return crumple_set_parameters(s, unless(k == 0, car), unless(k == 1, &parameters), unless(k == 2, &ticket));
       }},
      {"crumple_save",
       {"car", "ticket"},
       [](Session s, int k) { return crumple_save(s, unless(k == 0, car), unless(k == 1, &ticket)); }},
      {"crumple_load",
       {"car", "state", "ticket"},
       [](Session s, int k) {
         return crumple_load(s, unless(k == 0, car), unless(k == 1, bytes), sizeof bytes, unless(k == 2, &ticket));
       }},
      {"crumple_answer", {"out"}, [](Session s, int k) { return crumple_answer(s, 1, unless(k == 0, &answer)); }},
      {"crumple_wait", {"out"}, [](Session s, int k) { return crumple_wait(s, 1, unless(k == 0, &answer)); }},
      {"crumple_publish_poses",
       {"cars"},
       [](Session s, int k) { return crumple_publish_poses(s, 0, unless(k == 0, &pose), 1); }},
      {"crumple_publish_obstacles",
       {"obstacles"},
       [](Session s, int k) { return crumple_publish_obstacles(s, unless(k == 0, &obstacle), 1); }},
      {"crumple_take_reactions",
       {"out"},
       [](Session s, int k) { return int64_t(crumple_take_reactions(s, unless(k == 0, &reaction), 1)); }},
      {"crumple_follow", {}, [](Session s, int) { return crumple_follow(s, nullptr, 0); }},
      {"crumple_cars", {"ids"}, [](Session s, int k) { return int64_t(crumple_cars(s, unless(k == 0, ids), 4)); }},
      {"crumple_surface",
       {"car", "out"},
       [](Session s, int k) { return crumple_surface(s, unless(k == 0, car), unless(k == 1, &surface)); }},
      {"crumple_copy",
       {"car", "out"},
       [](Session s, int k) { return crumple_copy(s, unless(k == 0, car), unless(k == 1, &vertices)); }},
      {"crumple_mesh",
       {"asset", "out"},
       [](Session s, int k) { return crumple_mesh(s, unless(k == 0, asset), unless(k == 1, &mesh)); }},
      {"crumple_parts",
       {"asset", "out"},
       [](Session s, int k) {
         static CrumpleParts parts{};
         return crumple_parts(s, unless(k == 0, asset), unless(k == 1, &parts));
       }},
      {"crumple_part_pose",
       {"car", "out"},
       [](Session s, int k) {
         static CrumplePose now{};
         return crumple_part_pose(s, unless(k == 0, car), 0, 0, unless(k == 1, &now));
       }},
      {"crumple_map",
       {"asset", "mesh", "mapping"},
       [](Session s, int k) {
         static CrumpleOwnMesh own{};
         static uint32_t mapping = 0;
         return crumple_map(s, unless(k == 0, "0123456789abcdef"), unless(k == 1, &own), unless(k == 2, &mapping));
       }},
      {"crumple_add_asset",
       {"car", "hash"},
       [](Session s, int k) { return crumple_add_asset(s, unless(k == 0, bytes), sizeof bytes, unless(k == 1, hash)); }},
      {"crumple_health", {"out"}, [](Session s, int k) { return crumple_health(s, unless(k == 0, &health)); }},
      {"crumple_close",
       {},
       [](Session s, int) {
         crumple_close(s);
         return CRUMPLE_BAD_ARGUMENT;
       }},
      {"crumple_open",
       {"options", "out"},
       [](Session, int k) {
         Crumple* out = nullptr;
         const int status = crumple_open(unless(k == 0, &options), unless(k == 1, &out));
         crumple_close(out);
         return status;
       }},
  };
  return all;
}

Crumple* opened(const char* host = "h") {
  const CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 0, nullptr, "main", host, nullptr};
  Crumple* session = nullptr;
  EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_OK) << crumple_error();
  return session;
}

void expect_refused(const Call& call, Crumple* session, int missing, const std::string& fact) {
  SCOPED_TRACE(std::string(call.name) + ", " + fact);
  CrumpleOptions none{};
  Crumple* out = nullptr;
  crumple_open(&none, &out);  // leaves another sentence
  const int64_t got = call.make(session, missing);
  EXPECT_TRUE(got == CRUMPLE_BAD_ARGUMENT || got == 0) << got;
  EXPECT_NE(std::string(crumple_error()).find(fact), std::string::npos) << crumple_error();
}

TEST(CLibrary, EveryFunctionOfTheHeaderIsInTheTable) {
  std::ifstream file(in_repository("clients/cpp/include/crumple_client.h"));
  std::set<std::string> declared, listed{"crumple_error", "crumple_keep"};  // these take no arguments
  const std::regex function("^[a-zA-Z].*\\b(crumple_[a-z_]+)\\(");
  for (std::string line; std::getline(file, line);)
    if (std::smatch found; std::regex_search(line, found, function)) declared.insert(found[1]);
  for (const Call& call : calls()) listed.insert(call.name);
  EXPECT_EQ(declared, listed);
  EXPECT_EQ(declared.size(), 30u);
}

TEST(CLibrary, EveryFunctionSaysWhichArgumentIsNull) {
  Crumple* session = opened();
  for (const Call& call : calls())
    for (size_t i = 0; i < call.needed.size(); ++i)
      expect_refused(call, session, int(i), std::string(call.needed[i]) + " is NULL");
  crumple_close(session);
}

TEST(CLibrary, EveryFunctionSaysThatItsSessionIsNullOrClosedOrNone) {
  Crumple* closed = opened();
  crumple_close(closed);
  Crumple* other = opened();  // may have the address of the closed session
  int none = 0;
  for (const Call& call : calls()) {
    const std::string name = call.name;
    if (name == "crumple_open") continue;
    if (name != "crumple_close") expect_refused(call, nullptr, -1, "session is NULL");
    expect_refused(call, closed, -1, "the session was closed");
    expect_refused(call, reinterpret_cast<Crumple*>(&none), -1, "the session was closed, or was never open");
  }
  EXPECT_NE(closed, other);
  EXPECT_EQ(crumple_follow(other, nullptr, 0), CRUMPLE_OK) << crumple_error();
  crumple_close(other);
}

TEST(CLibrary, RefusesCountsSizesAndStridesThatNothingCanHave) {
  Crumple* session = opened();
  const auto most = std::numeric_limits<size_t>::max();
  uint64_t ticket = 0;
  char bytes[64] = {}, hash[17];
  CrumpleObstacle hull{1, CRUMPLE_HULL, {}, nullptr, most / 2, {{0, 0, 0}, {0, 0, 0, 1}}, {}, {}, 1};
  CrumpleCarPose pose{};
  const float point[3] = {};
  const auto refused = [](int status, const std::string& fact) {
    EXPECT_EQ(status, CRUMPLE_BAD_ARGUMENT) << fact;
    EXPECT_NE(std::string(crumple_error()).find(fact), std::string::npos) << crumple_error();
  };
  for (const size_t size : {most, most - 6, (size_t{64} << 20) + 1}) {
    refused(crumple_feed(session, "crumple/1/main/health", bytes, size), "over 64 MiB");
    refused(crumple_load(session, "c", bytes, size, &ticket), "over 64 MiB");
  }
  refused(crumple_add_asset(session, bytes, most, hash), "over 256 MiB");
  refused(crumple_publish_poses(session, 0, &pose, most), "over 10000 poses");
  refused(crumple_publish_obstacles(session, &hull, most), "over 10000 obstacles");
  refused(crumple_publish_obstacles(session, &hull, 1), "points of an obstacle is NULL");
  hull.points = point;
  refused(crumple_publish_obstacles(session, &hull, 1), "over 100000 points");
  ASSERT_EQ(crumple_follow(session, "c", 0), CRUMPLE_OK) << crumple_error();
  for (const size_t stride : {size_t{0}, size_t{13}, size_t{4100}, most - 11}) {
    CrumpleVertices vertices{nullptr, nullptr, nullptr, stride, most, 0, 0, 0, 0, nullptr};
    refused(crumple_copy(session, "c", &vertices), "stride");
  }
  const std::string long_id(100'000, 'x');
  for (const char* id : {"", "\xff\xfe", "a b", long_id.c_str()}) {
    refused(crumple_follow(session, id, 0), "not an id");
    refused(crumple_mesh(session, id, nullptr), "out is NULL");
    CrumpleMesh mesh;
    refused(crumple_mesh(session, id, &mesh), "not a hash");
    CrumpleSpawn spawn{{{0, 0, 0}, {0, 0, 0, 1}}, 0, {}, {}, 0};
    refused(crumple_spawn(session, "c", id, &spawn, &ticket), "not a hash");
  }
  crumple_close(session);
}

TEST(CLibrary, OpensNothingWithOptionsThatAreNone) {
  CrumpleOptions options{};
  auto* session = reinterpret_cast<Crumple*>(1);
  EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_BAD_ARGUMENT);
  EXPECT_EQ(session, nullptr);
  options.version = CRUMPLE_CLIENT_VERSION;
  EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_BAD_ARGUMENT);  // no scene
  options.scene = "main";
  options.connect = "tcp/\xff\xfe";
  EXPECT_LT(crumple_open(&options, &session), 0);
  options.network = "\xff\xfe";
  EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_BAD_ARGUMENT);
}

TEST(CLibrary, AnExceptionBecomesWhatItSays) {
  const auto thrown = [](auto exception) { return client::guarded({}, [&]() -> int { throw exception; }); };
  EXPECT_EQ(thrown(std::runtime_error("the moon is full")), CRUMPLE_FAILED);
  EXPECT_STREQ(crumple_error(), "the moon is full");
  EXPECT_EQ(thrown(7), CRUMPLE_FAILED);
  EXPECT_STREQ(crumple_error(), "something was thrown that is no exception of C++");
  for (const int status : {thrown(std::bad_alloc()), thrown(std::length_error("vector"))}) {
    EXPECT_EQ(status, CRUMPLE_NO_MEMORY);
    EXPECT_STREQ(crumple_error(), "no memory");
  }
}

TEST(CLibrary, NoSceneIsNamedAsTheKeysOfBakedCars) {
  CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 0, nullptr, "asset", nullptr, nullptr};
  Crumple* session = nullptr;
  EXPECT_EQ(crumple_open(&options, &session), CRUMPLE_BAD_ARGUMENT);
  EXPECT_NE(std::string(crumple_error()).find("the keys of baked cars"), std::string::npos) << crumple_error();
}

}  // namespace
}  // namespace crumple

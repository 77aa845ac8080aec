// Tests the program over bad links: viewers, hosts and servers connect through proxies (bench/impaired_link.h) that lose,
// delay, damage, stall and cut. After the links are good again every viewer must have the server's surface. The tests use fixed
// seeds. They print durations and check them only roughly.
#include <atomic>
#include <cmath>
#include <thread>
#include <utility>

#include "impaired_link.h"
#include "io/net.h"
#include "program.h"

namespace crumple {
namespace {

using Router = std::unique_ptr<Net, decltype(&net_close)>;

Router route(const std::string& at) {
  Net* opened = nullptr;
  EXPECT_EQ(net_open("router", at.c_str(), nullptr, nullptr, 0, &opened), 0) << transport_error();
  return Router(opened, net_close);
}

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

class Links : public Program {
 protected:
  // A server that listens on TCP and UDP; TCP is at `endpoint`.
  void start_on_both() {
    start({"serve", "--car", car_file.string(), "--listen", "tcp/127.0.0.1:0,udp/127.0.0.1:0?rel=1"});
    const size_t at = server->text.find(",udp/") + 1;
    ASSERT_NE(at, 0u) << server->text;
    datagrams = server->text.substr(at, server->text.find_first_of(",?", at) - at);
  }
  Crumple* open_through(const ImpairedLink& link, const char* host = nullptr) {
    const bool udp = link.endpoint().starts_with("udp/");
    const std::string direct = std::exchange(endpoint, link.endpoint() + (udp ? "?rel=1" : ""));
    Crumple* session = open(host);
    endpoint = direct;
    return session;
  }
  void crash_anew(Crumple* host) {
    uint64_t ticket = 0;
    EXPECT_TRUE(answer(host, crumple_repair(host, "box", 0.5f, &ticket), ticket).ok);
    crash(host);
  }
  // Returns the time until this viewer has the same surface as a new viewer on a good link, ms.
  double until_equal(Crumple* viewer) {
    const auto start = Clock::now();
    Crumple* fresh = open();
    EXPECT_EQ(crumple_follow(fresh, "box", 0), CRUMPLE_OK);
    EXPECT_TRUE(until(viewer, [&] {
      crumple_poll(fresh, 0);
      return hash_held(fresh) != 0 && hash_held(viewer) == hash_held(fresh);
    })) << "a viewer differs";
    return milliseconds_since(start);
  }

  std::string datagrams;  // endpoint
};

TEST_F(Links, EveryViewerThroughABadLinkEndsWithTheServersSurface) {
  start_on_both();
  if (HasFatalFailure()) return;
  struct Row {
    const char* name;
    bool udp;
    Weather weather;
  };
  const Row rows[] = {
      {"10 %, 80 ms", false, {.delay = 80, .jitter = 20, .loss = 0.1}},
      {"10 %, 300 ms, 500 kbit", false, {.delay = 300, .jitter = 100, .loss = 0.1, .kbit = 500}},
      {"damaged", false, {.delay = 5, .damage = 0.1}},
      {"UDP, 20 %, 50 ms", true, {.delay = 50, .loss = 0.2}},
      {"UDP, overtaken and repeated", true, {.delay = 30, .repeat = 0.25, .reorder = 0.25}},
      {"UDP, damaged", true, {.delay = 5, .damage = 0.1}},
  };
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  spawn(host);
  std::vector<std::unique_ptr<ImpairedLink>> links;
  std::vector<Crumple*> viewers;
  std::atomic<bool> over = false;
  std::vector<std::atomic<uint64_t>> held(std::size(rows));
  std::vector<std::jthread> polls;
  for (const Row& row : rows) {
    const size_t i = links.size();
    links.push_back(std::make_unique<ImpairedLink>(row.udp ? datagrams : endpoint, row.weather, unsigned(i)));
    const auto start = Clock::now();
    Crumple* viewer = viewers.emplace_back(open_through(*links.back()));
    EXPECT_NE(viewer, nullptr) << row.name;
    if (!viewer) continue;
    EXPECT_EQ(crumple_follow(viewer, "box", 0), CRUMPLE_OK);
    EXPECT_TRUE(until(viewer, [&] { return hash_held(viewer) != 0; })) << row.name;
    std::printf("%-28s first surface after %.0f ms\n", row.name, milliseconds_since(start));
    polls.emplace_back([&, i, viewer] {
      for (; !over; held[i] = hash_held(viewer)) crumple_poll(viewer, 20'000);
    });
  }
  for (int i = 0; i < 12; ++i) crash_anew(host);
  Crumple* fresh = open();
  ASSERT_EQ(crumple_follow(fresh, "box", 0), CRUMPLE_OK);
  EXPECT_TRUE(until(fresh, [&] {
    return hash_held(fresh) != 0 &&
           std::all_of(held.begin(), held.end(), [&](const auto& one) { return one == hash_held(fresh); });
  }));
  over = true;
  polls.clear();
  EXPECT_GT(deepest(fresh), 40) << "in quanta of 0.5 mm";
  for (size_t i = 0; i < std::size(rows); ++i) {
    EXPECT_EQ(held[i], hash_held(fresh)) << rows[i].name;
    const auto counts = links[i]->counts();
    CrumpleStatistics seen{};
    if (viewers[i]) crumple_statistics(viewers[i], &seen);
    const auto n = [](uint64_t number) { return static_cast<unsigned long long>(number); };
    std::printf(
        "%-28s %llu packets: %llu lost, %llu damaged, %llu overtook; %llu connections, %llu surfaces, asked %llu times\n",
        rows[i].name, n(counts.passed), n(counts.lost), n(counts.damaged), n(counts.reordered), n(counts.connections),
        n(seen.surface), n(seen.asked));
    const Weather& weather = rows[i].weather;
    EXPECT_TRUE((weather.loss == 0 || counts.lost > 0) && (weather.damage == 0 || counts.damaged > 0)) << "good weather";
  }
}

TEST_F(Links, AViewerWhoseLinkWasCutIsCurrentSoonAfterItsReturn) {
  start_server(path("cut.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  spawn(host);
  ImpairedLink link(endpoint, {.delay = 50});
  Crumple* viewer = open_through(link);
  ASSERT_NE(viewer, nullptr);
  ASSERT_EQ(crumple_follow(viewer, "box", 0), CRUMPLE_OK);
  ASSERT_TRUE(until(viewer, [&] { return hash_held(viewer) != 0; }));
  for (const LinkState state : {LinkState::cut, LinkState::stalled}) {
    link.set(state);
    crash_anew(host);
    link.set(LinkState::up);
    std::printf("%s in the crash: equal after %.0f ms\n", state == LinkState::cut ? "cut" : "stalled", until_equal(viewer));
  }
}

// The viewer hears the server, but an answer of the server was lost.
TEST_F(Links, AKeyframeThatDoesNotComeIsAskedForAgain) {
  Net* opened = nullptr;
  ASSERT_EQ(net_open("peer", "tcp/127.0.0.1:0", nullptr, nullptr, 0, &opened), 0) << transport_error();
  const Router silent(opened, net_close);
  ASSERT_EQ(net_queryable(opened, "crumple/1/main/car/box/key/0", 16, NET_LONGEST), 0);
  for (const char* token : {"crumple/1/main/server", "crumple/1/main/car/box"}) ASSERT_EQ(net_announce(opened, token), 0);
  endpoint = net_endpoint(opened);
  Crumple* viewer = open();
  ASSERT_NE(viewer, nullptr);
  ASSERT_EQ(crumple_follow(viewer, "box", 0), CRUMPLE_OK);
  int questions = 0;
  EXPECT_TRUE(until(viewer, [&] {
    NetEvent event;
    while (net_poll(opened, &event, 1, 0) == 1) questions += event.kind == NET_QUERY;
    return questions == 2;
  })) << questions;
}

// The host sends its obstacles while the link is down.
TEST_F(Links, AHostWhoseLinkIsCutInMidDriveDrivesOn) {
  start_on_both();
  if (HasFatalFailure()) return;
  for (const bool udp : {false, true}) {
    SCOPED_TRACE(udp ? "UDP" : "TCP");
    ImpairedLink link(udp ? datagrams : endpoint, {.delay = 10, .loss = udp ? 0.05 : 0});
    Crumple* host = open_through(link, "tester");
    ASSERT_NE(host, nullptr);
    uint64_t ticket = 0;
    if (!udp) spawn(host);
    ASSERT_TRUE(answer(host, crumple_repair(host, "box", 1, &ticket), ticket).ok);
    // Passes the wall's place once a second.
    const auto drive = [&, start = Clock::now()] {
      const double time = std::fmod(1e-3 * milliseconds_since(start), 1);
      CrumpleCarPose pose{};
      pose.car = "box";
      pose.pose = {{std::min(0.6, 10 * time), 0, 0}, {0, 0, 0, 1}};
      pose.velocity[0] = time < 0.06 ? 10 : 0;
      ASSERT_EQ(crumple_publish_poses(host, 0, &pose, 1), CRUMPLE_OK) << crumple_error();
      ASSERT_GE(crumple_poll(host, 16'000), 0) << crumple_error();
    };
    const auto begun = Clock::now();
    while (milliseconds_since(begun) < 500) drive();
    link.set(LinkState::cut);
    CrumpleObstacle wall{};
    wall.shape = CRUMPLE_BOX;
    wall.size[0] = 1, wall.size[1] = 3, wall.size[2] = 3;
    wall.pose = {{2.25 + 0.3 + 1, 0, 0}, {0, 0, 0, 1}};
    ASSERT_EQ(crumple_publish_obstacles(host, &wall, 1), CRUMPLE_OK);
    while (milliseconds_since(begun) < 2500) drive();
    link.set(LinkState::up);
    const auto back = Clock::now();
    bool hit = false;
    ASSERT_TRUE(until(host, [&] {
      drive();
      CrumpleReaction reaction;
      while (crumple_take_reactions(host, &reaction, 1) == 1) hit |= reaction.contacts > 0;
      return hit;
    })) << "the wall is not there, or the car does not come to it";
    std::printf("%s: the host's car hits the wall %.0f ms after the line's return\n", udp ? "UDP" : "TCP",
                milliseconds_since(back));
    ASSERT_EQ(crumple_publish_obstacles(host, nullptr, 0), CRUMPLE_OK);
    ASSERT_EQ(crumple_follow(host, "box", 0), CRUMPLE_OK);
    until_equal(host);
  }
}

// The server is killed: its connections end at once without a message, and another process takes its port.
TEST_F(Links, AServerAHostAndAViewerComeBackWhenTheirRouterIsKilledAndStartedAnewInACrash) {
  Router router = route("tcp/127.0.0.1:0");
  const std::string at = net_endpoint(router.get());
  ImpairedLink link(at, {});
  endpoint = link.endpoint();
  server = std::make_unique<Process>(std::vector<std::string>{"serve", "--car", car_file.string(), "--connect", endpoint});
  Crumple *host = open("tester"), *viewer = open();
  ASSERT_TRUE(host && viewer);
  spawn(host);
  ASSERT_EQ(crumple_follow(viewer, "box", 0), CRUMPLE_OK);
  for (const int away : {0, 2, 5}) {  // s
    crash_anew(host);
    CrumpleCarPose pose{};
    pose.car = "box";
    pose.pose.orientation[3] = 1;
    pose.velocity[0] = 10;
    ASSERT_EQ(crumple_publish_poses(host, 0, &pose, 1), CRUMPLE_OK);  // sends again
    crumple_poll(host, 10'000);
    link.set(LinkState::cut);
    router.reset();
    std::this_thread::sleep_for(std::chrono::seconds(away));
    router = route(at);
    link.set(LinkState::up);
    const auto start = Clock::now();
    CrumpleSurface held{};
    const auto holds = [&] { return crumple_surface(viewer, "box", &held) == CRUMPLE_OK && held.alive; };
    ASSERT_TRUE(until(viewer, [&] { return !holds(); })) << "it has not seen the router go";
    ASSERT_TRUE(until(viewer, holds));
    std::printf("router away for %d s: the viewer has the car again %.0f ms after its return\n", away,
                milliseconds_since(start));
    uint64_t ticket = 0;
    CrumpleParameters keep = crumple_keep();
    CrumpleAnswer got{};
    EXPECT_TRUE(until(host, [&] {  // a command may get lost with the router
      return crumple_set_parameters(host, "box", &keep, &ticket) == CRUMPLE_OK &&
             crumple_wait(host, ticket, &got) == CRUMPLE_OK && got.ok;
    })) << "the host is not heard";
    until_equal(viewer);
  }
}

TEST_F(Links, AServerAndAViewerWaitForARouterThatIsNotThereYet) {
  std::string at;
  {
    const Router first = route("tcp/127.0.0.1:0");  // to get a free port
    at = net_endpoint(first.get());
  }
  Router router(nullptr, net_close);
  server = std::make_unique<Process>(std::vector<std::string>{"serve", "--car", car_file.string(), "--connect", at});
  std::jthread later([&] {
    std::this_thread::sleep_for(std::chrono::seconds(2));
    router = route(at);
  });
  endpoint = at;
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  spawn(host);
}

TEST_F(Links, PlainDatagramsAreRefusedWithWhatToWrite) {
  Net* net = nullptr;
  EXPECT_LT(net_open("peer", "tcp/127.0.0.1:0,udp/127.0.0.1:0", nullptr, nullptr, 0, &net), 0);
  EXPECT_NE(std::string(transport_error()).find("udp/127.0.0.1:0?rel=1"), std::string::npos) << transport_error();
}

}  // namespace
}  // namespace crumple

// Tests whole sessions from the first pose to the recording, as a user sees them.
#include <map>
#include <regex>
#include <thread>

#include "bake/load_car.h"
#include "io/net.h"
#include "program.h"
#include "schema/message_generated.h"

namespace crumple {
namespace {

class EndToEnd : public Program {};

TEST_F(EndToEnd, AnOverloadedServerShedsWorkAndItsRecordingVerifies) {
  start_server(path("overload.mcap"), {"--budget", "0.001"});
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  server->send(SIGINT);
  EXPECT_EQ(server->wait(), 0) << server->text;
  std::ifstream file(path("overload.mcap"), std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  EXPECT_NE(text.find("crumple/1/main/budget"), std::string::npos) << "the budget is one of the recorded inputs";
  const Outcome outcome = run({"replay", path("overload.mcap"), "--verify"});
  EXPECT_EQ(outcome.code, 0) << outcome.text;
}

TEST_F(EndToEnd, ADentReachesEveryViewerAndALateOneAndTheRecordingVerifies) {
  start_server(path("session.mcap"));
  Crumple* host = open("tester");
  ASSERT_NE(host, nullptr);
  ASSERT_EQ(crumple_follow(host, "box", 0), CRUMPLE_OK);
  Crumple* viewer = open();
  ASSERT_NE(viewer, nullptr);
  ASSERT_EQ(crumple_follow(viewer, nullptr, 0), CRUMPLE_OK);
  Crumple *far_viewer = open(), *comes_near = open();
  ASSERT_EQ(crumple_follow(far_viewer, nullptr, 1), CRUMPLE_OK);
  ASSERT_EQ(crumple_follow(comes_near, "box", 1), CRUMPLE_OK);
  spawn(host);
  crash(host);
  if (HasFatalFailure()) return;
  EXPECT_GT(deepest(host), 40) << "in quanta of 0.5 mm";

  const uint64_t dent = hash_held(host);
  EXPECT_TRUE(until(viewer, [&] { return hash_held(viewer) == dent; })) << "two viewers differ";
  Crumple* late = open();
  ASSERT_EQ(crumple_follow(late, nullptr, 0), CRUMPLE_OK);
  EXPECT_TRUE(until(late, [&] { return hash_held(late) == dent; })) << "the late joiner differs";

  // A late viewer of the far level gets the server's surface of that level.
  Crumple* late_far = open();
  ASSERT_EQ(crumple_follow(late_far, "box", 1), CRUMPLE_OK);
  ASSERT_TRUE(until(late_far, [&] { return hash_held(late_far) != 0; }));
  const uint64_t far_dent = hash_held(late_far);
  EXPECT_NE(far_dent, dent);
  EXPECT_NEAR(deepest(late_far), deepest(host) / 8.0, 0.6) << "in quanta of 4 mm";
  EXPECT_TRUE(until(far_viewer, [&] { return hash_held(far_viewer) == far_dent; })) << "the far viewer differs";
  ASSERT_EQ(crumple_follow(comes_near, "box", 0), CRUMPLE_OK);
  EXPECT_TRUE(until(comes_near, [&] { return hash_held(comes_near) == dent; })) << "who came near differs";

  CrumpleSurface surface{};
  ASSERT_EQ(crumple_surface(late, "box", &surface), CRUMPLE_OK);
  EXPECT_EQ(surface.asset, asset);
  EXPECT_TRUE(surface.alive);
  CrumpleMesh mesh{};
  ASSERT_TRUE(until(late, [&] { return crumple_mesh(late, asset.c_str(), &mesh) == CRUMPLE_OK; }));
  const auto baked = load_car(car_file);
  EXPECT_EQ(mesh.vertex_count, baked->model.vertex.size());
  ASSERT_EQ(surface.node_count, baked->skin_node.size());
  EXPECT_STREQ(mesh.attribution, "made by the tests");
  std::vector<float> strided(8 * size_t{mesh.vertex_count}, -1.0f);
  CrumpleVertices copied{nullptr, strided.data(), nullptr, 32, mesh.vertex_count, 0, 0, 0, 0, nullptr};
  ASSERT_EQ(crumple_copy(late, "box", &copied), CRUMPLE_OK);
  for (uint32_t v = 0; v < mesh.vertex_count; ++v) {
    float expected = 0;  // of z, in m
    for (int k = 0; k < 4; ++k) {
      const auto& nodes = baked->skin_node;
      const auto at = std::lower_bound(nodes.begin(), nodes.end(), baked->model.skin[v].node[k]) - nodes.begin();
      if (baked->model.skin[v].weight[k] > 0) expected += baked->model.skin[v].weight[k] * surface.quanta[3 * at + 2];
    }
    EXPECT_FLOAT_EQ(strided[8 * v + 2], 0.0005f * expected) << "vertex " << v;
  }
  EXPECT_EQ(strided[3], -1.0f) << "what lies between the vertices is the caller's";

  // State: saved, repaired, loaded again.
  uint64_t ticket = 0;
  const CrumpleAnswer saved = answer(host, crumple_save(host, "box", &ticket), ticket);
  ASSERT_TRUE(saved.ok);
  const std::vector<uint8_t> state(saved.state, saved.state + saved.state_size);
  EXPECT_TRUE(answer(host, crumple_repair(host, "box", 1, &ticket), ticket).ok);
  EXPECT_TRUE(until(viewer, [&] { return deepest(viewer) == 0; })) << "repair did not arrive";
  EXPECT_TRUE(until(far_viewer, [&] { return deepest(far_viewer) == 0; })) << "repair did not arrive far away";
  EXPECT_TRUE(answer(host, crumple_load(host, "box", state.data(), state.size(), &ticket), ticket).ok);
  EXPECT_TRUE(until(viewer, [&] { return hash_held(viewer) == dent; })) << "load gave another dent";
  EXPECT_TRUE(until(far_viewer, [&] { return hash_held(far_viewer) == far_dent; })) << "load gave another dent far away";

  EXPECT_TRUE(answer(host, crumple_despawn(host, "box", &ticket), ticket).ok);
  EXPECT_TRUE(until(viewer, [&] { return crumple_surface(viewer, "box", &surface) == CRUMPLE_OK && !surface.alive; }));

  server->send(SIGINT);
  EXPECT_EQ(server->wait(), 0) << server->text;
  for (const char* threads : {"1", "2", "4"}) {
    const Outcome outcome = run({"replay", path("session.mcap"), "--verify", "--threads", threads});
    EXPECT_EQ(outcome.code, 0) << outcome.text;
    EXPECT_NE(outcome.text.find("every tick identical"), std::string::npos) << outcome.text;
  }
  const Outcome info = run({"info", path("session.mcap")});
  EXPECT_EQ(info.code, 0);
  for (const char* part : {"made by the tests", "hosts tester", "car box  at", "car/box/delta/0"})
    EXPECT_NE(info.text.find(part), std::string::npos) << part << "\n" << info.text;

  // Plays the recording to a viewer that has not seen the session.
  start({"replay", path("session.mcap"), "--publish", "--loop", "--listen", "tcp/127.0.0.1:0"});
  Crumple* audience = open();
  ASSERT_NE(audience, nullptr);
  ASSERT_EQ(crumple_follow(audience, "box", 0), CRUMPLE_OK);
  EXPECT_TRUE(until(audience, [&] { return hash_held(audience) == dent; })) << "the film does not show the dent";
  Crumple* far_audience = open();
  ASSERT_EQ(crumple_follow(far_audience, "box", 1), CRUMPLE_OK);
  EXPECT_TRUE(until(far_audience, [&] { return hash_held(far_audience) == far_dent; })) << "nor to those far away";
  Net* opened = nullptr;
  ASSERT_EQ(net_open("client", nullptr, endpoint.c_str(), nullptr, 30'000, &opened), 0) << transport_error();
  const std::unique_ptr<Net, decltype(&net_close)> late_audience(opened, net_close);
  float quantum = 0;
  uint64_t asking = 0;
  for (const auto deadline = Clock::now() + patience; quantum == 0 && Clock::now() < deadline;) {
    if (asking == 0) net_get(opened, "crumple/1/main/car/box/key/1", nullptr, 0, 1000, &asking);
    NetEvent events[8];
    for (int k = 0, got = net_poll(opened, events, 8, 100'000); k < got; ++k) {
      if (events[k].kind == NET_REPLY && !events[k].failed)
        quantum = flatbuffers::GetRoot<schema::Keyframe>(events[k].data)->quantum();
      if (events[k].kind == NET_REPLY_END) asking = 0;
    }
  }
  EXPECT_EQ(quantum, 0.004f) << "of the keyframe that answers who comes late and far";
}

// Two servers and a router. The test kills the owner of the scene in the middle of the crash.
TEST_F(EndToEnd, ASessionOnABadLineOfItsOwnIsLateAndEndsWithTheSurfaceOfTheOthers) {
  start_server(path("impaired.mcap"));
  Crumple *host = open("tester"), *deaf = open(), *late = open(), *near = open();
  const CrumpleImpairment nothing_comes{0, 0, 1, 0, 1}, bad{0.25f, 0.05f, 0.1f, 0.1f, 2}, good{}, wrong{0, 0, 1.5f, 0, 0};
  EXPECT_EQ(crumple_impair(deaf, &wrong), CRUMPLE_BAD_ARGUMENT);
  ASSERT_EQ(crumple_impair(deaf, &nothing_comes), CRUMPLE_OK) << crumple_error();
  ASSERT_EQ(crumple_impair(late, &bad), CRUMPLE_OK) << crumple_error();
  spawn(host);
  ASSERT_EQ(crumple_impair(host, &bad), CRUMPLE_OK) << crumple_error();  // also delays its poses
  for (Crumple* viewer : {deaf, late, near}) ASSERT_EQ(crumple_follow(viewer, "box", 0), CRUMPLE_OK);
  const auto surface = [](Crumple* viewer) {
    CrumpleSurface held{};
    return crumple_surface(viewer, "box", &held) == CRUMPLE_OK ? held : CrumpleSurface{};
  };
  for (Crumple* viewer : {deaf, late, near})  // they get it as answers to queries, which these links do not delay
    ASSERT_TRUE(until(viewer, [&] { return surface(viewer).hash != 0; }));
  const uint64_t whole = surface(deaf).hash;
  std::atomic<bool> over = false;
  std::map<uint64_t, Clock::time_point> first[2];  // by tick: the times at which `late` and `near` first held it
  std::thread both([&] {
    while (!over) {
      crumple_poll(deaf, 0);  // polled, because a session that was not polled for long asks for lost messages
      for (int k = 0; k < 2; ++k) {
        crumple_poll(k == 0 ? late : near, 1'000);
        first[k].try_emplace(surface(k == 0 ? late : near).tick, Clock::now());
      }
    }
  });
  crash(host);
  over = true;
  both.join();
  if (HasFatalFailure()) return;
  EXPECT_EQ(surface(deaf).hash, whole) << "it hears nothing";
  auto most = Clock::duration::zero();  // if the machine pauses in between, the difference gets smaller
  for (const auto& [tick, when] : first[0])
    if (first[1].contains(tick)) most = std::max(most, Clock::duration(when - first[1].at(tick)));
  EXPECT_GE(most, std::chrono::milliseconds(150));
  ASSERT_EQ(crumple_impair(deaf, &good), CRUMPLE_OK);
  ASSERT_TRUE(until(near, [&] { return surface(near).hash != whole; }));
  const uint64_t dented = surface(near).hash;
  for (Crumple* viewer : {late, deaf}) EXPECT_TRUE(until(viewer, [&] { return surface(viewer).hash == dented; }));
}

TEST_F(EndToEnd, AServerThatStandsByGoesOnWhereTheOwnerWasKilled) {
  Net* opened = nullptr;
  ASSERT_EQ(net_open("router", "tcp/127.0.0.1:0", nullptr, nullptr, 0, &opened), 0) << transport_error();
  const std::unique_ptr<Net, decltype(&net_close)> router(opened, net_close);
  const std::string recording = path("after.mcap");
  const auto serve = [&](const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"serve", "--car", car_file.string(), "--connect", net_endpoint(router.get())};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return std::make_unique<Process>(arguments);
  };
  auto owner = serve({});
  ASSERT_TRUE(owner->read_until("levels")) << owner->text;
  endpoint = net_endpoint(router.get());
  Crumple *host = open("game"), *viewer = open();
  spawn(host);
  ASSERT_EQ(crumple_follow(viewer, "box", 0), CRUMPLE_OK);
  Crumple* far_viewer = open();
  ASSERT_EQ(crumple_follow(far_viewer, "box", 1), CRUMPLE_OK);
  auto standby = serve({"--standby", "--record", recording});
  ASSERT_TRUE(standby->read_until("holds the world")) << standby->text;

  // Sends the last pose: from here on only the servers move the car.
  CrumpleObstacle wall{};
  wall.shape = CRUMPLE_BOX;
  wall.size[0] = 1, wall.size[1] = 3, wall.size[2] = 3;
  wall.pose = {{2.25 + 0.3 + 1, 0, 0}, {0, 0, 0, 1}};
  ASSERT_EQ(crumple_publish_obstacles(host, &wall, 1), CRUMPLE_OK) << crumple_error();
  CrumpleCarPose pose{};
  pose.car = "box";
  pose.pose.orientation[3] = 1;
  pose.velocity[0] = 10;
  ASSERT_EQ(crumple_publish_poses(host, 0, &pose, 1), CRUMPLE_OK) << crumple_error();
  ASSERT_TRUE(until(viewer, [&] { return deepest(viewer) > 20; })) << "no dent";
  owner->send(SIGKILL);
  const auto killed = Clock::now();
  const int dent = deepest(viewer);
  CrumpleSurface held{};
  crumple_surface(viewer, "box", &held);
  const uint64_t tick = held.tick;
  ASSERT_TRUE(standby->read_until("takes over")) << standby->text;
  EXPECT_EQ(standby->text.find("did not hold"), std::string::npos) << standby->text;
  const auto told_anew = [&] { return crumple_surface(viewer, "box", &held) == CRUMPLE_OK && held.tick > tick && held.alive; };
  ASSERT_TRUE(until(viewer, told_anew));
  const double seconds = std::chrono::duration<double>(Clock::now() - killed).count();
  std::printf("the viewer holds the next tick %.0f ms after the kill\n", 1e3 * seconds);
  EXPECT_LT(seconds, 30) << "5 s on a machine that does nothing else";
  EXPECT_GT(deepest(viewer), dent / 2) << "the dents of the killed server";

  // After the crash a new viewer gets the same surface.
  ASSERT_TRUE(until(host, [&] {
    CrumpleReaction reaction;
    bool calm = false;
    while (crumple_take_reactions(host, &reaction, 1) == 1) calm = reaction.contacts == 0 && reaction.tick > tick + 30;
    return calm;
  }));
  ASSERT_TRUE(until(viewer, [&] { return hash_held(viewer) != 0; }));
  Crumple* late = open();
  ASSERT_EQ(crumple_follow(late, "box", 0), CRUMPLE_OK);
  EXPECT_TRUE(until(late, [&] {
    crumple_poll(viewer, 10'000);
    return hash_held(late) != 0 && hash_held(late) == hash_held(viewer);
  }));
  Crumple* late_far = open();
  ASSERT_EQ(crumple_follow(late_far, "box", 1), CRUMPLE_OK);
  EXPECT_TRUE(until(late_far, [&] {
    crumple_poll(far_viewer, 10'000);
    return hash_held(late_far) != 0 && hash_held(late_far) == hash_held(far_viewer);
  }));
  standby->send(SIGTERM);
  EXPECT_EQ(standby->wait(), 0) << standby->text;
  const Outcome verified = run({"replay", recording, "--verify"});
  EXPECT_EQ(verified.code, 0) << verified.text;
}

// Two standbys. One is behind a separate router, which ends and starts again.
TEST_F(EndToEnd, OneOfTwoThatStandByGoesOnAndNoneWhoseOwnLineIsCut) {
  using Router = std::unique_ptr<Net, decltype(&net_close)>;
  const auto route = [](const std::string& at, const char* to) {
    Net* opened = nullptr;
    EXPECT_EQ(net_open("router", at.c_str(), to, nullptr, 0, &opened), 0) << transport_error();
    return Router(opened, net_close);
  };
  const Router router = route("tcp/127.0.0.1:0", nullptr);
  endpoint = net_endpoint(router.get());
  Router far = route("tcp/127.0.0.1:0", endpoint.c_str());
  const std::string far_endpoint = net_endpoint(far.get());
  const auto serve = [&](const std::string& at, bool standby) {
    std::vector<std::string> arguments = {"serve", "--car", car_file.string(), "--connect", at};
    if (standby) arguments.push_back("--standby");
    return std::make_unique<Process>(arguments);
  };
  const auto owner = serve(endpoint, false);
  Crumple* host = open("game");
  ASSERT_NE(host, nullptr);
  spawn(host);
  const auto near_one = serve(endpoint, true), far_one = serve(far_endpoint, true);
  ASSERT_TRUE(near_one->read_until("holds the world")) << near_one->text;
  ASSERT_TRUE(far_one->read_until("holds the world")) << far_one->text;

  far_one->text.clear();
  far.reset();
  std::this_thread::sleep_for(std::chrono::seconds(4));  // longer than all delays before a takeover
  far = route(far_endpoint, endpoint.c_str());
  ASSERT_TRUE(far_one->read_until("holds the world")) << far_one->text;
  EXPECT_EQ(far_one->text.find("takes over"), std::string::npos) << far_one->text;
  CrumpleParameters keep = crumple_keep();
  uint64_t ticket = 0;
  EXPECT_TRUE(answer(host, crumple_set_parameters(host, "box", &keep, &ticket), ticket).ok) << "the owner serves on";

  // Two standbys that do not know of each other yet would both take over, and one would end. The far one has only just
  // returned.
  std::this_thread::sleep_for(std::chrono::seconds(1));
  owner->send(SIGKILL);
  ASSERT_EQ(crumple_follow(host, "box", 0), CRUMPLE_OK);
  CrumpleSurface held{};
  EXPECT_TRUE(until(host, [&] { return crumple_surface(host, "box", &held) == CRUMPLE_OK && held.alive; }));
  // Only one may take over, because the other sees its token.
  std::this_thread::sleep_for(std::chrono::seconds(3));
  int owners = 0;
  for (const auto& one : {near_one.get(), far_one.get()}) {
    one->send(SIGTERM);
    const int code = one->wait();
    const bool took = one->text.find("takes over") != std::string::npos;
    EXPECT_EQ(code, 0) << one->text;
    owners += took;
  }
  EXPECT_EQ(owners, 1) << near_one->text << far_one->text;
}

TEST_F(EndToEnd, ASceneHasOneServer) {
  Net* opened = nullptr;
  ASSERT_EQ(net_open("router", "tcp/127.0.0.1:0", nullptr, nullptr, 0, &opened), 0) << transport_error();
  const std::unique_ptr<Net, decltype(&net_close)> router(opened, net_close);
  const std::vector<std::string> arguments = {"serve", "--car", car_file.string(), "--connect", net_endpoint(router.get())};
  Process owner(arguments);
  endpoint = net_endpoint(router.get());
  ASSERT_NE(open(), nullptr) << "it serves";
  const Outcome second = run(arguments);
  EXPECT_EQ(second.code, 1);
  EXPECT_NE(second.text.find("has a server already"), std::string::npos) << second.text;
  // An owner that was cut off meets the token of a later epoch.
  ASSERT_EQ(net_announce(router.get(), "crumple/1/main/owner/2-abc"), 0) << transport_error();
  EXPECT_EQ(owner.wait(), 1);
  EXPECT_NE(owner.text.find("another server has taken over"), std::string::npos) << owner.text;
}

TEST_F(EndToEnd, DriveAndWatchDoWhatTheySay) {
  start_server(path("drive.mcap"));
  std::ofstream(path("scene.json")) << R"({"about": "Into a wall.", "mass": 1000,
    "parameters": [{"young_modulus": 4e6, "region": -1}],
    "obstacles": [{"shape": "box", "size": {"x": 1, "y": 3, "z": 3},
                   "pose": {"position": {"x": 4, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}}],
    "hits": [{"position": {"x": 0, "y": 0, "z": 0}, "direction": {"x": 1, "y": 0, "z": 0}, "speed_kmh": 36, "seconds": 1}]})";
  const Outcome drive = run({"drive", path("scene.json"), "--car", car_file.string(), "--connect", endpoint, "--leave"});
  EXPECT_EQ(drive.code, 0) << drive.text;
  for (const char* part : {"contact at 36.0 km/h", "residual crush", "36.0 km/h", "made by the tests"})
    EXPECT_NE(drive.text.find(part), std::string::npos) << part << "\n" << drive.text;
  const Outcome far_watch = run({"watch", "--once", "--level", "1", "--connect", endpoint});
  EXPECT_NE(far_watch.text.find("quantum 4 mm"), std::string::npos) << far_watch.text;
  const Outcome watch = run({"watch", "--once", "--connect", endpoint, "--obj", path("dent.obj")});
  EXPECT_EQ(watch.code, 0) << watch.text;
  EXPECT_NE(watch.text.find("hash "), std::string::npos) << watch.text;
  std::ifstream obj(path("dent.obj"));
  const std::string text{std::istreambuf_iterator<char>(obj), {}};
  EXPECT_NE(text.find("made by the tests"), std::string::npos);
  EXPECT_NE(text.find("\nf "), std::string::npos);

  // A preset overrides the scene's parameters.
  std::ofstream(path("stiff.json")) << R"({"about": "Ten times as stiff.", "parameters": [{"young_modulus": 4e7}]})";
  const Outcome stiff = run({"drive", path("scene.json"), "--preset", path("stiff.json"), "--car", car_file.string(),
                             "--connect", endpoint, "--id", "stiff"});
  EXPECT_EQ(stiff.code, 0) << stiff.text;
  const auto crush = [](const Outcome& of) {
    std::smatch found;
    return std::regex_search(of.text, found, std::regex(" g +([0-9]+) mm")) ? std::stoi(found[1]) : -1;
  };
  EXPECT_GT(crush(stiff), 0) << stiff.text;
  EXPECT_LT(crush(stiff), crush(drive)) << stiff.text << drive.text;
}

// A scene of two hosts, which drive two cars at each other. Both are told of each other, a third program sees both dents, and
// the recording verifies.
TEST_F(EndToEnd, TwoHostsCrashTheirCarsIntoEachOther) {
  start_server(path("head_on.mcap"));
  Crumple* viewer = open();
  ASSERT_NE(viewer, nullptr);
  ASSERT_EQ(crumple_follow(viewer, nullptr, 0), CRUMPLE_OK);
  Crumple* hosts[2] = {open("left"), open("right")};  // hear what the two programs are told
  std::ofstream(path("two.json")) << R"({"about": "Two cars of two hosts.", "obstacles": [], "cars": [
    {"id": "left", "host": "left", "hits": [{"position": {"x": -9, "y": 0, "z": 0}, "direction": {"x": 1, "y": 0, "z": 0},
     "speed_kmh": 36, "seconds": 2}]},
    {"id": "right", "host": "right", "mass": 1300, "hits": [{"position": {"x": 9, "y": 0, "z": 0}, "yaw_deg": 180,
     "direction": {"x": -1, "y": 0, "z": 0}, "speed_kmh": 36, "seconds": 2}]}]})";
  const std::vector<std::string> drive = {"drive", path("two.json"), "--car", car_file.string(), "--connect", endpoint};
  std::vector<std::string> with_id = drive;
  with_id.insert(with_id.end(), {"--id", "other"});
  EXPECT_NE(run(with_id).text.find("the scene names its cars"), std::string::npos);
  std::vector<std::string> leave = drive;
  leave.push_back("--leave");
  const Outcome driven = run(leave);
  EXPECT_EQ(driven.code, 0) << driven.text;
  for (const char* part : {"left: contact at 36.0 km/h", "right: contact at 36.0 km/h", "1300 kg", "\n  left ", "\n  right "})
    EXPECT_NE(driven.text.find(part), std::string::npos) << part << "\n" << driven.text;

  std::map<uint64_t, float> given[2];  // by tick, N s along x
  const auto hear = [&](int k) {
    CrumpleReaction reaction;
    bool over = false;
    while (crumple_take_reactions(hosts[k], &reaction, 1) == 1) {
      over = reaction.partner_count == 0 && !given[k].empty();
      if (reaction.partner_count == 0) continue;
      EXPECT_EQ(reaction.partner_count, 1u);
      EXPECT_STREQ(reaction.partners->car, k == 0 ? "right" : "left");
      EXPECT_STREQ(reaction.partners->host, k == 0 ? "right" : "left");
      given[k][reaction.tick] = reaction.partners->impulse[0];
    }
    return over;
  };
  for (int k = 0; k < 2; ++k) EXPECT_TRUE(until(hosts[k], [&] { return hear(k); })) << "no reaction names the other car";
  size_t compared = 0;
  for (const auto& [tick, impulse] : given[0]) {
    const auto other = given[1].find(tick);
    if (other == given[1].end()) continue;  // a busy machine may lose one
    ++compared;
    EXPECT_EQ(impulse, -other->second) << "tick " << tick;
  }
  EXPECT_GT(compared, 0u);

  Outcome watch;
  const auto has = [&](const char* text) { return watch.text.find(text) != std::string::npos; };
  for (int k = 0; k < 20 && !(has("car left") && has("car right")); ++k)  // it may end with the first car
    watch = run({"watch", "--once", "--connect", endpoint});
  for (const char* id : {"left", "right"}) {
    CrumpleSurface surface{};
    int most = 0;
    const auto same = [&] {
      if (crumple_surface(viewer, id, &surface) != CRUMPLE_OK) return false;
      for (uint32_t i = 0; i < 3 * surface.node_count; ++i) most = std::max(most, std::abs(int(surface.quanta[i])));
      char hash[20];
      std::snprintf(hash, sizeof hash, "%016llx", static_cast<unsigned long long>(surface.hash));
      return watch.text.find(hash) != std::string::npos;
    };
    EXPECT_TRUE(until(viewer, same)) << id << "\n" << watch.text;
    EXPECT_GT(most, 60) << "3 cm, in quanta of 0.5 mm";
  }
  server->send(SIGINT);
  EXPECT_EQ(server->wait(), 0) << server->text;
  const Outcome outcome = run({"replay", path("head_on.mcap"), "--verify"});
  EXPECT_EQ(outcome.code, 0) << outcome.text;
  EXPECT_NE(outcome.text.find("every tick identical"), std::string::npos) << outcome.text;
}

TEST_F(EndToEnd, ExitCodesAndErrorsSayWhatToDo) {
  EXPECT_EQ(run({"--help"}).code, 0);
  EXPECT_EQ(run({"serve", "--help"}).code, 0);
  EXPECT_EQ(run({}).code, 2);
  EXPECT_EQ(run({"serve", "--car", car_file.string(), "--rate", "-3"}).code, 2);
  EXPECT_EQ(run({"replay", car_file.string()}).code, 2);
  for (const char* verb : {"serve", "watch", "view"}) {
    std::vector<std::string> arguments = {verb, "--scene", "asset"};
    if (*verb == 's') arguments.insert(arguments.end(), {"--car", car_file.string()});
    const Outcome of_cars = run(arguments);
    EXPECT_EQ(of_cars.code, 2) << of_cars.text;
    EXPECT_NE(of_cars.text.find("\"asset\" cannot name a scene, because the keys of baked cars begin with it"),
              std::string::npos)
        << of_cars.text;
  }
  const Outcome not_recording = run({"replay", car_file.string(), "--verify"});
  EXPECT_EQ(not_recording.code, 1);
  EXPECT_NE(not_recording.text.find("box.car"), std::string::npos) << not_recording.text;
  std::ofstream(path("bad.car")) << "not a car";
  const Outcome bad_car = run({"serve", "--car", path("bad.car"), "--listen", "tcp/127.0.0.1:0"});
  EXPECT_EQ(bad_car.code, 1);
  EXPECT_NE(bad_car.text.find("bad.car"), std::string::npos) << bad_car.text;
  const Outcome nowhere = run({"watch", "--once", "--connect", "tcp/127.0.0.1:1"});
  EXPECT_EQ(nowhere.code, 1);
  EXPECT_NE(nowhere.text.find("crumple serve"), std::string::npos) << nowhere.text;
}

}  // namespace
}  // namespace crumple

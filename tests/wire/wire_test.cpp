// Tests wire: which messages are refused and with which sentence, and the surface of a viewer after keyframes and deltas.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "host.h"
#include "tick/levels.h"
#include "tick/surface_update.h"
#include "wire/encode.h"

namespace crumple {
namespace {

using host::CarPose;
using host::pose_at;
using host::Thing;

constexpr float nan = std::numeric_limits<float>::quiet_NaN();
constexpr float infinity = std::numeric_limits<float>::infinity();
const std::string asset = "0123456789abcdef";

template <class Message>
void expect_refused(const Bytes& bytes, Reason reason, const std::string& words, const Limits& limits = {}) {
  Message out;
  const std::optional<Refusal> refusal = decode(bytes, limits, out);
  ASSERT_TRUE(refusal) << "should name " << words;
  EXPECT_STREQ(reason_names[size_t(refusal->reason)], reason_names[size_t(reason)]) << refusal->sentence;
  EXPECT_NE(refusal->sentence.find(words), std::string::npos) << refusal->sentence;
}

template <class Message>
Message expect_taken(const Bytes& bytes, const Limits& limits = {}) {
  Message out;
  const std::optional<Refusal> refusal = decode(bytes, limits, out);
  EXPECT_FALSE(refusal) << refusal->sentence;
  return out;
}

TEST(Decode, TakesPosesAndNormalisesOrientations) {
  CarPose car{"a", {{1, 2, 3}, {0, 0, 0, 1.0009f}}, {4, 5, 6}, {7, 8, 9}, 12, 0.25f};
  const auto intents = expect_taken<Intents>(host::poses(5, {car, {"b"}}, 1.5));
  EXPECT_EQ(intents.sequence, 5u);
  EXPECT_EQ(intents.time, 1.5);
  ASSERT_EQ(intents.cars.size(), 2u);
  EXPECT_EQ(intents.cars[0].car, "a");
  EXPECT_EQ(intents.cars[0].seen, 12u);
  EXPECT_EQ(intents.cars[0].importance, 0.25f);
  EXPECT_EQ(intents.cars[1].importance, 1.0f);
  EXPECT_EQ(intents.cars[0].motion.pose.position, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(intents.cars[0].motion.pose.orientation.w(), 1);
  EXPECT_EQ(intents.cars[0].motion.velocity, Eigen::Vector3d(4, 5, 6));
  EXPECT_EQ(intents.cars[0].motion.angular_velocity, Eigen::Vector3d(7, 8, 9));
}

TEST(Decode, RefusesAPoseFieldByFieldAndNamesIt) {
  const auto with = [](CarPose car) { return host::poses(1, {{"first"}, car}); };
  expect_refused<Intents>(with({""}), Reason::bad_id, "cars[1].car is \"\"");
  expect_refused<Intents>(with({"a/b"}), Reason::bad_id, "cars[1].car");
  expect_refused<Intents>(with({std::string(33, 'a')}), Reason::bad_id, "32 characters");
  expect_refused<Intents>(with({"a", pose_at(nan)}), Reason::non_finite, "cars[1].pose");
  expect_refused<Intents>(with({"a", pose_at(1'000'001)}), Reason::out_of_range, "1000001 m from the origin; 1000000 m");
  expect_refused<Intents>(with({"a", {{0, 0, 0}, {0, 0, 0, 1.0011f}}}), Reason::out_of_range,
                          "cars[1].pose has an orientation");
  expect_refused<Intents>(with({"a", {{0, 0, 0}, {0, 0, 0, 0}}}), Reason::out_of_range, "norm 0");
  expect_refused<Intents>(with({"a", {{0, 0, 0}, {0, nan, 0, 1}}}), Reason::non_finite, "cars[1].pose");
  expect_refused<Intents>(with({"a", pose_at(0), {0, 501, 0}}), Reason::out_of_range,
                          "cars[1].velocity is 501 m/s long; 500 m/s");
  expect_refused<Intents>(with({"a", pose_at(0), {0, -infinity, infinity}}), Reason::non_finite, "cars[1].velocity");
  expect_refused<Intents>(with({"a", pose_at(0), {0, 0, 0}, {1001, 0, 0}}), Reason::out_of_range, "cars[1].angular_velocity");
  CarPose vain{"a"};
  vain.importance = 1.5f;
  expect_refused<Intents>(with(vain), Reason::out_of_range, "cars[1].importance is 1.5; allowed are 0 to 1");
  expect_refused<Intents>(with({"first"}), Reason::duplicate, "cars names first twice");
  expect_refused<Intents>(host::poses(1, {{"a"}}, nan), Reason::non_finite, "time");
}

TEST(Decode, TakesPosesAtTheirLimits) {
  CarPose car{std::string(32, 'a'), pose_at(-1e6), {500, 0, 0}, {0, 0, -1000}};
  expect_taken<Intents>(host::poses(1, {car}));
  std::vector<CarPose> cars;
  for (int i = 0; i < 1000; ++i) cars.push_back({std::to_string(i)});
  expect_taken<Intents>(host::poses(1, cars));
  cars.push_back({"one-more"});
  expect_refused<Intents>(host::poses(1, cars), Reason::too_many_cars, "cars has 1001 entries; 1000 are allowed");
}

TEST(Decode, RefusesAMessageThatIsTooLarge) {
  Limits limits;
  const Bytes bytes = host::poses(1, {{"a"}});
  limits.message_size = uint32_t(bytes.size());
  expect_taken<Intents>(bytes, limits);
  --limits.message_size;
  expect_refused<Intents>(bytes, Reason::too_large, "bytes", limits);
  expect_refused<Order>(host::despawn(), Reason::too_large, "7 are allowed", [] {
    Limits tiny;
    tiny.message_size = 7;
    return tiny;
  }());
}

TEST(Decode, RefusesWhatIsNoTable) {
  expect_refused<Intents>({}, Reason::malformed, "poses (0 bytes) is not a Poses table");
  expect_refused<ObstacleList>(Bytes(100, std::byte{0xff}), Reason::malformed, "obstacles (100 bytes) is not a Obstacles");
  expect_refused<Order>(Bytes(3), Reason::malformed, "Command");
}

// Every entry of the list refers to the same table: 1 kB would be read as a million cars.
TEST(Decode, FindsTheSequenceThatOrdersSamplesWithoutTheRest) {
  const auto in = [](const Bytes& bytes) { return sequence_of(bytes); };
  const auto later = [](const Bytes& a, const Bytes& b) {
    return has_later_sequence(reinterpret_cast<const uint8_t*>(a.data()), a.size(), reinterpret_cast<const uint8_t*>(b.data()),
                              b.size()) != 0;
  };
  const Bytes first = host::poses(0, {{"a"}}), last = host::poses(UINT64_MAX, {{"a"}}), none;
  EXPECT_EQ(in(first), 0u) << "FlatBuffers leave a zero out";
  EXPECT_EQ(in(last), UINT64_MAX);
  EXPECT_EQ(in(host::obstacles(7, {{}})), 7u);
  EXPECT_TRUE(later(last, first) && later(first, none));
  EXPECT_FALSE(later(first, last) || later(last, last) || later(none, first) || later(none, none));
  // No bytes make it read outside of them, and it agrees with `decode` about each message that is one.
  const Bytes whole = host::obstacles(300, {{1}, {2}});
  int taken = 0;
  for (size_t k = 0; k < whole.size(); ++k) {
    in(Bytes(whole.begin(), whole.begin() + ptrdiff_t(k)));
    for (int bit = 0; bit < 8; ++bit) {
      Bytes flipped = whole;
      flipped[k] ^= std::byte(1 << bit);
      const auto sequence = in(flipped);
      ObstacleList list;
      if (decode(flipped, {}, list)) continue;
      EXPECT_EQ(sequence, list.sequence);
      ++taken;
    }
  }
  EXPECT_GT(taken, 0);
}

TEST(Decode, RefusesAForgedListBeforeItReadsIt) {
  host::Builder builder;
  const schema::Pose pose = pose_at(0);
  const schema::Vec3 none(0, 0, 0);
  const auto car = schema::CreateCarPoseDirect(builder, "a", &pose, &none, &none);
  const std::vector<flatbuffers::Offset<schema::CarPose>> list(100'000, car);
  expect_refused<Intents>(host::done(builder, schema::CreatePosesDirect(builder, 1, 0, &list)), Reason::malformed,
                          "too many tables");
}

TEST(Decode, SortsObstaclesByIdAndMakesEveryShape) {
  const std::vector<schema::Vec3> corners = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  Thing box{5, schema::Shape::box, {1, 2, 3}}, sphere{4, schema::Shape::sphere, {2, 0, 0}};
  Thing capsule{3, schema::Shape::capsule, {0.5f, 2, 0}}, ground{2, schema::Shape::half_space};
  Thing hull{1, schema::Shape::hull};
  hull.points = corners;
  sphere.velocity = {1, 2, 3};
  const auto list = expect_taken<ObstacleList>(host::obstacles(9, {box, sphere, capsule, ground, hull}));
  EXPECT_EQ(list.sequence, 9u);
  ASSERT_EQ(list.obstacles.size(), 5u);
  EXPECT_EQ(list.obstacles[0].faces.size(), 4u);
  EXPECT_EQ(list.obstacles[1].faces.size(), 1u);
  EXPECT_EQ(list.obstacles[2].half_length, 2);
  EXPECT_EQ(list.obstacles[2].radius, 0.5f);
  EXPECT_EQ(list.obstacles[3].radius, 2);
  EXPECT_EQ(list.obstacles[3].velocity, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(list.obstacles[4].faces.size(), 6u);
}

TEST(Decode, RefusesAnObstacleFieldByFieldAndNamesIt) {
  const auto with = [](Thing thing) {
    thing.id = 7;
    return host::obstacles(1, {Thing{}, thing});
  };
  using schema::Shape;
  expect_refused<ObstacleList>(with({0, Shape::box, {1, 0.0009f, 1}}), Reason::out_of_range, "obstacles[1].size.y");
  expect_refused<ObstacleList>(with({0, Shape::box, {1, 1, 10'001}}), Reason::out_of_range, "allowed are 0.001 to 10000 m");
  expect_refused<ObstacleList>(with({0, Shape::sphere, {-1, 0, 0}}), Reason::out_of_range, "obstacles[1].size.x is -1 m");
  expect_refused<ObstacleList>(with({0, Shape::capsule, {1, -0.1f, 0}}), Reason::out_of_range, "obstacles[1].size.y");
  expect_refused<ObstacleList>(with({0, Shape::capsule, {1, nan, 0}}), Reason::non_finite, "obstacles[1].size.y");
  expect_refused<ObstacleList>(with({0, Shape(5)}), Reason::malformed, "obstacles[1].shape is 5");
  expect_refused<ObstacleList>(with({0, Shape::hull}), Reason::bad_hull, "obstacles[1].points is absent");
  expect_refused<ObstacleList>(with({0, Shape::box, {1, 1, 1}, pose_at(nan)}), Reason::non_finite, "obstacles[1].pose");
  expect_refused<ObstacleList>(with({0, Shape::box, {1, 1, 1}, pose_at(0), {600, 0, 0}}), Reason::out_of_range,
                               "obstacles[1].velocity");
  expect_refused<ObstacleList>(with({0, Shape::box, {1, 1, 1}, pose_at(0), {0, 0, 0}, 10.5f}), Reason::out_of_range,
                               "obstacles[1].friction is 10.5; allowed are 0 to 10");
  expect_refused<ObstacleList>(with({0, Shape::box, {1, 1, 1}, pose_at(0), {0, 0, 0}, -0.1f}), Reason::out_of_range,
                               "friction");
  Thing hull{0, Shape::hull};
  hull.points = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}};
  expect_refused<ObstacleList>(with(hull), Reason::bad_hull,
                               "obstacles[1].points is refused: the points of a hull span no volume");
  hull.points[3] = {nan, 0, 0};
  expect_refused<ObstacleList>(with(hull), Reason::non_finite, "obstacles[1].points");
  hull.points.assign(33, {1, 2, 3});
  expect_refused<ObstacleList>(with(hull), Reason::bad_hull, "has 33 entries; a hull may have 32");
}

TEST(Decode, RefusesTooManyObstaclesAndHullsThatCostTooMuch) {
  std::vector<Thing> things(1000);
  for (uint32_t i = 0; i < 1000; ++i) things[i].id = i;
  expect_taken<ObstacleList>(host::obstacles(1, things));
  things.push_back({1000});
  expect_refused<ObstacleList>(host::obstacles(1, things), Reason::too_many_obstacles,
                               "obstacles has 1001 entries; 1000 are allowed");
  things.resize(2);
  expect_refused<ObstacleList>(host::obstacles(1, {things[0], things[0]}), Reason::duplicate, "obstacles names id 0 twice");
  Thing hull{0, schema::Shape::hull};
  hull.points.assign(32, {1, 2, 3});
  std::vector<Thing> hulls(129, hull);
  for (uint32_t i = 0; i < hulls.size(); ++i) hulls[i].id = i;
  expect_refused<ObstacleList>(host::obstacles(1, hulls), Reason::too_many_obstacles,
                               "points of all hulls has 4128 entries; 4096");
  // All triples of a hull's points are tried: 32 points have 4960 triples, 8 points have 56.
  for (size_t k = 0; k < 32; ++k) hull.points[k] = {k < 16 ? 0.0f : 1.0f, float(k % 4), float(k / 4 % 4)};
  hulls.assign(13, hull);
  for (uint32_t i = 0; i < hulls.size(); ++i) hulls[i].id = i;
  expect_refused<ObstacleList>(host::obstacles(1, hulls), Reason::too_many_obstacles, "hulls need 64480 triples");
  hulls.pop_back();
  expect_taken<ObstacleList>(host::obstacles(1, hulls));
}

TEST(Decode, RefusesASpawnFieldByFieldAndNamesIt) {
  const auto with = [](auto fill) {
    host::Builder builder;
    const auto name = builder.CreateString(asset), owner = builder.CreateString("game");
    const schema::Pose pose = pose_at(0);
    schema::SpawnBuilder spawn(builder);
    spawn.add_asset(name);
    spawn.add_host(owner);
    spawn.add_pose(&pose);
    fill(spawn);
    return host::command(builder, spawn.Finish());
  };
  const auto mass = [&](float kg) { return with([kg](auto& spawn) { spawn.add_mass(kg); }); };
  const schema::Vec3 inertia(1, 1, 2e9f), center(0, 0, 10.1f), fine(1, 1, 1);
  expect_taken<Order>(mass(1e6f));
  expect_refused<Order>(mass(1.1e6f), Reason::out_of_range, "spawn.mass is 1100000 kg");
  expect_refused<Order>(mass(-1), Reason::out_of_range, "spawn.mass");
  expect_refused<Order>(mass(0.5f), Reason::out_of_range, "spawn.mass is below 1 kg");
  expect_refused<Order>(mass(infinity), Reason::non_finite, "spawn.mass");
  expect_refused<Order>(with([&](auto& spawn) { spawn.add_inertia(&fine); }), Reason::out_of_range,
                        "spawn.mass is 0 (as baked)");
  expect_refused<Order>(with([&](auto& spawn) {
                          spawn.add_mass(1000);
                          spawn.add_inertia(&inertia);
                        }),
                        Reason::out_of_range, "spawn.inertia.z");
  expect_refused<Order>(with([&](auto& spawn) {
                          spawn.add_mass(1000);
                          spawn.add_center_of_mass(&center);
                        }),
                        Reason::out_of_range, "spawn.center_of_mass");
  expect_refused<Order>(host::spawn("0123456789ABCDEF", "game"), Reason::bad_id,
                        "spawn.asset is \"0123456789ABCDEF\"; 16 digits");
  expect_refused<Order>(host::spawn(asset, "a game"), Reason::bad_id, "spawn.host is \"a game\"");
  expect_refused<Order>(host::spawn(asset, "game", pose_at(infinity)), Reason::non_finite, "spawn.pose");
}

TEST(Decode, RefusesOrdersThatAreNoneAndNumbersOutOfRange) {
  expect_refused<Order>(host::repair(1.01f), Reason::out_of_range, "repair.amount");
  expect_refused<Order>(host::repair(nan), Reason::non_finite, "repair.amount");
  expect_refused<Order>(host::replace("0123456789ABCDEF"), Reason::bad_id, "replace.asset is \"0123456789ABCDEF\"; 16 digits");
  expect_refused<Order>(host::parameters([](auto& p) { p.add_yield_strain(nan); }), Reason::non_finite,
                        "parameters.yield_strain");
  expect_refused<Order>(host::parameters([](auto& p) { p.add_region(16); }), Reason::out_of_range, "parameters.region is 16");
  expect_refused<Order>(host::parameters([](auto& p) { p.add_region(-2); }), Reason::out_of_range, "parameters.region is -2");
  expect_refused<Order>(host::parameters([](auto& p) { p.add_solver(schema::Solver(2)); }), Reason::malformed,
                        "parameters.solver");
  expect_refused<Order>(host::load(Bytes(10)), Reason::malformed, "load.state (10 bytes) is not a State table");
  host::Builder builder;
  const auto save = schema::CreateSave(builder);
  expect_refused<Order>(host::done(builder, schema::CreateCommand(builder, schema::Order(9), save.Union())), Reason::malformed,
                        "command.order is of kind 9");
}

TEST(Decode, ChangesOnlyTheParametersThatAreThere) {
  const auto order = expect_taken<Order>(host::parameters([](auto& p) {
    p.add_solver(schema::Solver::classic);
    p.add_region(2);
    p.add_yield_strain(0.5f);
  }));
  Parameters parameters, expected;
  apply(std::get<ParametersOrder>(order), parameters);
  expected.solver = Solver::classic;
  expected.region[2].yield_strain = 0.5f;
  EXPECT_EQ(parameters, expected);
}

TEST(Decode, GivesBackTheStateThatWasEncoded) {
  DeformableState body;
  body.node = {{1, 2, 3}, {4, 5, 6}};
  body.gradients.resize(1);
  for (int k = 0; k < 3; ++k) body.gradients[0].corner[k] = Vec3(float(k), 1, 2);
  body.hardening = {0.25f};
  body.edge_rest = {1, 2, 3};
  body.tet_rest = {7};
  body.absorbed = 8;
  body.stored = 9;
  body.settled = false;
  const auto load = std::get<LoadOrder>(expect_taken<Order>(host::load(encode_state(asset, body))));
  EXPECT_EQ(load.asset, asset);
  EXPECT_EQ(load.state.node, body.node);
  EXPECT_EQ(load.state.gradients[0].corner[2], Vec3(2, 1, 2));
  EXPECT_EQ(load.state.hardening, body.hardening);
  EXPECT_EQ(load.state.edge_rest, body.edge_rest);
  EXPECT_EQ(load.state.tet_rest, body.tet_rest);
  EXPECT_EQ(load.state.absorbed, 8);
  EXPECT_EQ(load.state.stored, 9);
  EXPECT_FALSE(load.state.settled);
  body.absorbed = -1;
  expect_refused<Order>(host::load(encode_state(asset, body)), Reason::out_of_range, "load.state.absorbed is -1 J");
  body.absorbed = double(nan);
  expect_refused<Order>(host::load(encode_state(asset, body)), Reason::non_finite, "load.state.absorbed");
}

TEST(Surface, RoundsHalfAwayFromZeroAndClamps) {
  const std::vector<Vec3> displacement = {{0.5f, -0.5f, 0.49f}, {1e6f, -1e6f, 2.5f}};
  std::vector<int16_t> quanta(6);
  quantise(displacement, 1, quanta);
  EXPECT_EQ(quanta, (std::vector<int16_t>{1, -1, 0, 32767, -32767, 3}));
}

TEST(Surface, RoundsAsTheLibraryDoes) {
  std::mt19937 random(7);
  std::vector<Vec3> displacement;
  for (int k = -400; k <= 400; ++k) {  // halves, and the numbers next to them
    const float half = 0.5f * float(k);
    displacement.push_back({half, std::nextafter(half, -1e9f), std::nextafter(half, 1e9f)});
  }
  std::uniform_real_distribution<float> any(-40'000, 40'000);
  for (int k = 0; k < 10'000; ++k) displacement.push_back({any(random), any(random), 1e-3f * any(random)});
  using Limits = std::numeric_limits<float>;
  displacement.push_back({Limits::quiet_NaN(), Limits::infinity(), -Limits::infinity()});
  std::vector<int16_t> quanta(3 * displacement.size());
  for (float quantum : {1.0f, 0.0005f}) {
    quantise(displacement, quantum, quanta);
    for (size_t i = 0; i < quanta.size(); ++i) {
      const float number = std::round(displacement[i / 3][i % 3] / quantum);
      ASSERT_EQ(quanta[i], int16_t(std::fmin(std::fmax(number, -32767.0f), 32767.0f))) << displacement[i / 3][i % 3];
    }
  }
}

std::vector<int16_t> noise(size_t nodes, uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<int16_t> out(3 * nodes);
  for (int16_t& value : out) value = int16_t(random());
  return out;
}

// 1: less than one block; 10,001: two parts; 200,000: the largest car.
TEST(Surface, AViewerHoldsWhatWasSentForAnyNumberOfNodes) {
  for (size_t nodes : {1u, 15u, 16u, 17u, 10'000u, 10'001u, 200'000u}) {
    const SurfaceHead head{7, asset, 0.0005f}, later{9, asset, 0.0005f};
    const std::vector<int16_t> key = noise(nodes, 1);
    std::vector<int16_t> now = key;
    for (size_t i = 0; i < now.size(); i += 1000) now[i] = int16_t(now[i] - 30'000);
    for (const auto& surface : {key, now, noise(nodes, 2)}) {
      host::Viewer viewer;
      for (const Bytes& part : encode_keyframe(head, key)) {
        ASSERT_LT(part.size(), part_size);
        viewer.take_keyframe(part);
      }
      ASSERT_EQ(viewer.held(), key);
      for (const Bytes& part : encode_delta(later, surface, 7, key)) {
        ASSERT_LT(part.size(), part_size);
        viewer.take_delta(part);
      }
      ASSERT_EQ(viewer.held(), surface) << nodes << " nodes";
      ASSERT_EQ(viewer.surface.hash, surface_hash(std::span<const int16_t>(surface)));
    }
  }
}

TEST(Surface, PartsSayWhichNodesTheySpeakForAndCoverAll) {
  const std::vector<int16_t> key(3 * 50'000), now = noise(50'000, 3);
  size_t reached = 0;
  for (const Bytes& part : encode_delta({2, asset, 1}, now, 1, key)) {
    const auto* delta = host::read_as<schema::Delta>(part);
    ASSERT_TRUE(delta);
    EXPECT_EQ(delta->first(), reached);
    reached += delta->count();
  }
  EXPECT_EQ(reached, 50'000u);
}

// By hand: two nodes move by (3, -2, 0), then one more by 1 in x.
TEST(Surface, IsPackedAsTheSchemaSays) {
  const std::vector<int16_t> now = {3, -2, 0, 3, -2, 0, 4, -2, 0};
  // x: 6, 0, 2 in three bits each; y: 3, 0, 0 in two.
  const std::vector<uint16_t> words = {3 | 2 << 5, 6 | 2 << 6, 0, 0, 3, 0};
  EXPECT_EQ(pack(now, {}), words);
  EXPECT_EQ(pack(now, now), std::vector<uint16_t>{0}) << "what did not change is one word a block";
}

TEST(Surface, ASmoothDentIsAFewBitsANode) {
  std::vector<int16_t> now;
  for (int i = 0; i < 1600; ++i) {
    const double depth = 600 * std::exp(-1e-5 * (i - 800) * (i - 800));
    for (const double axis : {1.0, 0.3, 0.1}) now.push_back(int16_t(std::lround(axis * depth)));
  }
  EXPECT_LT(16.0 * double(pack(now, {}).size()) / 1600, 8) << "bits a node";
}

TEST(Surface, KeyframesComeWhenDueWhenAtRestAndEverySixtyTicks) {
  ViewerState told;
  std::vector<int16_t> surface(30);
  const auto kind = [&](uint64_t tick, bool settled) { return update_viewers({tick, asset, 1}, settled, surface, told).kind; };
  EXPECT_EQ(kind(1, true), SurfaceUpdate::Kind::keyframe);  // because it was spawned
  EXPECT_EQ(kind(2, true), SurfaceUpdate::Kind::none);
  surface[0] = 1;
  EXPECT_EQ(kind(3, false), SurfaceUpdate::Kind::delta);
  EXPECT_EQ(kind(4, false), SurfaceUpdate::Kind::none);  // nothing changed
  EXPECT_EQ(kind(5, true), SurfaceUpdate::Kind::keyframe);
  EXPECT_EQ(kind(6, true), SurfaceUpdate::Kind::none);
  for (uint64_t tick = 7; tick < 65; ++tick) {
    ++surface[1];
    ASSERT_EQ(kind(tick, false), SurfaceUpdate::Kind::delta) << tick;
  }
  EXPECT_EQ(kind(65, false), SurfaceUpdate::Kind::keyframe);
  told.due = true;  // for example because it was repaired
  EXPECT_EQ(kind(66, true), SurfaceUpdate::Kind::keyframe);
}

TEST(Encode, AnswersSayWhyNot) {
  const Bytes answer = encode_answer(3, Refusal{Reason::unknown_car, "car a does not live here"});
  const auto* read = host::read_as<schema::Answer>(answer);
  EXPECT_FALSE(read->ok());
  EXPECT_EQ(read->tick(), 3u);
  EXPECT_EQ(read->sentence()->str(), "car a does not live here");
  EXPECT_EQ(read->state(), nullptr);
}

TEST(Encode, ABudgetIsReadBack) { EXPECT_EQ(expect_taken<Budget>(encode_budget(1ull << 40)).work, 1ull << 40); }

TEST(Encode, ATickEndIsReadBack) {
  const Bytes bytes = encode_tick_end({1, 2, 3, 4, 5});
  TickEnd end;
  ASSERT_FALSE(decode(bytes, end));
  EXPECT_EQ(end.tick, 1u);
  EXPECT_EQ(end.hash, 2u);
  EXPECT_EQ(end.lost_inputs, 3u);
  EXPECT_EQ(end.lost_outputs, 4u);
  EXPECT_EQ(end.inputs, 5u);
  EXPECT_TRUE(decode(Bytes(5), end));
}

}  // namespace
}  // namespace crumple

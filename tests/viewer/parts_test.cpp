// Tests where parts are: at rest, in a rigid motion, against another way to fit a rotation, and in crashes, where a wheel must
// stay a disc and follow the nodes around it.
#include "viewer/parts.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <random>

#include "crash.h"
#include "wheeled_car.h"

namespace crumple::viewer {
namespace {

using Eigen::Vector3d;

Part wheel_at(const Vector3d& hub) {
  Part part{.name = "wheel", .kind = schema::PartKind::wheel, .radius = 0.3f, .width = 0.2f};
  for (int k = 0; k < 3; ++k) part.position[size_t(k)] = float(hub[k]);
  return part;
}

Vector3d vector(const Point& p) { return {double(p[0]), double(p[1]), double(p[2])}; }
Point point(const Vector3d& p) { return {float(p.x()), float(p.y()), float(p.z())}; }
Eigen::Quaterniond turn_of(const Motion& motion) {
  const auto& q = motion.orientation;
  return {q[3], q[0], q[1], q[2]};
}

struct Cloud {
  std::vector<Point> rest;
  std::vector<float> moved;  // in quanta of 1 m
  explicit Cloud(size_t count, unsigned seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> at(-1, 1);
    for (size_t i = 0; i < count; ++i) rest.push_back({at(random), at(random), at(random)});
    moved.resize(3 * count);
  }
  template <class To>
  void move(To to) {
    for (size_t i = 0; i < rest.size(); ++i) {
      const Vector3d by = to(vector(rest[i])) - vector(rest[i]);
      for (int k = 0; k < 3; ++k) moved[3 * i + size_t(k)] = float(by[k]);
    }
  }
  Motion motion(const NodesAround& around) const { return motion_of(around, rest, moved, 1); }
};

TEST(Parts, NothingMovesAtRestToTheLastBit) {
  const Cloud cloud(300, 1);
  const Motion motion = cloud.motion(nodes_around(wheel_at({0, 0, 0}), cloud.rest));
  for (const Point& p : cloud.rest) EXPECT_EQ(motion.displacement(p), (Point{0, 0, 0}));
  EXPECT_EQ(turn_of(motion).coeffs(), Eigen::Quaterniond::Identity().coeffs());
}

TEST(Parts, FollowARigidMotionOfTheWhole) {
  Cloud cloud(300, 2);
  const Part wheel = wheel_at({0.1, 0.3, -0.2});
  const NodesAround around = nodes_around(wheel, cloud.rest);
  for (const double angle : {0.0, 0.01, 0.5, 1.6, 3.1}) {
    const Eigen::AngleAxisd turn(angle, Vector3d(0.2, -0.6, 0.7).normalized());
    const Vector3d by(0.3, -2, 0.04);
    cloud.move([&](const Vector3d& p) -> Vector3d { return turn * p + by; });
    const Motion motion = cloud.motion(around);
    for (const Point& p : cloud.rest)
      EXPECT_LT((vector(p) + vector(motion.displacement(p)) - (turn * vector(p) + by)).norm(), 4e-6) << angle;
    const Place place = place_of(wheel, motion);
    EXPECT_LT(turn_of(motion).angularDistance(Eigen::Quaterniond(turn)), 2e-6);
    EXPECT_LT((Vector3d(place.position.data()) - (turn * vector(wheel.position) + by)).norm(), 4e-6);
    EXPECT_NEAR(std::abs(Eigen::Quaterniond(place.orientation.data()).dot(Eigen::Quaterniond(turn))), 1, 1e-9);
  }
}

// Kabsch's fit by singular values, and a search: no rotation near by fits better.
TEST(Parts, TheFitIsTheBestOne) {
  Cloud cloud(200, 3);
  std::mt19937 random(4);
  std::normal_distribution<double> noise(0, 0.15);
  const NodesAround around = nodes_around(wheel_at({0, 0, 0}), cloud.rest);
  cloud.move([&](const Vector3d& p) -> Vector3d {
    return Eigen::AngleAxisd(0.7, Vector3d::UnitZ()) * p + Vector3d(noise(random), noise(random), noise(random));
  });
  const Motion motion = cloud.motion(around);
  const auto at = [&](uint32_t i) { return vector(cloud.rest[i]); };
  const auto now = [&](uint32_t i) -> Vector3d {
    return at(i) + Eigen::Map<const Eigen::Vector3f>(&cloud.moved[3 * i]).cast<double>();
  };
  Vector3d p = Vector3d::Zero(), q = p;
  double sum = 0;
  for (size_t k = 0; k < around.node.size(); ++k) {
    sum += around.weight[k];
    p += around.weight[k] * at(around.node[k]);
    q += around.weight[k] * now(around.node[k]);
  }
  EXPECT_NEAR(sum, 1, 1e-12);
  Eigen::Matrix3d h = Eigen::Matrix3d::Zero();
  for (size_t k = 0; k < around.node.size(); ++k)
    h += around.weight[k] * (at(around.node[k]) - p) * (now(around.node[k]) - q).transpose();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(h, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d kabsch = svd.matrixV() * svd.matrixU().transpose();
  ASSERT_GT(kabsch.determinant(), 0);
  EXPECT_LT((turn_of(motion).toRotationMatrix() - kabsch).norm(), 1e-5);
}

TEST(Parts, NodesInALineOrAPointLeaveTheTurnAsItIs) {
  for (const size_t count : {size_t{1}, size_t{2}, size_t{30}}) {
    Cloud cloud(count, 5);
    for (size_t i = 0; i < count; ++i) cloud.rest[i] = {0.01f * float(i), 0, 0};
    cloud.move([](const Vector3d& p) -> Vector3d { return p + Vector3d(0, 0.5, 0.1); });
    const Motion motion = cloud.motion(nodes_around(wheel_at({0, 0, 0}), cloud.rest));
    EXPECT_LT(turn_of(motion).angularDistance(Eigen::Quaterniond::Identity()), 1e-5) << count;
    EXPECT_LT((vector(motion.displacement({0, 0.2f, 0})) - Vector3d(0, 0.5, 0.1)).norm(), 1e-5) << count;
  }
}

TEST(Parts, ReachTheNodesOfAWellAndOfACoarseCarTheNearestTwelve) {
  const Cloud fine(5000, 6), coarse(20, 7);
  const NodesAround near = nodes_around(wheel_at({0, 0, 0}), fine.rest);
  for (const uint32_t node : near.node) EXPECT_LT(vector(fine.rest[node]).norm(), 0.45);
  EXPECT_GT(near.node.size(), 100u);
  EXPECT_GE(nodes_around(wheel_at({3, 0, 0}), coarse.rest).node.size(), 12u);
}

// The numbers are also in tests/gateway/parts_test.mjs.
TEST(Parts, AreWhereTypeScriptSeesThem) {
  int64_t state = 1;  // Park and Miller's generator, which every language can have
  const auto draw = [&](int64_t below) { return (state = state * 16807 % 2147483647) % below; };
  Cloud cloud(200, 1);
  for (Point& p : cloud.rest)
    for (float& x : p) x = float(double(draw(2001)) / 1000 - 1);
  for (float& q : cloud.moved) q = float(draw(401) - 200);
  const Part wheel{
      .name = "wheel", .kind = schema::PartKind::wheel, .position = {0.25f, -0.5f, 0.125f}, .radius = 0.5f, .width = 0.25f};
  const NodesAround around = nodes_around(wheel, cloud.rest);
  EXPECT_EQ(around.node.size(), 42u);
  const Place place = place_of(wheel, motion_of(around, cloud.rest, cloud.moved, 0.0009765625f));
  const double turn[] = {-0.0649238014, -0.0487328136, -0.0249397659, 0.9963874853},
               at[] = {0.2294125792, -0.4571187885, 0.0960060809};
  for (size_t k = 0; k < 4; ++k) EXPECT_NEAR(place.orientation[k], turn[k], 1e-6);
  for (size_t k = 0; k < 3; ++k) EXPECT_NEAR(place.position[k], at[k], 1e-6);
}

// The body's nodes after a crash, as a viewer has them.
std::vector<float> displacements(const Car& car, const DeformableState& body) {
  std::vector<float> out;
  for (uint32_t i : car.skin_node)
    for (int k = 0; k < 3; ++k) out.push_back((body.node[i] - car.model.node[i])[k]);
  return out;
}

// Where the nearest tet carries a place.
Vector3d by_nearest_tet(const Car& car, const DeformableState& body, const Point& place) {
  const TetMesh mesh{{car.model.node.begin(), car.model.node.end()}, {car.model.tet.begin(), car.model.tet.end()}};
  const Vec3 at(place[0], place[1], place[2]);
  const Skin skin = build_skin(mesh, {&at, 1}).skin[0];
  Vector3d out = vector(place);
  for (int k = 0; k < 4; ++k) out += (skin.weight[k] * (body.node[skin.node[k]] - car.model.node[skin.node[k]])).cast<double>();
  return out;
}

TEST(Parts, AWheelStaysADiscAndWhereTheBodyHoldsItInACrash) {
  const auto car = wheeled_box_car().car;
  std::vector<Point> rest;
  for (uint32_t i : car->skin_node) rest.push_back(point(car->model.node[i].cast<double>()));
  for (const bool pole : {false, true}) {
    Crash crash(car);
    crash.motion.velocity = {14, 0, 0};
    if (pole) {
      Obstacle obstacle;
      make_capsule(0.15f, 3, obstacle);
      obstacle.pose.position = {crash.front + 0.2, 0.45, 0};
      crash.obstacles.push_back(obstacle);
    } else {
      crash.wall();
    }
    crash.run(0.5);
    ASSERT_GT(crash.crush(), 0.1);
    const std::vector<float> moved = displacements(*car, crash.body);
    double farthest = 0;
    for (size_t k = 0; k < car->parts.part.size(); ++k) {
      const Part& part = car->parts.part[k];
      if (part.kind != schema::PartKind::wheel) continue;
      const Motion motion = motion_of(nodes_around(part, rest), rest, moved, 1);
      const Place place = place_of(part, motion);
      const Vector3d hub(place.position.data()), tet = by_nearest_tet(*car, crash.body, part.position);
      EXPECT_LT((hub - tet).norm(), 0.12) << part.name;
      farthest = std::max(farthest, (hub - vector(part.position)).norm());
      for (size_t v = 0; v < car->model.vertex.size(); ++v) {
        if (car->parts.of_vertex[v] != k) continue;
        const Point at = point(car->model.vertex[v].cast<double>());
        const Vector3d now = vector(at) + vector(motion.displacement(at));
        EXPECT_NEAR((now - hub).norm(), (vector(at) - vector(part.position)).norm(), 1e-5);
      }
    }
    EXPECT_GT(farthest, 0.01) << "the crash reaches no wheel";
  }
}

}  // namespace
}  // namespace crumple::viewer

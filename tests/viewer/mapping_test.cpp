// Tests the mapping of a game's own vertices to the surface of a baked car: against a search over all triangles, on hard edges
// and seams, and under rotations, which a mapping must reproduce exactly.
#include "viewer/mapping.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <random>

namespace crumple::viewer {
namespace {

Eigen::Vector3f vector(const Point& p) { return {p[0], p[1], p[2]}; }
Point point(const Eigen::Vector3f& v) { return {v.x(), v.y(), v.z()}; }

struct Mesh {
  std::vector<Point> vertex;
  std::vector<Corners> triangle;
};

// A box of 2 x 1 x 0.5 m; each face has n x n squares, and vertices are shared across its edges.
Mesh box(int n) {
  Mesh out;
  std::map<std::array<int, 3>, uint32_t> known;
  const auto vertex = [&](std::array<int, 3> at) {
    const auto [found, is_new] = known.try_emplace(at, uint32_t(out.vertex.size()));
    const auto share = [&](int axis) { return float(at[size_t(axis)]) / float(n); };
    if (is_new) out.vertex.push_back({2 * share(0) - 1, share(1) - 0.5f, 0.5f * share(2)});
    return found->second;
  };
  for (int axis = 0; axis < 3; ++axis)
    for (int side : {0, n})
      for (int u = 0; u < n; ++u)
        for (int v = 0; v < n; ++v) {
          const auto corner = [&](int du, int dv) {
            std::array<int, 3> at{};
            at[axis] = side;
            at[(axis + 1) % 3] = u + du;
            at[(axis + 2) % 3] = v + dv;
            return vertex(at);
          };
          Corners first{corner(0, 0), corner(1, 0), corner(1, 1)}, second{corner(0, 0), corner(1, 1), corner(0, 1)};
          if (side == 0) std::swap(first[1], first[2]), std::swap(second[1], second[2]);
          out.triangle.push_back(first);
          out.triangle.push_back(second);
        }
  return out;
}

std::vector<Point> cross_of(const Mesh& mesh) {
  std::vector<Point> out;
  find_crosses(mesh.vertex, mesh.triangle, out);
  return out;
}

// The slow twin: looks at every triangle, by sampling its area finely.
float distance_to(const Mesh& mesh, const Point& p) {
  float best = 1e9f;
  constexpr int fine = 200;
  for (const Corners& t : mesh.triangle)
    for (int i = 0; i <= fine; ++i)
      for (int j = 0; i + j <= fine; ++j) {
        const float a = float(i) / fine, b = float(j) / fine;
        const Eigen::Vector3f on =
            a * vector(mesh.vertex[t[0]]) + b * vector(mesh.vertex[t[1]]) + (1 - a - b) * vector(mesh.vertex[t[2]]);
        best = std::min(best, (on - vector(p)).norm());
      }
  return best;
}

TEST(MapVertices, FindsTheNearestPlaceOfTheSurface) {
  const Mesh mesh = box(2);
  std::mt19937 random(3);
  std::uniform_real_distribution<float> at(-1.3f, 1.3f);
  for (int k = 0; k < 20; ++k) {
    const Point p{at(random), at(random), at(random)};
    const Mapping mapping = map_vertices(mesh.vertex, mesh.triangle, {&p, 1}, {});
    Eigen::Vector3f on(0, 0, 0);
    for (size_t c = 0; c < 3; ++c) on += mapping.weight[0][c] * vector(mesh.vertex[mapping.corner[0][c]]);
    EXPECT_NEAR((on - vector(p)).norm(), mapping.distance[0], 1e-6f);
    EXPECT_NEAR(mapping.distance[0], distance_to(mesh, p), 0.005f);
    EXPECT_LE(mapping.distance[0], distance_to(mesh, p) + 1e-6f);
    EXPECT_NEAR(mapping.weight[0][0] + mapping.weight[0][1] + mapping.weight[0][2], 1, 1e-6f);
    EXPECT_EQ(mapping.on_vertices, 0u);
  }
}

TEST(MapVertices, AVertexInTheSamePlaceMovesExactlyWithIt) {
  const Mesh mesh = box(4);
  std::vector<Point> moved = mesh.vertex;
  std::mt19937 random(5);
  std::uniform_real_distribution<float> by(-0.1f, 0.1f), off(-5e-5f, 5e-5f);
  std::vector<Point> own = mesh.vertex, displacement;
  for (Point& p : own)
    for (float& x : p) x += off(random);
  for (size_t i = 0; i < moved.size(); ++i) displacement.push_back({by(random), by(random), by(random)});
  const Mapping mapping = map_vertices(mesh.vertex, mesh.triangle, own, {});
  EXPECT_EQ(mapping.on_vertices, own.size());
  for (size_t i = 0; i < own.size(); ++i) EXPECT_EQ(displacement_of(mapping, i, displacement), displacement[i]);
}

TEST(MapVertices, ASeamStaysClosedAndAHardEdgeHard) {
  const Mesh mesh = box(4);
  // The game has each vertex of an edge twice, once for each face.
  std::vector<Point> position, normal;
  for (int k = 0; k <= 4; ++k) {
    const float y = 0.25f * float(k) - 0.5f;
    position.insert(position.end(), {{1, y, 0.5f}, {1, y, 0.5f}});
    normal.insert(normal.end(), {{1, 0, 0}, {0, 0, 1}});
  }
  const Mapping mapping = map_vertices(mesh.vertex, mesh.triangle, position, normal);
  // The front is pushed in by a shear: its normal turns, and that of the roof turns too, each by its own triangles.
  Mesh bent = mesh;
  std::vector<Point> displacement;
  for (Point& v : bent.vertex) {
    displacement.push_back({v[0] == 1 ? -0.2f * v[2] : 0, 0, 0});
    v[0] += displacement.back()[0];
  }
  const std::vector<Point> cross = cross_of(bent);
  for (size_t i = 0; i < position.size(); i += 2) {
    EXPECT_EQ(displacement_of(mapping, i, displacement), displacement_of(mapping, i + 1, displacement));
    const Point front = turn_of(mapping, i, cross)(normal[i]), roof = turn_of(mapping, i + 1, cross)(normal[i + 1]);
    EXPECT_NEAR(std::atan2(front[2], front[0]), std::atan(0.2f), 1e-5f);
    EXPECT_NEAR(roof[2], 1, 1e-6f);
  }
}

TEST(MapVertices, NormalsAndTangentsTurnAsTheBodyTurns) {
  const Mesh mesh = box(3);
  std::vector<Point> normal(mesh.vertex.size());
  for (size_t i = 0; i < normal.size(); ++i)
    normal[i] = point((vector(mesh.vertex[i]) - Eigen::Vector3f(0, 0, 0.25f)).normalized());
  for (const bool with_normals : {false, true}) {
    const Mapping mapping = map_vertices(mesh.vertex, mesh.triangle, mesh.vertex, with_normals ? normal : std::vector<Point>{});
    for (const float angle : {0.0f, 0.3f, 1.5f, 3.0f}) {
      const Eigen::AngleAxisf turn(angle, Eigen::Vector3f(0.3f, -0.5f, 0.81f).normalized());
      Mesh turned = mesh;
      for (Point& v : turned.vertex) v = point(turn * vector(v));
      const std::vector<Point> cross = cross_of(turned);
      for (size_t i = 0; i < normal.size(); ++i) {
        // A turn from one direction to another says nothing about turns around that direction, so the facing itself is tested.
        const Point facing = turn_of(mapping, i, cross)(mapping.facing[i]);
        EXPECT_NEAR((vector(facing) - turn * vector(mapping.facing[i])).norm(), 0, 2e-5f) << angle;
        EXPECT_NEAR(vector(turn_of(mapping, i, cross)(normal[i])).norm(), 1, 1e-5f);
      }
    }
  }
}

TEST(MapVertices, TurnedTrianglesCountLikeTheOthers) {
  Mesh mesh = box(3), half = mesh;
  for (size_t t = 0; t < half.triangle.size(); t += 2) std::swap(half.triangle[t][1], half.triangle[t][2]);
  std::vector<Point> normal;
  for (const Point& v : mesh.vertex) normal.push_back(unit({v[0], v[1], v[2] - 0.25f}));
  const Mapping right = map_vertices(mesh.vertex, mesh.triangle, mesh.vertex, normal),
                mixed = map_vertices(half.vertex, half.triangle, half.vertex, normal);
  for (size_t i = 0; i < normal.size(); ++i) EXPECT_GT(vector(right.facing[i]).dot(vector(mixed.facing[i])), 0.9999f);
}

// A hostile car may have all its triangles around one vertex, which is the nearest one for every vertex of the game.
TEST(MapVertices, AFanOfManyTrianglesTurnsWithFewOfThem) {
  constexpr uint32_t blades = 100'000;
  Mesh fan;
  fan.vertex.push_back({0, 0, 0});
  for (uint32_t k = 0; k <= blades; ++k) {
    const double angle = 6.2831853 * k / blades;
    fan.vertex.push_back({float(std::cos(angle)), float(std::sin(angle)), 0});
    if (k > 0) fan.triangle.push_back({0, k, k + 1});
  }
  const std::vector<Point> own(200, Point{0, 0, 0}), normal(200, Point{0, 0, 1});
  const Mapping mapping = map_vertices(fan.vertex, fan.triangle, own, normal);
  EXPECT_EQ(mapping.on_vertices, own.size());
  EXPECT_EQ(mapping.turning.size(), own.size() * around_limit);
  for (const Point& facing : mapping.facing) EXPECT_NEAR(facing[2], 1, 1e-5f);
}

TEST(MapVertices, TrianglesWithoutAreaDoNoHarm) {
  const std::vector<Point> vertex = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {0, 0, 0}};
  const std::vector<Corners> triangle = {{0, 1, 2}, {0, 0, 0}, {3, 3, 1}};
  const std::vector<Point> position = {{0, 0, 0}, {1.5f, 0.5f, 0}, {9, 9, 9}};
  const Mapping mapping = map_vertices(vertex, triangle, position, {});
  EXPECT_EQ(mapping.on_vertices, 1u);
  std::vector<Point> cross;
  find_crosses(vertex, triangle, cross);
  for (size_t i = 0; i < position.size(); ++i) {
    const Point n = turn_of(mapping, i, cross)({0, 0, 1});
    EXPECT_TRUE(std::isfinite(n[0]) && std::isfinite(n[1]) && std::isfinite(n[2]));
  }
}

}  // namespace
}  // namespace crumple::viewer

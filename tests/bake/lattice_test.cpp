// Tets that the bake cuts out of a lattice: each stage by itself against a plain twin, then the laws that hold for any
// triangles.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <map>
#include <set>

#include "bake/bake.h"
#include "bake/built_in.h"
#include "bake/choose_solid_nodes.h"
#include "bake/fill_surface.h"
#include "bake/finish_tets.h"
#include "bake/make_tets.h"
#include "bake/near_triangles.h"
#include "bake/stuff.h"
#include "bake/voxels.h"
#include "car/build_skin.h"
#include "car/nearest.h"
#include "refusal.h"
#include "sanitized.h"

namespace crumple {
namespace {

// Under sanitizers bodies are 0.4 as wide, 0.55 as high, and have 0.22 of the nodes: less than half of the voxels, and lattices
// of the same spacing, so that the bounds below hold as they are.
constexpr size_t nodes_of_slim(size_t nodes) { return sanitized ? 22 * nodes / 100 : nodes; }

struct Random {
  uint32_t state = 1;
  double operator()() { return double((state = state * 1664525u + 1013904223u) >> 8) / (1 << 24); }  // 0 to 1
};

// ---- voxels ----------------------------------------------------------------------------------------------------------------

TEST(Voxels, DistancesAreThoseOfTryingEveryVoxel) {
  Random random;
  for (int round = 0; round < 20; ++round) {
    Voxels voxels;
    for (int& count : voxels.count) count = 2 + int(9 * random());
    Mask mask(voxels.total());
    for (uint8_t& v : mask) v = random() < 0.02 * round;
    for (bool goal : {false, true}) {
      const std::vector<int32_t> fast = squared_distances(voxels, mask, goal);
      const auto [nx, ny, nz] = voxels.count;
      for (int v = 0; v < nx * ny * nz; ++v) {
        int32_t plain = nowhere;
        for (int w = 0; w < nx * ny * nz; ++w) {
          const int x = v % nx - w % nx, y = v / nx % ny - w / nx % ny, z = v / (nx * ny) - w / (nx * ny);
          if ((mask[w] != 0) == goal) plain = std::min(plain, x * x + y * y + z * z);
        }
        ASSERT_EQ(fast[v], plain) << "round " << round << ", voxel " << v;
      }
    }
  }
}

TEST(Voxels, ValuesBetweenThemAreLinear) {
  const Voxels voxels{{1, 2, 3}, 0.5, {4, 5, 6}};
  std::vector<float> value(voxels.total());
  const auto plane = [](const Eigen::Vector3d& p) { return 2 * p.x() - p.y() + 0.5 * p.z() + 1; };
  for (int k = 0; k < 6; ++k)
    for (int j = 0; j < 5; ++j)
      for (int i = 0; i < 4; ++i) value[voxels.index(i, j, k)] = float(plane(voxels.origin + 0.5 * Eigen::Vector3d(i, j, k)));
  for (const Eigen::Vector3d& p : {Eigen::Vector3d(1, 2, 3), {1.3, 2.9, 4.1}, {2.5, 4, 5.5}})
    EXPECT_NEAR(interpolate(voxels, value, p), plane(p), 1e-5);
  EXPECT_NEAR(interpolate(voxels, value, {9, 4, 5.5}), plane({2.5, 4, 5.5}), 1e-5);  // beyond: that of the edge
}

// ---- shapes ----------------------------------------------------------------------------------------------------------------

void add(Surface& to, const Surface& part) {
  const auto first = uint32_t(to.vertex.size());
  to.vertex.insert(to.vertex.end(), part.vertex.begin(), part.vertex.end());
  for (const auto& [a, b, c] : part.triangle) to.triangle.push_back({first + a, first + b, first + c});
}

Surface box(const Vec3& low, const Vec3& high) {
  Surface out;
  for (int i = 0; i < 8; ++i)
    out.vertex.push_back({(i & 1 ? high : low).x(), (i & 2 ? high : low).y(), (i & 4 ? high : low).z()});
  for (const auto& [a, b, c, d] :
       {std::array<uint32_t, 4>{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}}) {
    out.triangle.push_back({a, b, c});
    out.triangle.push_back({a, c, d});
  }
  return out;
}

Surface slim(Surface surface) {
  if (sanitized)
    for (Vec3& vertex : surface.vertex) vertex = vertex.cwiseProduct(Vec3(1, 0.4f, 0.55f));
  return surface;
}

Surface car_body(size_t vertices) { return slim(build_car_body(vertices)); }

Surface with_half_of_the_faces_turned(Surface surface) {
  Random random;
  for (Triangle& triangle : surface.triangle)
    if (random() < 0.5) std::swap(triangle[0], triangle[1]);
  return surface;
}

Surface with_a_fifth_of_the_faces_missing(Surface surface) {
  Random random;
  std::erase_if(surface.triangle, [&](const Triangle&) { return random() < 0.2; });
  return surface;
}

Surface body_with_a_wing() {  // a sheet without thickness on a post without thickness
  Surface out = box({-2.2f, -0.9f, 0}, {2.2f, 0.9f, 1.2f});
  add(out, {{{-2, -0.1f, 1.2f}, {-2, 0.1f, 1.2f}, {-2, 0.1f, 1.6f}, {-2, -0.1f, 1.6f}}, {{0, 1, 2}, {0, 2, 3}}, {}});
  add(out,
      {{{-2.3f, -0.8f, 1.6f}, {-1.7f, -0.8f, 1.6f}, {-1.7f, 0.8f, 1.6f}, {-2.3f, 0.8f, 1.6f}}, {{0, 1, 2}, {0, 2, 3}}, {}});
  return out;
}

Surface two_loose_boxes() {
  Surface out = box({-2.2f, -0.9f, 0}, {-0.5f, 0.9f, 1.2f});
  add(out, box({0.6f, -0.9f, 0.1f}, {2.2f, 0.9f, 1.0f}));
  return out;
}

Surface two_crossing_shells() {
  Surface out = box({-2.2f, -0.9f, 0.2f}, {2.2f, 0.9f, 0.9f});
  add(out, with_half_of_the_faces_turned(box({-1.1f, -0.8f, 0.5f}, {0.8f, 0.8f, 1.4f})));
  return out;
}

Surface body_with_flat_triangles() {
  Surface out = box({-2.2f, -0.9f, 0}, {2.2f, 0.9f, 1.2f});
  out.triangle.push_back({0, 0, 0});
  out.triangle.push_back({0, 7, 7});  // lines: through the inside, and along an edge
  out.triangle.push_back({0, 1, 0});
  return out;
}

Surface body_without_a_floor() {
  Surface out = build_car_body(1259);
  std::erase_if(out.triangle, [&](const Triangle& t) {
    const Vec3 &a = out.vertex[t[0]], &b = out.vertex[t[1]], &c = out.vertex[t[2]];
    return (b - a).cross(c - a).normalized().z() < -0.7f && std::max({a.z(), b.z(), c.z()}) < 0.4f;
  });
  return out;
}

// ---- fill ------------------------------------------------------------------------------------------------------------------

FilledSurface filled(const Surface& surface) { return fill_surface(surface.vertex, surface.triangle, "shape"); }

TEST(Fill, OfAClosedBoxIsTheBoxAndNothingIsSealed) {
  const FilledSurface solid = filled(box({-2, -1, 0}, {2, 1, 1}));
  EXPECT_FALSE(solid.sealed);
  EXPECT_NEAR(solid.volume, 8, 0.5);  // at most a voxel of 24 mm on each side
  EXPECT_NEAR(interpolate(solid.voxels, solid.depth, {0, 0, 0.5}), 0.5, 0.03);
  EXPECT_NEAR(interpolate(solid.voxels, solid.depth, {0, 0, 1}), 0, 0.03);
  EXPECT_NEAR(interpolate(solid.voxels, solid.depth, {2.2, 0, 0.5}), -0.2, 0.03);
}

TEST(Fill, DoesNotLookAtHowFacesAreTurned) {
  const Surface body = car_body(1259);
  EXPECT_EQ(filled(body).inside, filled(with_half_of_the_faces_turned(body)).inside);
}

TEST(Fill, SealsWhatIsOpen) {
  const double whole = filled(car_body(1259)).volume;
  const FilledSurface floorless = filled(slim(body_without_a_floor()));
  EXPECT_TRUE(floorless.sealed);
  EXPECT_NEAR(floorless.volume, whole, 0.15 * whole);  // the edge of the floor lies open to the sides
  const FilledSurface holed = filled(with_a_fifth_of_the_faces_missing(car_body(3674)));
  EXPECT_TRUE(holed.sealed);
  EXPECT_NEAR(holed.volume, whole, 0.1 * whole);
}

TEST(Fill, RefusesTheSameSheetManyThousandTimesOver) {
  Surface heap = box({-2.2f, -0.9f, 0}, {2.2f, 0.9f, 1.2f});
  heap.triangle.insert(heap.triangle.end(), 30'000, {0, 3, 7});
  expect_sentence(refusal([&] { (void)filled(heap); }), "shape", "many hundred times over");
}

// ---- lattice ---------------------------------------------------------------------------------------------------------------

TEST(Lattice, NeighboursAreTheEdgesOfItsTetsAndAllTetsAreAlike) {
  const Lattice lattice{{0, 0, 0}, 2, {4, 5, 3}};
  std::set<std::pair<uint32_t, uint32_t>> edges, neighbors;
  size_t tets = 0;
  for_each_tet(lattice, [&](const std::array<uint32_t, 4>& tet) {
    ++tets;
    Eigen::Vector3d p[4];
    for (int k = 0; k < 4; ++k) p[k] = lattice.position(tet[k]);
    EXPECT_NEAR(std::abs((p[1] - p[0]).cross(p[2] - p[0]).dot(p[3] - p[0])) / 6, 8 / 12., 1e-12);
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < i; ++j) edges.insert(std::minmax(tet[i], tet[j]));
  });
  EXPECT_EQ(tets, 4u * (2 * 4 * 2 + 3 * 3 * 2 + 3 * 4 * 1));  // faces between two cubes
  for (uint32_t v = 0; v < lattice.node_count(); ++v)
    for_each_neighbor(lattice, v, [&](uint32_t w) {
      ASSERT_LT(w, lattice.node_count());
      const double length = (lattice.position(v) - lattice.position(w)).norm();
      EXPECT_NEAR(length, lattice.is_corner(v) == lattice.is_corner(w) ? 2 : std::sqrt(3), 1e-12);
      neighbors.insert(std::minmax(v, w));
    });
  EXPECT_TRUE(std::includes(neighbors.begin(), neighbors.end(), edges.begin(), edges.end()));
}

TEST(NearTriangles, AreThoseOfTryingEveryTriangle) {
  const Surface body = build_car_body(400);
  std::vector<Eigen::Vector3d> vertex;
  for (const Vec3& v : body.vertex) vertex.push_back(v.cast<double>());
  const double reach = 0.3;
  const NearTriangles near(vertex, body.triangle, reach);
  Random random;
  size_t found = 0, in_front = 0;
  for (int i = 0; i < 2000; ++i) {
    const Eigen::Vector3d point(6 * random() - 3, 3 * random() - 1.5, 2 * random() - 0.2);
    double plain = HUGE_VAL;
    for (const auto& [a, b, c] : body.triangle)
      plain = std::min(plain, std::sqrt(squared_distance_to_triangle(point, vertex[a], vertex[b], vertex[c])));
    const auto one = near.find(point);
    EXPECT_EQ(one.has_value(), plain <= reach);
    if (!one) continue;
    ++found;
    EXPECT_NEAR(one->offset.norm(), plain, 1e-9);
    // The sum of the solid angles that the triangles take up tells inside from outside.
    double turns = 0;
    for (const auto& [u, v, w] : body.triangle) {
      const Eigen::Vector3d a = vertex[u] - point, b = vertex[v] - point, c = vertex[w] - point;
      turns += std::atan2(a.cross(b).dot(c),
                          a.norm() * b.norm() * c.norm() + a.dot(b) * c.norm() + b.dot(c) * a.norm() + c.dot(a) * b.norm()) /
               (2 * 3.14159265358979);
    }
    EXPECT_EQ(one->in_front, turns < 0.5) << point.transpose();
    in_front += one->in_front;
  }
  EXPECT_GT(in_front, 100u);
  EXPECT_GT(found - in_front, 100u);
}

// ---- laws ------------------------------------------------------------------------------------------------------------------

// Parts of tets that hang together by faces, found by walking over them.
size_t count_parts(const TetMesh& mesh) {
  std::map<std::set<uint32_t>, std::vector<size_t>> tets_of_face;
  const auto face = [&](size_t t, int without) {
    std::set<uint32_t> out;
    for (int k = 0; k < 4; ++k)
      if (k != without) out.insert(mesh.tet[t].node[k]);
    return out;
  };
  for (size_t t = 0; t < mesh.tet.size(); ++t)
    for (int k = 0; k < 4; ++k) tets_of_face[face(t, k)].push_back(t);
  for (const auto& [nodes, tets] : tets_of_face) EXPECT_LE(tets.size(), 2u) << "three tets share a face";
  std::vector<uint8_t> seen(mesh.tet.size(), 0);
  size_t parts = 0;
  for (size_t seed = 0; seed < mesh.tet.size(); ++seed) {
    if (seen[seed]) continue;
    ++parts;
    std::vector<size_t> front = {seed};
    seen[seed] = 1;
    while (!front.empty()) {
      const size_t t = front.back();
      front.pop_back();
      for (int k = 0; k < 4; ++k)
        for (size_t other : tets_of_face[face(t, k)])
          if (!seen[other]) seen[other] = 1, front.push_back(other);
    }
  }
  return parts;
}

double volume_of(const TetMesh& mesh, double& least) {
  double sum = 0;
  least = HUGE_VAL;
  for (const Tet& tet : mesh.tet) {
    Eigen::Vector3d p[4];
    for (int k = 0; k < 4; ++k) p[k] = mesh.node[tet.node[k]].cast<double>();
    const double own = (p[1] - p[0]).cross(p[2] - p[0]).dot(p[3] - p[0]) / 6;
    least = std::min(least, own);
    sum += own;
  }
  return sum;
}

TEST(Stuff, OfABallKeepsTheBoundsOfThePaper) {
  const Lattice lattice = lattice_around({Eigen::Vector3d(-1, -1, -1), Eigen::Vector3d(1, 1, 1)}, 0.21);
  LatticeSolid solid;
  for (uint32_t v = 0; v < lattice.node_count(); ++v) solid.depth.push_back(1.0003 - lattice.position(v).norm());
  solid.held.assign(solid.depth.size(), 0);
  const FineTets fine = stuff(lattice, solid);
  TetMesh mesh{{}, fine.tet};
  for (const Eigen::Vector3d& node : fine.node) mesh.node.push_back(node.cast<float>());
  double least = 0;
  EXPECT_NEAR(volume_of(mesh, least), 4 / 3. * 3.14159265, 0.08);
  EXPECT_GT(least, 0);
  EXPECT_EQ(count_parts(mesh), 1u);
  const AngleRange angles = dihedral_angles(mesh);
  EXPECT_GT(angles.least, 8);  // 10.7 and 164.8 with the paper's choice of diagonals
  EXPECT_LT(angles.most, 168);
}

ImportedSurface as_input(Surface surface) {
  ImportedSurface out;
  out.surface = std::move(surface);
  return out;
}

TetMesh fill(const Surface& surface, size_t nodes, std::string* told = nullptr) {
  std::vector<std::string> report;
  TetMesh out = fill_with_tets(as_input(surface), nodes, "shape", {}, report);
  if (told)
    for (const std::string& line : report) *told += line + "\n";
  return out;
}

// A skin rides at most 80 mm from the tets of 5,000 nodes, and from coarser ones less than half a spacing.
// Returns what was told.
std::string expect_the_laws(const Surface& wide, size_t wanted, double mean_skin = 0.008, double farthest_skin = 0.1) {
  const Surface surface = slim(wide);
  const size_t nodes = nodes_of_slim(wanted);
  std::string told;
  const TetMesh mesh = fill(surface, nodes, &told);
  EXPECT_NEAR(double(mesh.node.size()), double(nodes), 0.05 * double(nodes));
  double least = 0;
  volume_of(mesh, least);
  EXPECT_GT(least, 0);
  EXPECT_EQ(count_parts(mesh), 1u);
  const AngleRange angles = dihedral_angles(mesh);
  EXPECT_GT(angles.least, 16);
  EXPECT_LT(angles.most, 160);
  std::set<uint32_t> used;
  for (const Tet& tet : mesh.tet) used.insert(tet.node, tet.node + 4);
  EXPECT_EQ(used.size(), mesh.node.size());
  const SkinResult skin = build_skin(mesh, surface.vertex);
  double mean = 0;
  for (double distance : skin.distance) mean += distance / double(skin.distance.size());
  EXPECT_LT(mean, mean_skin);
  EXPECT_LT(skin.farthest, farthest_skin);
  return told;
}

TEST(LatticeTets, KeepTheLawsOnTheBuiltInBody) { expect_the_laws(build_car_body(1259), 5000, 0.008, 0.08); }

TEST(LatticeTets, KeepTheLawsWithHalfOfTheFacesTurned) {
  expect_the_laws(with_half_of_the_faces_turned(build_car_body(1259)), 2000);
}

TEST(LatticeTets, KeepTheLawsWithAFifthOfTheFacesMissing) {
  expect_the_laws(with_a_fifth_of_the_faces_missing(build_car_body(3674)), 2000);
}

TEST(LatticeTets, KeepTheLawsWithoutAFloor) { expect_the_laws(body_without_a_floor(), sanitized ? 5000 : 2000); }

// A box has no vertices but its corners, which stick out most: so the mean below.
TEST(LatticeTets, HoldAThinSheetThatSticksOut) { expect_the_laws(body_with_a_wing(), 2000, 0.05); }

TEST(LatticeTets, HoldCrossingShells) { expect_the_laws(two_crossing_shells(), 1500, 0.05); }

TEST(LatticeTets, HoldFlatTriangles) { expect_the_laws(body_with_flat_triangles(), 1500, 0.05); }

TEST(LatticeTets, JoinWhatIsLooseAndSaySo) {
  const std::string told = expect_the_laws(two_loose_boxes(), 1500, 0.05, 0.12);
  EXPECT_TRUE(contains(told, "1 piece hangs apart: joined to the rest")) << told;
}

TEST(LatticeTets, AreTheSameBitsEachTime) {
  const Surface body = with_a_fifth_of_the_faces_missing(car_body(1259));
  constexpr size_t nodes = sanitized ? 300 : 1000;
  const TetMesh once = fill(body, nodes), again = fill(body, nodes);
  ASSERT_EQ(once.node.size(), again.node.size());
  ASSERT_EQ(once.tet.size(), again.tet.size());
  EXPECT_EQ(std::memcmp(once.node.data(), again.node.data(), once.node.size() * sizeof(Vec3)), 0);
  EXPECT_EQ(std::memcmp(once.tet.data(), again.tet.data(), once.tet.size() * sizeof(Tet)), 0);
}

TEST(LatticeTets, OfFewAndOfManyNodesAreMade) {
  for (size_t nodes : {100u, 300u, 10'000u}) {
    if (sanitized && nodes > 300) continue;
    const TetMesh mesh = fill(car_body(1259), nodes);
    EXPECT_NEAR(double(mesh.node.size()), double(nodes), 0.05 * double(nodes));
    EXPECT_EQ(count_parts(mesh), 1u);
    EXPECT_GT(dihedral_angles(mesh).least, 16);
  }
}

TEST(LatticeTets, ThatWouldBeFinerThanTheVoxelsAreRefusedWithASentence) {
  Surface specks = box({-2.2f, -0.05f, 0}, {-2.1f, 0.05f, 0.1f});
  add(specks, box({2.1f, -0.05f, 0}, {2.2f, 0.05f, 0.1f}));
  expect_sentence(refusal([&] { fill(specks, 5000); }), "shape", "at its finest spacing");
  expect_sentence(refusal([&] { fill(specks, 99); }), "--nodes 99", "100");
}

TEST(LatticeTets, MakeTheSameCarTwiceAndTellHow) {
  BakeOptions options;
  options.input = "built-in";
  options.nodes = 1000;
  options.mesher = Mesher::lattice;
  std::vector<std::string> told;
  const BakeResult once = bake(options, [&](const std::string& line) { told.push_back(line); });
  if (!sanitized) {  // there AreTheSameBitsEachTime compares two
    EXPECT_EQ(bake(options, {}).car->hash, once.car->hash);
  }
  EXPECT_FALSE(told.empty());
  std::string report;
  for (const std::string& line : once.report) report += line + "\n";
  EXPECT_TRUE(contains(report, "% of the 1000 wanted")) << report;
  EXPECT_TRUE(contains(report, "holds water")) << report;
}

}  // namespace
}  // namespace crumple

// Tests baking: reading a baked car, importing a surface, tets, constraints, skin, regions, the built-in body, the whole bake.

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <map>
#include <set>

#include "bake/bake.h"
#include "bake/build_constraints.h"
#include "bake/built_in.h"
#include "bake/import_surface.h"
#include "bake/order_spatially.h"
#include "bake/paint_regions.h"
#include "box_car.h"
#include "car/build_skin.h"
#include "cli/map.h"
#include "refusal.h"

namespace crumple {
namespace {

Surface box_surface(BoxCells cells = {}) {
  const BoxMesh box = box_mesh(cells);
  Surface out;
  for (uint32_t node : box.surface) out.vertex.push_back(box.tets.node[node]);
  for (size_t i = 0; i < box.triangle.size(); i += 3)
    out.triangle.push_back({box.triangle[i], box.triangle[i + 1], box.triangle[i + 2]});
  return out;
}

// The enclosed volume, m^3; negative if the faces point inward.
double enclosed(const Surface& surface) {
  double six = 0;
  for (const auto& [a, b, c] : surface.triangle) six += surface.vertex[a].cross(surface.vertex[b]).dot(surface.vertex[c]);
  return six / 6;
}

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.9g", value);
  return text;
}

std::string as_obj(const Surface& surface) {
  std::string text;
  for (const Vec3& v : surface.vertex) text += "v " + number(v.x()) + " " + number(v.y()) + " " + number(v.z()) + "\n";
  for (const Triangle& t : surface.triangle) {
    text += "f";
    for (uint32_t vertex : t) text += " " + std::to_string(vertex + 1);
    text += "\n";
  }
  return text;
}

std::string as_stl(const Surface& surface) {
  std::string text = "solid box\n";
  for (const Triangle& t : surface.triangle) {
    text += "facet normal 0 0 1\nouter loop\n";
    for (uint32_t i : t) {
      const Vec3& v = surface.vertex[i];
      text += "vertex " + number(v.x()) + " " + number(v.y()) + " " + number(v.z()) + "\n";
    }
    text += "endloop\nendfacet\n";
  }
  return text + "endsolid box\n";
}

std::string as_ply(const Surface& surface) {
  std::string text = "ply\nformat ascii 1.0\nelement vertex " + std::to_string(surface.vertex.size()) +
                     "\nproperty float x\nproperty float y\nproperty float z\n";
  if (!surface.color.empty()) text += "property uchar red\nproperty uchar green\nproperty uchar blue\n";
  text += "element face " + std::to_string(surface.triangle.size()) + "\nproperty list uchar int vertex_indices\nend_header\n";
  for (size_t i = 0; i < surface.vertex.size(); ++i) {
    const Vec3& v = surface.vertex[i];
    text += number(v.x()) + " " + number(v.y()) + " " + number(v.z());
    if (!surface.color.empty())
      for (int shift : {16, 8, 0}) text += " " + std::to_string(surface.color[i] >> shift & 0xff);
    text += "\n";
  }
  for (const Triangle& t : surface.triangle)
    text += "3 " + std::to_string(t[0]) + " " + std::to_string(t[1]) + " " + std::to_string(t[2]) + "\n";
  return text;
}

std::string as_gmsh(const TetMesh& mesh) {
  std::string text = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n" + std::to_string(mesh.node.size()) + "\n";
  for (size_t i = 0; i < mesh.node.size(); ++i)
    text += std::to_string(i + 1) + " " + number(mesh.node[i].x()) + " " + number(mesh.node[i].y()) + " " +
            number(mesh.node[i].z()) + "\n";
  text += "$EndNodes\n$Elements\n" + std::to_string(mesh.tet.size()) + "\n";
  for (size_t t = 0; t < mesh.tet.size(); ++t) {
    text += std::to_string(t + 1) + " 4 2 1 1";
    for (uint32_t node : mesh.tet[t].node) text += " " + std::to_string(node + 1);
    text += "\n";
  }
  return text + "$EndElements\n";
}

// ---- constraints ----------------------------------------------------------------------------------------------------------

TEST(Constraints, AreThoseOfAHandCalculatedPair) {
  // The unit corner tet, and its mirror image across the face of corners 1, 2, 3.
  TetMesh mesh{{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {2 / 3.f, 2 / 3.f, 2 / 3.f}}, {{{0, 1, 2, 3}}, {{4, 1, 3, 2}}}};
  const Constraints c = build_constraints(mesh);
  EXPECT_EQ(c.edge.size(), 9u);  // 12 minus 3 shared edges
  EXPECT_FLOAT_EQ(c.tet_rest[0], 1 / 6.f);
  EXPECT_FLOAT_EQ(c.tet_rest[1], 1 / 6.f);
  for (int k = 0; k < 3; ++k) EXPECT_EQ(c.gradients[0].corner[k], Vec3::Unit(k));
  EXPECT_EQ(c.node_first, (std::vector<uint32_t>{0, 1, 3, 5, 7, 8}));
  EXPECT_EQ(c.corner, (std::vector<uint32_t>{0, 1, 5, 2, 7, 3, 6, 4}));
  for (size_t e = 0; e < c.edge.size(); ++e) {
    const auto [a, b] = c.edge[e].node;
    EXPECT_LT(a, b);
    EXPECT_FLOAT_EQ(c.edge_rest[e], (mesh.node[a] - mesh.node[b]).norm());
  }
}

TEST(Constraints, GradientsTellAPositionFromTheEdgesOfASkewTet) {
  const TetMesh mesh{{{1, 2, 3}, {2, 2.5f, 3.25f}, {0.5f, 3, 3}, {1, 2.25f, 5}}, {{{0, 1, 2, 3}}}};
  const Constraints c = build_constraints(mesh);
  for (int k = 0; k < 3; ++k)
    for (int j = 0; j < 3; ++j) EXPECT_NEAR(c.gradients[0].corner[k].dot(mesh.node[j + 1] - mesh.node[0]), k == j, 1e-6);
}

TEST(Constraints, EveryEdgeOfEveryTetIsThereOnce) {
  const TetMesh mesh = box_mesh({5, 4, 3}).tets;
  std::set<std::pair<uint32_t, uint32_t>> plain;
  for (const Tet& tet : mesh.tet)
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < i; ++j) plain.insert(std::minmax(tet.node[i], tet.node[j]));
  const Constraints c = build_constraints(mesh);
  ASSERT_EQ(c.edge.size(), plain.size());
  size_t e = 0;
  for (const auto& [a, b] : plain) {
    EXPECT_EQ(c.edge[e].node[0], a);
    EXPECT_EQ(c.edge[e++].node[1], b);
  }
}

TEST(Constraints, MassesOfABoxAreThoseOfTheTextbook) {
  const TetMesh mesh = box_mesh({40, 16, 13}).tets;
  const Masses masses = lump_masses(mesh, build_constraints(mesh).tet_rest, 1500);
  double sum = 0;
  for (float mass : masses.node) sum += mass;
  EXPECT_NEAR(sum, 1500, 1e-2);
  EXPECT_LT((masses.center - Vec3(0, 0, 0.75f)).norm(), 1e-5f);
  const double x = 4.5, y = 1.8, z = 1.5;
  EXPECT_NEAR(masses.inertia.x(), 1500 / 12. * (y * y + z * z), 10);
  EXPECT_NEAR(masses.inertia.y(), 1500 / 12. * (x * x + z * z), 10);
  EXPECT_NEAR(masses.inertia.z(), 1500 / 12. * (x * x + y * y), 10);
}

// ---- skin ------------------------------------------------------------------------------------------------------------------

Vec3 carried(const TetMesh& mesh, const Skin& skin) {
  Vec3 out = Vec3::Zero();
  for (int k = 0; k < 4; ++k) out += skin.weight[k] * mesh.node[skin.node[k]];
  return out;
}

std::vector<Vec3> scattered(size_t count, float reach) {
  std::vector<Vec3> out;
  uint32_t state = 1;
  const auto random = [&] { return static_cast<float>((state = state * 1664525u + 1013904223u) >> 8) / (1 << 24) - 0.5f; };
  for (size_t i = 0; i < count; ++i) out.push_back(Vec3(random(), random(), random()) * reach + Vec3(0, 0, 0.75f));
  return out;
}

TEST(Skin, CarriesEveryVertexWhereItIs) {
  const TetMesh mesh = box_mesh({}).tets;
  const std::vector<Vec3> points = scattered(2000, 4);
  const SkinResult result = build_skin(mesh, points);
  for (size_t i = 0; i < points.size(); ++i) {
    // Inside a tet the weights give the vertex itself. Outside they give a point of the tet that is not much farther than the
    // nearest one.
    EXPECT_LT((carried(mesh, result.skin[i]) - points[i]).norm(), 5e-6 + 3 * result.distance[i]);
    for (float weight : result.skin[i].weight) EXPECT_GE(weight, 0);
  }
  EXPECT_GT(result.contained, 100u);
  EXPECT_GT(result.nearest, 100u);
  EXPECT_EQ(result.coincident + result.contained + result.nearest, points.size());
}

TEST(Skin, CoincidesWithNodes) {
  const TetMesh mesh = box_mesh({}).tets;
  const SkinResult result = build_skin(mesh, mesh.node);
  EXPECT_EQ(result.coincident, mesh.node.size());
  for (size_t i = 0; i < mesh.node.size(); ++i) {
    EXPECT_EQ(result.skin[i].node[0], i);
    EXPECT_EQ(result.skin[i].weight[0], 1);
  }
}

TEST(Skin, ContainsTheSamePointsAsTheBoxItself) {
  const TetMesh mesh = box_mesh({}).tets;
  const std::vector<Vec3> points = scattered(2000, 4);
  const SkinResult result = build_skin(mesh, points);
  for (size_t i = 0; i < points.size(); ++i) {
    const Vec3 outside = (points[i] - points[i].cwiseMax(Vec3(-2.25f, -0.9f, 0)).cwiseMin(Vec3(2.25f, 0.9f, 1.5f)));
    EXPECT_NEAR(result.distance[i], outside.norm(), 1e-6);
  }
}

TEST(Skin, TakesTheNearestTetAndNotTheNearestCentroid) {
  // A long tet passes close to the point, but the centroid of a small tet is nearer.
  const TetMesh mesh{
      {{-5, 0, 0}, {5, 0, 0}, {5, 0, 0.1f}, {5, 0.1f, 0}, {-4, 0.6f, 0}, {-3.9f, 0.6f, 0}, {-4, 0.7f, 0}, {-4, 0.6f, 0.1f}},
      {{{0, 1, 3, 2}}, {{4, 5, 6, 7}}}};
  const SkinResult result = build_skin(mesh, std::vector<Vec3>{{-4, 0.2f, 0}});
  EXPECT_NEAR(result.farthest, 0.19, 1e-4);
  EXPECT_LT(*std::max_element(result.skin[0].node, result.skin[0].node + 4), 4u);
}

TEST(Skin, IsTheSameOnAnyNumberOfThreads) {
  const TetMesh mesh = box_mesh({}).tets;
  const std::vector<Vec3> points = scattered(3000, 4);
  std::vector<Skin> first;
  for (size_t threads : {1, 2, 4}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    const std::vector<Skin> skin = build_skin(mesh, points).skin;
    if (first.empty()) first = skin;
    EXPECT_EQ(std::memcmp(first.data(), skin.data(), skin.size() * sizeof(Skin)), 0);
  }
}

// ---- import ----------------------------------------------------------------------------------------------------------------

TEST(Import, ReadsTheSameBoxFromObjStlAndPly) {
  const Files files;
  const Surface box = box_surface();
  for (const auto& file :
       {files.write("box.obj", as_obj(box)), files.write("box.stl", as_stl(box)), files.write("box.ply", as_ply(box))}) {
    const ImportedSurface read = import_surface(file, {});
    EXPECT_EQ(read.surface.vertex.size(), box.vertex.size()) << file;
    EXPECT_EQ(read.surface.triangle.size(), box.triangle.size()) << file;
    EXPECT_EQ(read.open_edges, 0u);
    EXPECT_EQ(read.parts, 1u);
    Eigen::AlignedBox3f bounds;
    for (const Vec3& v : read.surface.vertex) bounds.extend(v);
    EXPECT_LT((bounds.min() - Vec3(-2.25f, -0.9f, 0)).norm(), 1e-6f);
    EXPECT_LT((bounds.max() - Vec3(2.25f, 0.9f, 1.5f)).norm(), 1e-6f);
  }
}

// A tet with corners (0,0,0), (1,0,0), (0,1,0), (0,0,1) and outward faces, below a translated node and a node scaled by
// `scale`.
std::filesystem::path write_gltf(const Files& files, const std::string& scale) {
  const float positions[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
  const uint16_t indices[12] = {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3};
  std::string bytes(sizeof positions + sizeof indices, 0);
  std::memcpy(bytes.data(), positions, sizeof positions);
  std::memcpy(bytes.data() + sizeof positions, indices, sizeof indices);
  files.write("tet.bin", bytes);
  return files.write("tet.gltf", R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
    "nodes":[{"children":[1],"translation":[10,20,30]},{"mesh":0,"scale":)" +
                                     scale + R"(}],
    "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
    "accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],"max":[1,1,1]},
                 {"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}],
    "bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":48},{"buffer":0,"byteOffset":48,"byteLength":24}],
    "buffers":[{"uri":"tet.bin","byteLength":72}]})");
}

TEST(Import, FlattensTheNodesOfAGltfAndTurnsItsAxes) {
  const Files files;
  const auto file = write_gltf(files, "[2,2,2]");
  const auto at = [&](const ImportedSurface& read, const Eigen::Vector3d& p) { return (read.from_file * p).eval(); };
  // By its specification z is forward and y up, so x is left.
  const ImportedSurface spec = import_surface(file, {});
  ASSERT_EQ(spec.surface.vertex.size(), 4u);
  EXPECT_LT((at(spec, {10, 20, 32}) - Eigen::Vector3d(1, -1, 0)).norm(), 1e-6);
  EXPECT_LT((at(spec, {12, 20, 30}) - Eigen::Vector3d(-1, 1, 0)).norm(), 1e-6);
  const ImportedSurface turned = import_surface(file, {"-z", "y", 0.5});
  EXPECT_LT((at(turned, {10, 20, 32}) - Eigen::Vector3d(-0.5, 0.5, 0)).norm(), 1e-6);
  EXPECT_LT((at(turned, {10, 22, 30}) - Eigen::Vector3d(0.5, 0.5, 1)).norm(), 1e-6);
}

TEST(Import, KeepsFacesTurnedOutwardUnderAMirroringNode) {
  const Files files;
  EXPECT_NEAR(enclosed(import_surface(write_gltf(files, "[2,2,2]"), {}).surface), 8 / 6., 1e-5);
  EXPECT_NEAR(enclosed(import_surface(write_gltf(files, "[2,-2,2]"), {}).surface), 8 / 6., 1e-5);
}

TEST(Import, ReportsWhatItWeldedAndDropped) {
  const Files files;
  Surface box = box_surface({1, 1, 1});
  box.vertex.push_back(box.vertex[0]);  // a seam: two vertices at the same place
  for (uint32_t& vertex : box.triangle.back()) vertex = vertex == 0 ? static_cast<uint32_t>(box.vertex.size() - 1) : vertex;
  box.triangle.push_back({1, 1, 2});
  const ImportedSurface read = import_surface(files.write("box.obj", as_obj(box)), {});
  std::string report;
  for (const std::string& line : read.report) report += line + "\n";
  EXPECT_EQ(read.surface.vertex.size(), 8u);
  EXPECT_TRUE(contains(report, "welded")) << report;
  EXPECT_TRUE(contains(report, "1 triangles dropped that have no area")) << report;
  EXPECT_TRUE(contains(report, "watertight")) << report;
}

TEST(Import, CountsOpenEdgesAndParts) {
  const Files files;
  Surface two = box_surface({1, 1, 1});
  two.triangle.pop_back();
  const auto first = static_cast<uint32_t>(two.vertex.size());
  for (const Vec3& corner : {Vec3(0, 0, 2), Vec3(1, 0, 2), Vec3(0, 1, 2)}) two.vertex.push_back(corner);
  two.triangle.push_back({first, first + 1, first + 2});
  const ImportedSurface read = import_surface(files.write("two.obj", as_obj(two)), {});
  EXPECT_EQ(read.parts, 2u);
  EXPECT_EQ(read.open_edges, 6u);
}

TEST(Import, RefusesEachBadMeshWithASentence) {
  const Files files;
  const auto why = [&](const std::filesystem::path& file) { return refusal([&] { (void)import_surface(file, {}); }); };
  const std::string tet = "v 0 0 0\nv 4 0 0\nv 0 2 0\nv 0 0 1\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
  expect_sentence(why(files.folder.path / "none.obj"), "none.obj", "no such file");
  expect_sentence(why(files.folder.path), files.folder.path, "folder");
  expect_sentence(why(files.write("empty.obj", "")), "empty.obj", "empty");
  expect_sentence(why(files.write("text.obj", "Dear reader,\nthis is no mesh.\n")), "text.obj", "no triangles");
  expect_sentence(why(files.write("text.xyz", "Dear reader")), "text.xyz", "no surface can be read");
  expect_sentence(why(files.write("noise.glb", std::string(100, '\x7f'))), "noise.glb", "no surface can be read");
  expect_sentence(why(files.write("points.obj", "v 0 0 0\nv 4 0 0\nv 0 2 1\n")), "points.obj", "no triangles");
  expect_sentence(why(files.write("nan.obj", "v nan 0 0\n" + tet)), "nan.obj", "not a finite number");
  expect_sentence(why(files.write("inf.obj", "v 1e39 0 0\n" + tet)), "inf.obj", "not a finite number");
  expect_sentence(why(files.write("flat.obj", "v 0 0 0\nv 4 0 0\nv 0 2 0\nf 1 2 3\n")), "flat.obj", "flat");
  expect_sentence(why(files.write("far.obj", tet + "f 1 2 99999999\n")), "far.obj", "out of range");
  expect_sentence(why(files.write("lines.obj", "v 0 0 0\nv 4 0 1\nv 4 2 2\nf 1 2 2\nf 3 3 1\n")), "lines.obj", "area");
  expect_sentence(why(files.write("mm.obj", "v 0 0 0\nv 4000 0 0\nv 0 2000 0\nv 0 0 1500\nf 1 2 3\nf 1 2 4\n")), "mm.obj",
                  "--scale");
  std::string vertices, faces;
  for (int i = 0; i < 1000; ++i) {
    const std::string x = number(i % 40 * 0.1), y = number(i / 40 * 0.07), wide = number(i % 40 * 0.1 + 0.05);
    vertices += "v " + x + " " + y + " 0\nv " + wide + " " + y + " 0\nv " + x + " " + y + " 1\n";
    faces += "f " + std::to_string(3 * i + 1) + " " + std::to_string(3 * i + 2) + " " + std::to_string(3 * i + 3) + "\n";
  }
  expect_sentence(why(files.write("bits.obj", vertices + faces)), "bits.obj", "1000 pieces");
}

// A tetrahedron as Collada, with nodes that can be referenced, and the nodes of the scene.
std::string as_collada(const std::string& library, const std::string& nodes) {
  const std::string begin =
      R"(<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
    <library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a"
    count="12">0 0 0 4 0 0 0 2 0 0 0 1</float_array>
    <technique_common><accessor source="#a" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
    <param name="Z" type="float"/></accessor></technique_common></source><vertices id="v">
    <input semantic="POSITION" source="#p"/></vertices>
    <triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2 0 1 3 0 2 3 1 2 3</p></triangles>
    </mesh></geometry></library_geometries><library_nodes>)";
  return begin + library + "</library_nodes><library_visual_scenes><visual_scene id=\"s\">" + nodes +
         "</visual_scene></library_visual_scenes><scene><instance_visual_scene url=\"#s\"/></scene></COLLADA>";
}

std::string repeated(const std::string& text, size_t times) {
  std::string out;
  for (size_t i = 0; i < times; ++i) out += text;
  return out;
}

TEST(Import, NodesWithinNodesEndInASentenceHoweverDeep) {
  const Files files;
  const auto nested = [](size_t levels) {
    return as_collada("", repeated("<node>", levels) + "<instance_geometry url=\"#g\"/>" + repeated("</node>", levels));
  };
  EXPECT_EQ(import_surface(files.write("few.dae", nested(900)), {}).surface.vertex.size(), 4u);
  const auto why = [&](const std::filesystem::path& file) { return refusal([&] { (void)import_surface(file, {}); }); };
  expect_sentence(why(files.write("many.dae", nested(1100))), "many.dae", "nested deeper than 1000");
  expect_sentence(why(files.write("most.dae", nested(60'000))), "most.dae", "nested thousands deep");
  const std::string self = "<node id=\"n\"><instance_geometry url=\"#g\"/><instance_node url=\"#n\"/></node>";
  expect_sentence(why(files.write("self.dae", as_collada(self, "<node><instance_node url=\"#n\"/></node>"))), "self.dae",
                  "nested thousands deep");
  std::string nodes;
  for (int i = 0; i < 30'000; ++i) nodes += "{\"children\":[" + std::to_string(i + 1) + "]},";
  expect_sentence(why(files.write("most.gltf", R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[)" +
                                                   nodes + "{}]}")),
                  "most.gltf", "nested thousands deep");
}

// Each node references the next one twice.
std::filesystem::path write_doubling(const Files& files, int levels) {
  std::string nodes;
  for (int i = 0; i < levels; ++i) {
    const std::string next = std::to_string(i + 1);
    nodes += "{\"children\":[" + next + "," + next + "]},";
  }
  files.write("points.bin", std::string(720, '\x3f'));
  return files.write("doubling.gltf", R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[)" + nodes +
                                          R"({"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
    "accessors":[{"bufferView":0,"componentType":5126,"count":60,"type":"VEC3","min":[0,0,0],"max":[1,1,1]}],
    "bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":720}],"buffers":[{"uri":"points.bin","byteLength":720}]})");
}

TEST(Import, NodesThatAreNamedAgainAndAgainAreCountedBeforeTheyFillTheMemory) {
  const Files files;
  const auto why = [&](int levels) { return refusal([&] { (void)import_surface(write_doubling(files, levels), {}); }); };
  expect_sentence(why(16), "doubling.gltf", "over 3200000 vertices");
#if !defined(CRUMPLE_SANITIZE)  // with it the memory of a process cannot be limited
  expect_sentence(why(60), "doubling.gltf", "over 2 GiB of memory");
#endif
}

TEST(Import, RefusesAnInputThatIsNoneOrTooLarge) {
  const Files files;
  const auto why = [&](const std::filesystem::path& file) { return refusal([&] { (void)import_surface(file, {}); }); };
  std::filesystem::resize_file(files.write("vast.stl", ""), uintmax_t{100} << 30);
  expect_sentence(why(files.folder.path / "vast.stl"), "vast.stl", "larger than 512 MiB");
  expect_sentence(why("/dev/zero"), "/dev/zero", "a device");
  std::filesystem::resize_file(files.write("vast.msh", ""), uintmax_t{100} << 30);
  std::vector<std::string> report;
  expect_sentence(refusal([&] { (void)import_tets(files.folder.path / "vast.msh", Eigen::Affine3d::Identity(), report); }),
                  "vast.msh", "larger than 512 MiB");
}

TEST(Import, RefusesAxesThatAreNone) {
  const Files files;
  const auto file = files.write("box.obj", as_obj(box_surface()));
  expect_sentence(refusal([&] { (void)import_surface(file, {"q", "z"}); }), "--forward q", "axis");
  expect_sentence(refusal([&] { (void)import_surface(file, {"x", "-x"}); }), "--up -x", "different");
  expect_sentence(refusal([&] { (void)import_surface(file, {"x", "z", -1}); }), "--scale", "above zero");
}

// ---- tets ------------------------------------------------------------------------------------------------------------------

TEST(Tets, AreTurnedPositiveAndCleanedWithAReport) {
  const std::vector<double> nodes = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 9, 9, 9, 0.5, 0.5, 0};
  std::vector<std::string> report;
  const TetMesh mesh = clean_tets(nodes, {0, 2, 1, 3, 0, 1, 2, 5}, "some.msh", report);
  ASSERT_EQ(mesh.tet.size(), 1u);
  EXPECT_EQ(mesh.node.size(), 4u);
  const uint32_t* node = mesh.tet[0].node;
  EXPECT_GT(tet_volume(mesh.node[node[0]], mesh.node[node[1]], mesh.node[node[2]], mesh.node[node[3]]), 0);
  EXPECT_EQ(report.size(), 3u);
}

TEST(Tets, ThatNoFaceJoinsToTheRestAreDropped) {
  const TetMesh box = box_mesh({4, 2, 2}).tets;
  std::vector<double> nodes;
  std::vector<int32_t> tets;
  for (const Vec3& node : box.node) nodes.insert(nodes.end(), {double(node.x()), double(node.y()), double(node.z())});
  for (const Tet& tet : box.tet) tets.insert(tets.end(), tet.node, tet.node + 4);
  // One more node on an edge of the box, and one far away.
  const int32_t n = int32_t(box.node.size()), a = int32_t(box.tet[0].node[0]), b = int32_t(box.tet[0].node[1]);
  nodes.insert(nodes.end(), {-3, -1, -0.2, -3, -1.1, -0.2, 9, 0, 0, 9.1, 0, 0, 9, 0.1, 0, 9, 0, 0.1});
  tets.insert(tets.end(), {a, b, n, n + 1, n + 2, n + 3, n + 4, n + 5});
  std::vector<std::string> report;
  const TetMesh mesh = clean_tets(nodes, tets, "some.msh", report);
  EXPECT_EQ(mesh.tet.size(), box.tet.size());
  EXPECT_EQ(mesh.node.size(), box.node.size());
  ASSERT_FALSE(report.empty());
  EXPECT_TRUE(contains(report[0], "2 parts of the tets dropped")) << report[0];
}

TEST(Tets, WithWildIndicesOrPositionsAreRefused) {
  std::vector<std::string> report;
  const std::vector<double> nodes = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1};
  expect_sentence(refusal([&] { (void)clean_tets(nodes, {0, 1, 2, 4}, "some.msh", report); }), "some.msh", "does not exist");
  expect_sentence(refusal([&] { (void)clean_tets(nodes, {0, 1, 2, -1}, "some.msh", report); }), "some.msh", "does not exist");
  expect_sentence(refusal([&] { (void)clean_tets(nodes, {0, 1, 2, 2}, "some.msh", report); }), "some.msh", "volume");
  expect_sentence(refusal([&] { (void)clean_tets({NAN, 0, 0}, {0, 0, 0, 0}, "some.msh", report); }), "some.msh", "finite");
}

TEST(Tets, AreReadFromTheFormatsOfOtherPrograms) {
  const Files files;
  const TetMesh box = box_mesh({2, 1, 1}).tets;
  std::string medit = "MeshVersionFormatted 1\nDimension 3\nVertices\n" + std::to_string(box.node.size()) + "\n";
  std::string node = std::to_string(box.node.size()) + " 3 0 0\n", ele = std::to_string(box.tet.size()) + " 4 0\n";
  for (size_t i = 0; i < box.node.size(); ++i) {
    const std::string position = number(box.node[i].x()) + " " + number(box.node[i].y()) + " " + number(box.node[i].z());
    medit += position + " 0\n";
    node += std::to_string(i) + " " + position + "\n";
  }
  medit += "Tetrahedra\n" + std::to_string(box.tet.size()) + "\n";
  for (size_t t = 0; t < box.tet.size(); ++t) {
    ele += std::to_string(t);
    for (uint32_t corner : box.tet[t].node) medit += std::to_string(corner + 1) + " ", ele += " " + std::to_string(corner);
    medit += "0\n";
    ele += "\n";
  }
  files.write("box.node", node);
  for (const auto& file :
       {files.write("box.msh", as_gmsh(box)), files.write("box.mesh", medit + "End\n"), files.write("box.ele", ele)}) {
    std::vector<std::string> report;
    const TetMesh read = import_tets(file, Eigen::Affine3d::Identity(), report);
    ASSERT_EQ(read.node.size(), box.node.size()) << file;
    ASSERT_EQ(read.tet.size(), box.tet.size()) << file;
    for (size_t i = 0; i < box.node.size(); ++i) EXPECT_EQ(read.node[i], box.node[i]) << file;
    EXPECT_EQ(std::memcmp(read.tet.data(), box.tet.data(), box.tet.size() * sizeof(Tet)), 0) << file;
  }
}

TEST(Tets, ThatCannotBeReadAreRefusedWithASentence) {
  const Files files;
  std::vector<std::string> report;
  const auto why = [&](const std::filesystem::path& file) {
    return refusal([&] { (void)import_tets(file, Eigen::Affine3d::Identity(), report); });
  };
  expect_sentence(why(files.folder.path / "none.msh"), "none.msh", "no such file");
  expect_sentence(why(files.write("text.msh", "no tets here\n")), "text.msh", "cannot read");
  expect_sentence(why(files.write("shell.obj", as_obj(box_surface()))), "shell.obj", "no tets");
}

TEST(Tets, OfABoxAreMadeWithinFifteenPercentOfTheNodesWanted) {
  const Surface box = box_surface({1, 1, 1});
  ImportedSurface input;
  input.surface = box;
  std::vector<std::string> report, told;
  const TetMesh mesh = tetrahedralise(
      input, 300, "box", [&](const std::string& line) { told.push_back(line); }, report);
  EXPECT_NEAR(static_cast<double>(mesh.node.size()), 300, 45);
  double volume = 0;
  for (float rest : build_constraints(mesh).tet_rest) volume += rest;
  EXPECT_NEAR(volume, 4.5 * 1.8 * 1.5, 0.2);
  EXPECT_FALSE(told.empty());
}

// ---- regions ---------------------------------------------------------------------------------------------------------------

TEST(Regions, AnchorTheCoreBetweenTheAxlesByDefault) {
  const TetMesh mesh = box_mesh({36, 14, 12}).tets;
  std::vector<std::string> report;
  const Regions regions = paint_regions(mesh, {}, {}, "box", report);
  ASSERT_EQ(regions.name, (std::vector<std::string>{"body", "cell"}));
  size_t anchored = 0;
  for (size_t i = 0; i < mesh.node.size(); ++i) {
    const Vec3 p = mesh.node[i];
    const float depth = std::min({2.25f - std::abs(p.x()), 0.9f - std::abs(p.y()), p.z(), 1.5f - p.z()});
    EXPECT_EQ(regions.node_region[i], regions.node_anchored[i]);
    if (!regions.node_anchored[i]) continue;
    ++anchored;
    EXPECT_GT(depth, 0.19f);
    EXPECT_LT(std::abs(p.x()), 2.25f - 0.17f * 4.5f);
  }
  EXPECT_GT(anchored, mesh.node.size() / 10);
}

TEST(Regions, AnchorLessDeepWhereTheBodyIsThinAndSaySo) {
  TetMesh thin = box_mesh({12, 4, 4}).tets;
  for (Vec3& node : thin.node) node.z() *= 0.15f;  // 0.225 m high
  std::vector<std::string> report;
  const Regions regions = paint_regions(thin, {}, {}, "box", report);
  EXPECT_GT(std::count(regions.node_anchored.begin(), regions.node_anchored.end(), 1), 0);
  EXPECT_TRUE(contains(report[0], "none lay deeper")) << report[0];
  for (Vec3& node : thin.node) node.z() *= 0.1f;
  const std::string why = refusal([&] { (void)paint_regions(thin, {}, {}, "box", report); });
  expect_sentence(why, "box", "--regions");
}

TEST(Regions, ComeFromAFileInItsOrder) {
  const Files files;
  const TetMesh mesh = box_mesh({}).tets;
  const auto file = files.write("regions.json", R"({ regions: [
    { name: "front", box: { center: {x: 2.25, y: 0, z: 0.75}, half: {x: 1, y: 2, z: 2} } },
    { name: "core", anchored: true, sphere: { center: {x: 0, y: 0, z: 0.75}, radius: 0.9 } },
    { name: "front", box: { center: {x: 0, y: 0, z: 0}, half: {x: 0.1, y: 3, z: 0.1},
                            orientation: {x: 0, y: 0, z: 0.70710678, w: 0.70710678} } } ] })");
  std::vector<std::string> report;
  const Regions regions = paint_regions(mesh, {}, read_regions(file), "box", report);
  ASSERT_EQ(regions.name, (std::vector<std::string>{"body", "front", "core"}));
  for (size_t i = 0; i < mesh.node.size(); ++i) {
    const Vec3 p = mesh.node[i];
    const bool core = (p - Vec3(0, 0, 0.75f)).norm() <= 0.9f;
    const bool line = std::abs(p.x()) <= 3 && std::abs(p.y()) <= 0.1f && p.z() <= 0.1f;  // the box, rotated by 90 degrees
    EXPECT_EQ(regions.node_region[i], line ? 1 : core ? 2 : p.x() >= 1.25f ? 1 : 0) << p.transpose();
    EXPECT_EQ(regions.node_anchored[i], core && !line) << p.transpose();
  }
}

TEST(Regions, PaintTheNearestNodeWhereASphereLiesBetweenNodes) {
  const TetMesh mesh = box_mesh({12, 4, 4}).tets;  // nodes 0.375 m apart and more
  const Vec3 corner = mesh.node[0];
  const std::string at =
      "{x: " + number(corner.x() + 0.1) + ", y: " + number(corner.y() + 0.1) + ", z: " + number(corner.z()) + "}";
  const RegionsText dab{"dab", "{regions: [{name: \"thin\", sphere: {center: " + at + ", radius: 0.02}}]}"};
  std::vector<std::string> report;
  const Regions regions = paint_regions(mesh, {}, dab, "box", report);
  EXPECT_EQ(regions.node_region[0], 1);
  EXPECT_EQ(std::count(regions.node_region.begin(), regions.node_region.end(), 1), 1);
}

TEST(Regions, RefuseAWrongFileWithASentence) {
  const Files files;
  const TetMesh mesh = box_mesh({}).tets;
  const auto why = [&](const std::string& text) {
    const auto file = files.write("paint.json", text);
    std::vector<std::string> report;
    return refusal([&] { (void)paint_regions(mesh, {}, read_regions(file), "box", report); });
  };
  expect_sentence(why(""), "paint.json", "regions.fbs");
  expect_sentence(why("not json"), "paint.json", "regions.fbs");
  expect_sentence(why("{}"), "paint.json", "required");
  expect_sentence(why(R"({regions: [{name: "a", blob: 1}]})"), "paint.json", "unknown field: blob");
  expect_sentence(why(R"({regions: [{name: "a"}]})"), "\"a\"", "box or a sphere");
  expect_sentence(why(R"({regions: [{name: "a", sphere: {center: {x: 99, y: 0, z: 0}, radius: 1}}]})"), "\"a\"",
                  "holds no node");
  expect_sentence(why(R"({regions: [{name: "a", sphere: {center: {x: nan, y: 0, z: 0}, radius: 1}}]})"), "\"a\"", "finite");
  std::string many = "{regions: [";
  for (int i = 0; i < 17; ++i)
    many += R"({name: "r)" + std::to_string(i) + R"(", sphere: {center: {x: 0, y: 0, z: 0.5}, radius: 9}},)";
  many.back() = ']';
  expect_sentence(why(many + "}"), "paint.json", "more than the 16 regions");
}

TEST(Regions, ArePaintedByVertexColours) {
  const Files files;
  Surface box = box_surface({36, 14, 12});
  for (const Vec3& v : box.vertex) box.color.push_back(v.x() > 0.01f ? 0xff0000 : 0xffffff);
  const ImportedSurface read = import_surface(files.write("box.ply", as_ply(box)), {});
  ASSERT_EQ(read.surface.color.size(), box.vertex.size());
  const TetMesh mesh = box_mesh({36, 14, 12}).tets;
  std::vector<std::string> report;
  const Regions regions = paint_regions(mesh, read.surface, {}, "box", report);
  ASSERT_EQ(regions.name, (std::vector<std::string>{"body", "#ff0000", "cell"}));
  for (size_t i = 0; i < mesh.node.size(); ++i) {
    if (std::abs(mesh.node[i].x()) < 0.2f) continue;
    EXPECT_EQ(regions.node_region[i] == 1, mesh.node[i].x() > 0) << mesh.node[i].transpose();
  }
  for (uint32_t i = 0; i < 20; ++i) box.color[i] = i;  // shading
  report.clear();
  EXPECT_EQ(paint_regions(mesh, box, {}, "box", report).name, (std::vector<std::string>{"body", "cell"}));
  EXPECT_EQ(report.front().find("not painted: the surface has 2"), 0u) << report.front();
}

// ---- order -----------------------------------------------------------------------------------------------------------------

TEST(Order, KeepsEveryTetAndEveryTriangleAndItsSense) {
  TetMesh before = box_mesh({5, 3, 2}).tets;
  constexpr int even[4][4] = {{0, 1, 2, 3}, {1, 2, 0, 3}, {3, 2, 1, 0}, {2, 0, 1, 3}};
  for (size_t t = 0; t < before.tet.size(); ++t) {
    const Tet tet = before.tet[t];
    for (int k = 0; k < 4; ++k) before.tet[t].node[k] = tet.node[even[t % 4][k]];
  }
  TetMesh after = before;
  order_spatially(after);
  const auto volumes = [](const TetMesh& mesh) {
    std::multiset<float> out;
    for (float rest : build_constraints(mesh).tet_rest) out.insert(rest);
    return out;
  };
  const auto volumes_before = volumes(before), volumes_after = volumes(after);
  ASSERT_EQ(volumes_after.size(), volumes_before.size());
  EXPECT_GT(*volumes_after.begin(), 0);
  EXPECT_TRUE(std::equal(volumes_after.begin(), volumes_after.end(), volumes_before.begin(),
                         [](float a, float b) { return std::abs(a - b) <= 1e-5f * b; }));
  for (size_t t = 1; t < after.tet.size(); ++t) EXPECT_LE(after.tet[t - 1].node[0], after.tet[t].node[0]);
  Surface surface = box_surface();
  order_spatially(surface);
  EXPECT_NEAR(enclosed(surface), 4.5 * 1.8 * 1.5, 1e-4);
}

TEST(Order, BringsNeighboursTogether) {
  const auto stride = [](const TetMesh& mesh) {
    double sum = 0;
    const Constraints c = build_constraints(mesh);
    for (const Edge& edge : c.edge) sum += std::min(edge.node[1] - edge.node[0], 64u);
    return sum / static_cast<double>(c.edge.size());
  };
  const TetMesh before = box_mesh({30, 12, 10}).tets;
  TetMesh after = before;
  order_spatially(after);
  EXPECT_LT(stride(after), 0.8 * stride(before));
}

// ---- the built-in body
// -------------------------------------------------------------------------------------------------------

TEST(BuiltIn, IsClosedSymmetricAndHasExactlyTheVerticesAskedFor) {
  for (size_t vertices : {400u, 1259u, 1260u, 3674u}) {
    const Surface body = build_car_body(vertices);
    EXPECT_EQ(body.vertex.size(), vertices);
    EXPECT_EQ(body.triangle.size(), 2 * vertices - 4) << "no handles";
    std::map<std::pair<uint32_t, uint32_t>, int> sides;  // each edge occurs once in either direction
    for (const Triangle& t : body.triangle)
      for (int k = 0; k < 3; ++k) ++sides[{t[k], t[(k + 1) % 3]}];
    for (const auto& [edge, count] : sides) {
      EXPECT_EQ(count, 1);
      EXPECT_TRUE(sides.contains({edge.second, edge.first}));
    }
    std::set<std::array<float, 3>> places;
    for (const Vec3& v : body.vertex) places.insert({v.x(), v.y(), v.z()});
    EXPECT_EQ(places.size(), vertices);
    for (const auto& [x, y, z] : places) EXPECT_TRUE(places.contains({x, y == 0 ? 0 : -y, z}));
  }
}

TEST(BuiltIn, HasTheSizeOfACarAndOpenWheelArches) {
  const Surface body = build_car_body(1259);
  Eigen::AlignedBox3f box;
  for (const Vec3& v : body.vertex) box.extend(v);
  EXPECT_NEAR(box.sizes().x(), 4.55, 0.1);
  EXPECT_NEAR(box.sizes().y(), 1.8, 0.01);
  EXPECT_NEAR(box.sizes().z(), 1.43, 0.03);
  EXPECT_NEAR(enclosed(body), 7.5, 0.5);  // faces point outward, and the volume is far below the full box of 11.7
  for (const Vec3& v : body.vertex)       // the place of the wheels
    for (float axle : {-1.36f, 1.36f})
      EXPECT_FALSE(std::abs(v.y()) > 0.65f && std::hypot(v.x() - axle, v.z() - 0.15f) < 0.3f) << v.transpose();
}

// ---- the whole bake
// ----------------------------------------------------------------------------------------------------------

TEST(Bake, TheSameSurfaceAndTetsGiveTheSameBytes) {
  const Files files;
  BakeOptions options;
  options.input = files.write("box.obj", as_obj(box_surface())).string();
  options.tets = files.write("box.msh", as_gmsh(box_mesh({}).tets));
  options.mass = 1400;
  options.attribution = "the tests";
  const BakeResult once = bake(options, {}), again = bake(options, {});
  EXPECT_EQ(once.car->hash, again.car->hash);
  EXPECT_EQ(once.car->model.node.size(), 200u);
  EXPECT_EQ(once.car->name, "box");
  EXPECT_EQ(once.car->attribution, "the tests");
  EXPECT_FLOAT_EQ(once.car->model.mass, 1400);
  EXPECT_GT(std::count(once.car->model.node_anchored.begin(), once.car->model.node_anchored.end(), 1), 0);
  EXPECT_FALSE(once.report.empty());
}

TEST(Bake, BringsTetsIntoTheFrameOfTheirSurface) {
  // Both files in millimetres, y up, x backward.
  const auto turned = [](const Vec3& p) { return Vec3(-1000 * p.x(), 1000 * p.z() + 77, 1000 * p.y()); };
  Surface surface = box_surface();
  TetMesh tets = box_mesh({}).tets;
  for (Vec3& p : surface.vertex) p = turned(p);
  for (Vec3& p : tets.node) p = turned(p);
  const Files files;
  BakeOptions options;
  options.input = files.write("box.obj", as_obj(surface)).string();
  options.tets = files.write("box.msh", as_gmsh(tets));
  options.import = {"-x", "y", 0.001};
  const auto car = bake(options, {}).car;
  for (size_t v = 0; v < car->model.vertex.size(); ++v) {
    EXPECT_EQ(car->model.skin[v].weight[0], 1);
    EXPECT_LT((car->model.node[car->model.skin[v].node[0]] - car->model.vertex[v]).norm(), 1e-5f);
  }
}

TEST(Bake, RefusesTetsOfAnotherThing) {
  TetMesh away = box_mesh({}).tets;
  for (Vec3& p : away.node) p *= 0.3f;
  const Files files;
  BakeOptions options;
  options.input = files.write("box.obj", as_obj(box_surface())).string();
  options.tets = files.write("small.msh", as_gmsh(away));
  expect_sentence(refusal([&] { (void)bake(options, {}); }), "small.msh", "outside the tets");
}

TEST(Bake, RefusesOptionsOutOfRange) {
  BakeOptions options;
  const auto why = [&](auto change) {
    BakeOptions changed = options;
    change(changed);
    return refusal([&] { (void)bake(changed, {}); });
  };
  expect_sentence(why([](BakeOptions& o) { o.input = "built-in:12"; }), "built-in:12", "400");
  expect_sentence(why([](BakeOptions& o) { o.input = "built-in:many"; }), "built-in:many", "400");
  expect_sentence(why([](BakeOptions& o) { o.input = "built-in", o.nodes = 3; }), "--nodes 3", "100");
  expect_sentence(why([](BakeOptions& o) { o.input = "built-in", o.mass = -1; }), "--mass", "10");
}

TEST(Bake, OfABakedCarPaintsAsTheFirstBakeWouldHave) {
  const Files files;
  BakeOptions options;
  options.input = files.write("box.obj", as_obj(box_surface({36, 14, 12}))).string();
  options.tets = files.write("box.msh", as_gmsh(box_mesh({36, 14, 12}).tets));
  options.mass = 1234.5;
  options.attribution = "the tests";
  const auto plain = bake(options, {}).car;
  const RegionsText painted{"paint", R"({regions: [{name: "hood", sphere: {center: {x: 1.8, y: 0, z: 1.2}, radius: 0.6}},
    {name: "cell", anchored: true, sphere: {center: {x: 0, y: 0, z: 0.75}, radius: 0.7}},
    {name: "body", sphere: {center: {x: 0, y: 0.3, z: 0.75}, radius: 0.3}}]})"};
  options.regions = painted;
  const auto at_once = bake(options, {}).car;

  BakeOptions again;
  again.input = files.folder.path / "plain.car";
  write_car(*plain, again.input);
  EXPECT_EQ(bake(again, {}).car->hash, plain->hash);  // nothing was painted, so the car is identical
  again.regions = painted;
  const auto later = bake(again, {}).car;
  EXPECT_EQ(later->hash, at_once->hash);  // every byte is equal: tets, skin, masses, name and attribution
  EXPECT_EQ(later->regions, (std::vector<std::string>{"body", "hood", "cell"}));
  EXPECT_NE(later->hash, plain->hash);
  again.input = files.folder.path / "painted.car";
  write_car(*later, again.input);
  again.regions.reset();
  EXPECT_EQ(bake(again, {}).car->hash, plain->hash);  // nothing remains of the earlier painting
}

TEST(Bake, SaysWhereACarCannotBeWritten) {
  expect_sentence(refusal([] { write_car(*box_car(), "/nowhere/at/all.car"); }), "all.car", "cannot be written");
}

TEST(Bake, ChoosesTheMesherByTheSurface) {
  const Files files;
  const auto report_of = [&](const Surface& surface) {
    BakeOptions options;
    options.input = files.write("body.obj", as_obj(surface));
    options.nodes = 300;
    std::string report;
    for (const std::string& line : bake(options, {}).report) report += line + "\n";
    return report;
  };
  Surface box = box_surface({3, 2, 1});
  EXPECT_EQ(report_of(box).find("lattice"), std::string::npos);
  box.triangle.pop_back();
  EXPECT_NE(report_of(box).find("the lattice makes the tets"), std::string::npos) << "it has a hole";
}

// ---- meshes of a game ----------------------------------------------------------------------------------------------------

TEST(Map, SaysHowWellAMeshFitsTheCarThatWasBakedFromItsFile) {
  const Files files;
  const auto source = [&](const char* name, BoxCells cells, const Eigen::Affine3f& placed) {
    Surface box = box_surface(cells);
    for (Vec3& v : box.vertex) v = placed * v;
    return files.write(name, as_obj(box)).string();
  };
  const Eigen::Affine3f here(Eigen::Translation3f(3, -2, 7)), there = here * Eigen::Translation3f(0.4f, 0.3f, 0.5f);
  const std::string full = source("full.obj", {18, 8, 6}, here), coarse = source("coarse.obj", {3, 2, 1}, here),
                    moved = source("moved.obj", {18, 8, 6}, there), car = (files.folder.path / "box.car").string();
  BakeOptions options;
  options.input = full;
  options.nodes = 300;
  options.mesher = Mesher::lattice;
  write_car(*bake(options, {}).car, car);
  const auto mapped = [&](const std::string& mesh, int code) {
    testing::internal::CaptureStdout();
    testing::internal::CaptureStderr();
    EXPECT_EQ(map_mesh(car, mesh), code);
    return testing::internal::GetCapturedStdout() + testing::internal::GetCapturedStderr();
  };
  const size_t vertices = 3 * box_surface({18, 8, 6}).triangle.size();  // an OBJ file names them anew for each triangle
  const std::string exact = mapped(full, 0), level = mapped(coarse, 0), other = mapped(moved, 1);
  EXPECT_NE(exact.find(std::to_string(vertices) + " vertices; " + std::to_string(vertices) + " lie on"), exact.npos) << exact;
  EXPECT_NE(level.find("at most 0.0 mm"), level.npos) << "a coarser level of the same box: " << level;
  EXPECT_NE(other.find("other coordinates"), other.npos) << other;

  // Painted anew, the car still knows its source. A car that was made from no file does not.
  BakeOptions again;
  again.input = car;
  EXPECT_EQ(bake(again, {}).car->source_to_car.size(), 12u);
  write_car(*box_car(), car);
  expect_sentence(refusal([&] { map_mesh(car, full); }), "box.car", "bake it again");
}

}  // namespace
}  // namespace crumple

// The names of a file's parts, and what a bake tells of the parts that lie far outside the tets.

#include "bake/report_parts.h"

#include <gtest/gtest.h>

#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include "bake/bake.h"
#include "box_car.h"
#include "refusal.h"

namespace crumple {
namespace {

std::string number(double value) { return std::to_string(value); }

// Appends an object to an OBJ file that has `count` vertices so far.
void add_object(std::string& text, size_t& count, const std::string& name, const std::vector<Vec3>& vertex,
                const std::vector<uint32_t>& triangle) {
  text += "o " + name + "\n";
  for (const Vec3& v : vertex) text += "v " + number(v.x()) + " " + number(v.y()) + " " + number(v.z()) + "\n";
  for (size_t i = 0; i < triangle.size(); i += 3) {
    text += "f";
    for (size_t k = 0; k < 3; ++k) text += " " + std::to_string(count + triangle[i + k] + 1);
    text += "\n";
  }
  count += vertex.size();
}

// A box filled with tets, as a Medit file, and as a surface with parts that stick out of it.
struct BoxWithParts {
  Files files;
  std::filesystem::path obj, tets;

  BoxWithParts() {
    const BoxMesh box = box_mesh({});
    std::string text;
    size_t count = 0;
    std::vector<Vec3> vertex;
    for (uint32_t node : box.surface) vertex.push_back(box.tets.node[node]);
    add_object(text, count, "body", vertex, box.triangle);
    const auto on_the_roof = [&](const char* name, float x, float high, float wide) {
      add_object(text, count, name, {{x, 0, 1.5f}, {x + wide, 0, 1.5f}, {x + wide, wide, 1.5f}, {x, 0, 1.5f + high}},
                 {0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2});
    };
    on_the_roof("aerial", 1, 0.3f, 0.01f);
    on_the_roof("rack", -1, 0.1f, 0.6f);
    on_the_roof("sign", 0, 0.05f, 0.5f);
    on_the_roof("lamp", 0.5f, 0.045f, 0.5f);
    on_the_roof("badge", -2, 0.03f, 0.2f);
    obj = files.write("box.obj", text);
    std::string medit = "MeshVersionFormatted 2\nDimension 3\nVertices\n" + std::to_string(box.tets.node.size()) + "\n";
    for (const Vec3& v : box.tets.node) medit += number(v.x()) + " " + number(v.y()) + " " + number(v.z()) + " 0\n";
    medit += "Tetrahedra\n" + std::to_string(box.tets.tet.size()) + "\n";
    for (const Tet& tet : box.tets.tet) {
      for (uint32_t node : tet.node) medit += std::to_string(node + 1) + " ";
      medit += "0\n";
    }
    tets = files.write("box.mesh", medit + "End\n");
  }
};

TEST(FarParts, TheThreeWorstAreNamedWithTheirDistanceAndPlace) {
  const BoxWithParts box;
  BakeOptions options;
  options.input = box.obj.string();
  options.tets = box.tets;
  std::vector<std::string> warnings;
  for (const std::string& line : bake(options, {}).report)
    if (contains(line, "rides on tets")) warnings.push_back(line);
  ASSERT_EQ(warnings.size(), 3u);
  EXPECT_TRUE(warnings[0].starts_with("warning: aerial: ")) << warnings[0];
  EXPECT_TRUE(contains(warnings[0], " mm thin, rides on tets up to 300 mm away, farthest at x 1.0")) << warnings[0];
  EXPECT_TRUE(contains(warnings[0], "z 1.80 (1 of 4 vertices are beyond 40 mm)")) << warnings[0];
  EXPECT_TRUE(warnings[1].starts_with("warning: rack: rides on tets up to 100 mm away")) << warnings[1];
  EXPECT_TRUE(warnings[2].starts_with("warning: sign: ")) << warnings[2];
  EXPECT_TRUE(contains(warnings[2], "rides on tets up to 50 mm away")) << warnings[2];
  EXPECT_TRUE(warnings[2].ends_with("; so does 1 more part, less far")) << warnings[2];  // the lamp, not the badge
}

TEST(FarParts, NothingIsToldOfACarWithinItsTetsOrWithoutNames) {
  const std::vector<Vec3> vertex = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
  const std::vector<uint32_t> triangle = {0, 1, 2};
  EXPECT_TRUE(report_far_parts(vertex, triangle, std::vector<double>{0, 0.04, 0}, {{"a", 0}}).empty());
  EXPECT_TRUE(report_far_parts(vertex, triangle, std::vector<double>{0, 1, 0}, {}).empty());
  EXPECT_TRUE(report_far_parts(vertex, triangle, std::vector<double>{0, 1, 0}, {{"a", 1}}).empty());  // it lost its triangle
  EXPECT_EQ(report_far_parts(vertex, triangle, std::vector<double>{0, 1, 0}, {{"a", 0}, {"b", 0}}).size(), 1u);
}

TEST(Names, StayWithTheirTrianglesWhenOthersAreDropped) {
  const Files files;
  const std::string vertices = "v 0 0 0\nv 4 0 0\nv 0 2 0\nv 0 0 1\n";
  const ImportedSurface read = import_surface(
      files.write("two.obj", vertices + "o first\nf 1 1 2\nf 1 2 3\no gone\nf 2 2 3\no last\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"), {});
  ASSERT_EQ(read.named.size(), 3u);
  EXPECT_EQ(read.surface.triangle.size(), 4u);
  EXPECT_EQ(read.named[0].name, "first");
  EXPECT_EQ(read.named[0].first, 0u);
  EXPECT_EQ(read.named[1].name, "gone");
  EXPECT_EQ(read.named[1].first, 1u);
  EXPECT_EQ(read.named[2].name, "last");
  EXPECT_EQ(read.named[2].first, 1u);
}

// One tet that each of these nodes holds.
std::filesystem::path write_named_gltf(const Files& files, const std::vector<std::string>& names) {
  const float positions[12] = {0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 3};
  const uint16_t indices[12] = {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3};
  std::string bytes(sizeof positions + sizeof indices, 0), nodes, list;
  std::memcpy(bytes.data(), positions, sizeof positions);
  std::memcpy(bytes.data() + sizeof positions, indices, sizeof indices);
  files.write("tet.bin", bytes);
  for (size_t i = 0; i < names.size(); ++i) {
    nodes += (i ? ",{\"mesh\":0,\"name\":\"" : "{\"mesh\":0,\"name\":\"") + names[i] + "\"}";
    list += (i ? "," : "") + std::to_string(i);
  }
  return files.write("named.gltf", R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[)" + list + R"(]}],"nodes":[)" +
                                       nodes + R"(],"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
    "accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],"max":[1,1,3]},
                 {"bufferView":1,"componentType":5123,"count":12,"type":"SCALAR"}],
    "bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":48},{"buffer":0,"byteOffset":48,"byteLength":24}],
    "buffers":[{"uri":"tet.bin","byteLength":72}]})");
}

void expect_shown(const NamedPart& part) {
  EXPECT_FALSE(part.name.empty());
  EXPECT_LE(part.name.size(), 128u);
  for (const char c : part.name) EXPECT_TRUE(c >= ' ' && c <= '~') << int(c);
}

TEST(Names, OfStrangersAreCutAndShownAsPrintableText) {
  const Files files;
  const std::vector<std::string> names = {
      "\\u001b[2Jfender", "line\\nwarning: forged", "T\xc3\xbcr", std::string(600, 'a'), "   ", "%s%n", "nul\\u0000 and more"};
  const ImportedSurface read = import_surface(write_named_gltf(files, names), {});
  ASSERT_EQ(read.named.size(), names.size());
  for (const NamedPart& part : read.named) expect_shown(part);
  EXPECT_EQ(read.named[0].name, "?[2Jfender");
  EXPECT_EQ(read.named[1].name, "line?warning: forged");
  EXPECT_EQ(read.named[2].name, "T??r");
  EXPECT_EQ(read.named[3].name, std::string(128, 'a'));
  EXPECT_EQ(read.named[5].name, "%s%n");
}

TEST(Names, BeyondTheirMostAreOneOtherPart) {
  const Files files;
  std::vector<std::string> names;
  for (int i = 0; i < 5000; ++i) names.push_back("part " + std::to_string(i));
  const ImportedSurface read = import_surface(write_named_gltf(files, names), {});
  ASSERT_EQ(read.named.size(), 4096u);
  EXPECT_EQ(read.surface.triangle.size(), 20'000u);
  EXPECT_EQ(read.named[4094].name, "part 4094");
  EXPECT_EQ(read.named[4095].name, "other parts");
  EXPECT_EQ(read.named[4095].first, size_t{4} * 4095);
}

}  // namespace
}  // namespace crumple

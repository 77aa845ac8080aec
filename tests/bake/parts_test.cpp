// Tests the division of a surface into parts: by names, by materials, by shape, by a file, and refusals.
#include "bake/parts.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <map>
#include <set>

#include "bake/bake.h"
#include "bake/built_in.h"
#include "bake/load_car.h"
#include "refusal.h"
#include "wheeled_car.h"

namespace crumple {
namespace {

using schema::PartKind;

struct Object {
  std::string name, material;
  Surface surface;
};

Surface cylinder(const Vec3& hub, float radius = wheel_radius, float width = wheel_width) {
  Surface out;
  add_cylinder(out, hub, radius, width);
  return out;
}

Surface box(const Vec3& center, const Vec3& half) {
  Surface out;
  for (int i = 0; i < 8; ++i)
    out.vertex.push_back(center +
                         Vec3(i & 1 ? half.x() : -half.x(), i & 2 ? half.y() : -half.y(), i & 4 ? half.z() : -half.z()));
  out.triangle = {{0, 2, 3}, {0, 3, 1}, {4, 5, 7}, {4, 7, 6}, {0, 1, 5}, {0, 5, 4},
                  {2, 6, 7}, {2, 7, 3}, {0, 4, 6}, {0, 6, 2}, {1, 3, 7}, {1, 7, 5}};
  return out;
}

std::vector<Object> car_of(const std::string& wheel) {
  std::vector<Object> out = {{"body", "paint", box({0, 0, 0.8f}, {2.2f, 0.85f, 0.5f})},
                             {"windscreen", "paint", box({0.3f, 0, 1.5f}, {0.8f, 0.7f, 0.2f})},
                             {"seat_left", "paint", box({0, 0.3f, 0.8f}, {0.2f, 0.2f, 0.2f})},
                             {"HeadLight.001", "paint", box({2.1f, 0.6f, 0.7f}, {0.05f, 0.1f, 0.1f})}};
  for (const Vec3& hub : wheel_hubs) out.push_back({wheel, "rubber", cylinder(hub)});
  return out;
}

std::filesystem::path write_obj(const Files& files, const std::vector<Object>& objects, const std::string& materials = "") {
  if (!materials.empty()) files.write("car.mtl", materials);
  std::string text = materials.empty() ? "" : "mtllib car.mtl\n";
  size_t before = 1;
  for (const Object& object : objects) {
    if (!object.name.empty()) text += "o " + object.name + "\n";
    if (!materials.empty()) text += "usemtl " + object.material + "\n";
    for (const Vec3& v : object.surface.vertex)
      text += "v " + std::to_string(v.x()) + " " + std::to_string(v.y()) + " " + std::to_string(v.z()) + "\n";
    for (const Triangle& t : object.surface.triangle)
      text += "f " + std::to_string(before + t[0]) + " " + std::to_string(before + t[1]) + " " + std::to_string(before + t[2]) +
              "\n";
    before += object.surface.vertex.size();
  }
  return files.write("car.obj", text);
}

struct Divided {
  ImportedSurface surface;
  std::vector<std::string> report;
  PartsText text;
  Division division;
  explicit Divided(const std::filesystem::path& file)
      : surface(import_surface(file, {})),
        text(propose_parts(surface, report)),
        division(divide_surface(surface, text, file)) {}
  const Part* part(const std::string& name) const {
    for (const Part& each : division.part)
      if (each.name == name) return &each;
    return nullptr;
  }
  size_t triangles(const std::string& name) const {
    const Part* of = part(name);
    return of ? size_t(std::count(division.of_triangle.begin(), division.of_triangle.end(), of - division.part.data())) : 0;
  }
};

void expect_four_wheels(const Divided& car) {
  for (size_t k = 0; k < 4; ++k) {
    const std::string name = std::string("wheel ") + (k < 2 ? "front" : "rear") + (k % 2 ? " right" : " left");
    const Part* wheel = car.part(name);
    ASSERT_TRUE(wheel) << name;
    EXPECT_EQ(wheel->kind, PartKind::wheel);
    EXPECT_NEAR(wheel->position[0], wheel_hubs[k].x(), 1e-3f);
    EXPECT_NEAR(wheel->position[1], wheel_hubs[k].y(), 1e-3f);
    EXPECT_NEAR(wheel->position[2], wheel_radius, 1e-3f);
    EXPECT_NEAR(wheel->radius, wheel_radius, 1e-3f);
    EXPECT_NEAR(wheel->width, wheel_width, 1e-3f);
    EXPECT_EQ(car.triangles(name), 96u);
  }
}

TEST(CarParts, AreProposedByNames) {
  const Files files;
  const Divided car(write_obj(files, car_of("Wheel_x")));
  expect_four_wheels(car);
  EXPECT_EQ(car.triangles("glass"), 12u);
  EXPECT_EQ(car.triangles("interior"), 12u);
  EXPECT_EQ(car.triangles("lights"), 12u);
  EXPECT_EQ(car.triangles("body"), 12u);
  std::string all;
  for (const std::string& line : car.report) all += line + "\n";
  EXPECT_NE(all.find("parts: glass by name: 'windscreen'"), all.npos) << all;
  EXPECT_NE(all.find("parts: 4 wheels by name: 'Wheel_x', 0.30 m radius"), all.npos) << all;
}

TEST(CarParts, AreProposedByShapeWhereNamesSayNothing) {
  const Files files;
  std::vector<Object> objects = car_of("");
  for (Object& object : objects) object.name = "";
  objects.push_back({"", "", cylinder({-1.8f, 0, 0.9f})});                  // a spare wheel on the tail
  objects.push_back({"", "", cylinder({0.5f, 0.4f, 1.0f}, 0.18f, 0.05f)});  // a steering wheel
  objects.push_back({"", "", box({0, 0.95f, 0.2f}, {0.3f, 0.05f, 0.2f})});  // a square step
  objects.push_back({"", "", box({0, -0.95f, 0.2f}, {0.3f, 0.05f, 0.2f})});
  const Divided car(write_obj(files, objects));
  expect_four_wheels(car);
  EXPECT_EQ(car.division.part.size(), 5u);
  EXPECT_NE(car.report.back().find("4 wheels by shape"), std::string::npos) << car.report.back();
}

TEST(CarParts, ARimAndATyreAreOneWheel) {
  const Files files;
  std::vector<Object> objects = car_of("tyre");
  for (const Vec3& hub : wheel_hubs)
    objects.push_back({"metal", "", cylinder(hub + Vec3(0, hub.y() > 0 ? 0.02f : -0.02f, 0), 0.2f, 0.2f)});
  const Divided car(write_obj(files, objects));
  const Part* wheel = car.part("wheel front left");
  ASSERT_TRUE(wheel);
  EXPECT_EQ(car.triangles("wheel front left"), 192u);
  EXPECT_NEAR(wheel->width, wheel_width + 0.02f, 1e-3f);
}

TEST(CarParts, GlassIsFoundByATransparentMaterial) {
  const Files files;
  std::vector<Object> objects = car_of("wheel");
  objects[1] = {"mesh_7", "clear", objects[1].surface};
  const Divided car(write_obj(files, objects, "newmtl paint\nKd 1 0 0\nnewmtl clear\nd 0.3\nnewmtl rubber\nKd 0 0 0\n"));
  EXPECT_EQ(car.triangles("glass"), 12u);
  EXPECT_NE(car.report.back().find("wheels"), std::string::npos);
}

TEST(CarParts, AWheelThatIsJoinedToTheBodyIsNone) {
  const Files files;
  Object all{"car", "", box({0, 0, 0.8f}, {2.2f, 0.85f, 0.5f})};
  for (const Vec3& hub : wheel_hubs) {
    add_cylinder(all.surface, hub, wheel_radius, wheel_width);
    all.surface.triangle.push_back({0, 1, uint32_t(all.surface.vertex.size() - 1)});
  }
  const Divided car(write_obj(files, {all}));
  EXPECT_TRUE(car.division.part.empty());
  EXPECT_NE(car.report.back().find("no wheels"), std::string::npos) << car.report.back();
}

TEST(CarParts, WhatWasProposedCanBeReadBackAndChanged) {
  const Files files;
  const std::filesystem::path file = write_obj(files, car_of("wheel"));
  const Divided car(file);
  const Division again = divide_surface(car.surface, read_parts(files.write("parts.json", car.text.text)), file);
  EXPECT_EQ(again.of_triangle, car.division.of_triangle);
  const PartsText changed{"parts.json", R"({ parts: [ { name: "seat", kind: "interior", source: ["SEAT*"] },
    { name: "lid", kind: "panel", source: ["wind?creen"] }, { name: "front left", kind: "wheel", position: {x: 1.3, y: 1, z: 0.3}, radius: 0.3, width: 0.2 },
    { name: "camera", kind: "point", position: {x: 0.2, y: 0, z: 1.2}, orientation: {x: 0, y: 0, z: 1, w: 0} } ] })"};
  const Division other = divide_surface(car.surface, changed, file);
  ASSERT_EQ(other.part.size(), 5u);
  EXPECT_EQ(other.part[1].kind, PartKind::interior);
  EXPECT_EQ(other.part[2].kind, PartKind::panel);
  EXPECT_EQ(std::count(other.of_triangle.begin(), other.of_triangle.end(), 3), 96);
  EXPECT_EQ(other.part[4].orientation, (std::array<float, 4>{0, 0, 1, 0}));
}

TEST(CarParts, AWrongFileIsRefusedWithASentence) {
  const Files files;
  const std::filesystem::path file = write_obj(files, car_of("wheel"));
  const ImportedSurface surface = import_surface(file, {});
  const auto why = [&](const std::string& entries) {
    return refusal([&] { (void)divide_surface(surface, {"parts.json", "{parts: [" + entries + "]}"}, "car.obj"); });
  };
  const std::string at = "position: {x: 1.3, y: 1, z: 0.3}";
  EXPECT_EQ(why(""), "");
  expect_sentence(why("7"), "parts.json", "parts.fbs");
  expect_sentence(why(R"({name: "a", kind: "sail", source: ["*"]})"), "parts.json", "sail");
  expect_sentence(why(R"({name: "", kind: "glass", source: ["*"]})"), "parts.json", "name");
  expect_sentence(why(R"({name: "a", kind: "glass"})"), "\"a\"", "needs a source");
  expect_sentence(why(R"({name: "a", kind: "glass", source: ["windo"]})"), "windo", "car.obj; its names are");
  expect_sentence(why(R"({name: "a", kind: "glass", source: ["wind*"], radius: 1})"), "\"a\"", "leave it out");
  expect_sentence(why(R"({name: "a", kind: "wheel"})"), "\"a\"", "or a source");
  expect_sentence(why(R"({name: "a", kind: "wheel", )" + at + "}"), "\"a\"", "radius and a width");
  expect_sentence(why(R"({name: "a", kind: "wheel", source: ["wheel"], radius: 1})"), "\"a\"", "no position");
  expect_sentence(why(R"({name: "a", kind: "wheel", radius: 0.3, width: 0.2, position: {x: 9, y: 0, z: 0}})"), "\"a\"",
                  "outside the car");
  expect_sentence(why(R"({name: "a", kind: "wheel", radius: 0.3, width: 0.2, position: {x: nan, y: 0, z: 0}})"), "\"a\"",
                  "outside the car");
  expect_sentence(why(R"({name: "a", kind: "wheel", radius: 0.1, width: 0.2, )" + at + "}"), "\"a\"",
                  "holds no connected piece");
  expect_sentence(why(R"({name: "a", kind: "point"})"), "\"a\"", "position");
  expect_sentence(why(R"({name: "a", kind: "point", radius: 1, )" + at + "}"), "\"a\"", "leave it out");
  expect_sentence(why(R"({name: "a", kind: "point", orientation: {x: 1, y: 1, z: 0, w: 0}, )" + at + "}"), "\"a\"",
                  "quaternion");
  const std::string point = R"({name: "a", kind: "point", )" + at + "}";
  expect_sentence(why(point + "," + point), "\"a\"", "twice");
  expect_sentence(why(point + R"(, {name: "a", kind: "glass", source: ["wind*"]})"), "\"a\"", "two kinds");
  std::string many;
  for (int i = 0; i < 255; ++i) many += R"({name: "p)" + std::to_string(i) + R"(", kind: "point", )" + at + "},";
  expect_sentence(why(many), "\"p254\"", "255 parts");
}

TEST(CarParts, WheelsAndInteriorGetNoTetsAndComeBackFromTheFile) {
  const Files files;
  BakeOptions options;
  options.input = write_obj(files, car_of("wheel"));
  options.mesher = Mesher::lattice;
  options.nodes = 400;
  const BakeResult baked = bake(options, nullptr);
  for (const Vec3& node : baked.car->model.node) EXPECT_GT(node.z(), 0.15f);  // wheels reach down to 0, the body to 0.3
  write_car(*baked.car, files.folder.path / "car.car");
  const auto car = load_car(files.folder.path / "car.car");
  ASSERT_EQ(car->parts.of_vertex.size(), car->model.vertex.size());
  ASSERT_EQ(car->parts.part.size(), 8u);
  std::map<std::string, size_t> vertices;
  for (uint8_t part : car->parts.of_vertex) ++vertices[car->parts.part[part].name];
  EXPECT_EQ(vertices["wheel front left"], 50u);
  EXPECT_EQ(vertices["glass"], 8u);
  for (size_t v = 0; v < car->model.vertex.size(); ++v)
    if (car->parts.part[car->parts.of_vertex[v]].kind == PartKind::wheel) {
      EXPECT_EQ(car->model.skin[v].weight[0], 1);
    }
  options.parts = PartsText{"parts.json", R"({parts: [{name: "all", kind: "interior", source: ["*"]}]})"};
  expect_sentence(refusal([&] { (void)bake(options, nullptr); }), "car.obj", "all that it has");

  BakeOptions paint;
  paint.input = files.folder.path / "car.car";
  const BakeResult painted = bake(paint, nullptr);
  EXPECT_EQ(painted.car->hash, car->hash);
}

TEST(CarParts, BodyAndGlassShareNoVertexAndMoveAlike) {
  const auto car = wheeled_box_car().car;
  std::map<std::array<float, 3>, size_t> first;
  size_t twins = 0;
  for (size_t v = 0; v < car->model.vertex.size(); ++v) {
    const Vec3& at = car->model.vertex[v];
    const auto [known, is_new] = first.try_emplace({at.x(), at.y(), at.z()}, v);
    if (is_new) continue;
    ++twins;
    EXPECT_NE(car->parts.of_vertex[v], car->parts.of_vertex[known->second]);
    EXPECT_EQ(std::memcmp(&car->model.skin[v], &car->model.skin[known->second], sizeof(Skin)), 0);
  }
  EXPECT_GT(twins, 10u) << "the edge of the roof";
}

TEST(CarParts, PanelsAreProposedByNameEachByItself) {
  const Files files;
  std::vector<Object> objects = car_of("Wheel_x");
  objects.push_back({"Door_FL", "paint", box({0, 0.9f, 0.8f}, {0.4f, 0.02f, 0.3f})});
  objects.push_back({"Door_FR", "paint", box({0, -0.9f, 0.8f}, {0.4f, 0.02f, 0.3f})});
  objects.push_back({"bonnet", "paint", box({1.5f, 0, 1.35f}, {0.5f, 0.6f, 0.02f})});
  objects.push_back({"DoorHandle", "paint", box({0, 0.95f, 0.9f}, {0.05f, 0.01f, 0.02f})});
  const Divided car(write_obj(files, objects));
  for (const char* name : {"Door_FL", "Door_FR", "bonnet"}) {
    ASSERT_TRUE(car.part(name)) << name;
    EXPECT_EQ(car.part(name)->kind, PartKind::panel);
    EXPECT_EQ(car.triangles(name), 12u);
  }
  EXPECT_FALSE(car.part("DoorHandle"));
  EXPECT_EQ(car.triangles("glass"), 12u);
}

std::string front_of(const ImportedSurface& surface) {
  for (const std::string& line : surface.report)
    if (line.find("front") != std::string::npos && line.find("forward is") == std::string::npos &&
        (line.starts_with("front: ") || line.starts_with("warning: the front")))
      return line;
  return "";
}

TEST(CarParts, NamesTellWhichEndIsTheFrontAndElseItIsAsked) {
  const Files files;
  const auto file = write_obj(files, car_of("Wheel_x"));
  EXPECT_TRUE(front_of(import_surface(file, {})).starts_with("front: 'HeadLight.001'")) << front_of(import_surface(file, {}));
  const std::string turned = front_of(import_surface(file, {"-x", "z", 1}));
  EXPECT_TRUE(turned.starts_with("warning: the front")) << turned;
  EXPECT_NE(turned.find("--forward x"), turned.npos) << turned;
  std::vector<Object> objects = car_of("Wheel_x");
  objects[3].name = "thing";
  const std::string asked = front_of(import_surface(write_obj(files, objects), {}));
  EXPECT_NE(asked.find("--forward -x"), asked.npos) << asked;
}

TEST(CarParts, ACarKeepsTheLooksOfMaterialsThatHaveNoTexture) {
  const Files files;
  files.write("paint.png", "no picture, and nobody looks");
  BakeOptions options;
  options.nodes = 400;
  options.mesher = Mesher::lattice;
  options.input =
      write_obj(files, car_of("Wheel_x"), "newmtl paint\nKd 1 1 1\nmap_Kd paint.png\nnewmtl rubber\nKd 0.5 0 0\nd 0.25\n")
          .string();
  const auto car = bake(options, {}).car;
  ASSERT_EQ(car->looks.look.size(), 1u);
  const Look& rubber = car->looks.look[0];
  EXPECT_EQ(rubber.name, "rubber");
  EXPECT_NEAR(rubber.color[0], std::pow(0.5, 2.2), 1e-6) << "in linear light";
  EXPECT_EQ(rubber.color[1], 0);
  EXPECT_EQ(rubber.color[3], 0.25f);
  ASSERT_EQ(car->looks.of_triangle.size(), car->model.triangle.size() / 3);
  size_t with = 0;
  for (size_t t = 0; t < car->looks.of_triangle.size(); ++t) {
    const bool wheel = car->parts.part[car->parts.of_vertex[car->model.triangle[3 * t]]].kind == PartKind::wheel;
    EXPECT_EQ(car->looks.of_triangle[t], wheel ? 0 : no_look);
    with += wheel;
  }
  EXPECT_EQ(with, 4 * 96u);
  BakeOptions painted;
  painted.input = options.input;
  EXPECT_EQ(rebake(*car, painted).car->looks.look, car->looks.look);
}

// A car with these looks, as another program may write it.
std::string refused_looks(const std::function<void(schema::CarT&)>& change) {
  const auto car = wheeled_box_car().car;
  schema::CarT file;
  schema::GetCar(car->bytes.data())->UnPackTo(&file);
  auto look = std::make_unique<schema::LookT>();
  look->name = "red";
  look->color = std::make_unique<schema::Color>(1.0f, 0.0f, 0.0f, 1.0f);
  file.look.push_back(std::move(look));
  file.triangle_look.assign(file.triangle.size() / 3, 0);
  change(file);
  flatbuffers::FlatBufferBuilder builder;
  schema::FinishCarBuffer(builder, schema::Car::Pack(builder, &file));
  return refusal([&] {
    (void)read_car(std::string(reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize()), "looks");
  });
}

TEST(CarParts, WrongLooksAreRefused) {
  EXPECT_EQ(refused_looks([](schema::CarT&) {}), "");
  EXPECT_EQ(refused_looks([](schema::CarT& car) { car.triangle_look[3] = no_look; }), "");
  const auto expect = [](const char* part, const std::function<void(schema::CarT&)>& change) {
    expect_sentence(refused_looks(change), "looks", part);
  };
  expect("a look that does not exist", [](schema::CarT& car) { car.triangle_look[3] = 1; });
  expect("matching lengths", [](schema::CarT& car) { car.triangle_look.pop_back(); });
  expect("matching lengths", [](schema::CarT& car) { car.look.clear(); });
  expect("from 0 to 1", [](schema::CarT& car) { *car.look[0]->color = schema::Color(1.5f, 0, 0, 1); });
  expect("from 0 to 1", [](schema::CarT& car) { car.look[0]->roughness = std::nanf(""); });
  expect("name of a look", [](schema::CarT& car) { car.look[0]->name = "\n"; });
}

TEST(CarParts, TheBuiltInCarHasWheelsGlassLightsAndSeatsAndItsBodyIsAsItWas) {
  BakeOptions options;
  options.input = "built-in";
  options.nodes = 300;
  options.mesher = Mesher::lattice;
  const auto car = bake(options, {}).car;
  std::map<PartKind, int> count;
  for (const Part& part : car->parts.part) ++count[part.kind];
  EXPECT_EQ(count[PartKind::wheel], 4);
  for (const PartKind kind : {PartKind::glass, PartKind::light, PartKind::interior}) EXPECT_EQ(count[kind], 1);
  const Surface body = build_car_body(1259);
  std::set<std::array<float, 3>> there;
  Eigen::AlignedBox3f box;
  for (const Vec3& v : body.vertex) box.extend(v);
  const Vec3 lifted(-box.center().x(), 0, 0.15f);  // its wheels stand on the ground
  const auto place = [](const Vec3& v) {
    return std::array{std::round(1e4f * v.x()), std::round(1e4f * v.y()), std::round(1e4f * v.z())};
  };
  for (size_t v = 0; v < car->model.vertex.size(); ++v) there.insert(place(car->model.vertex[v]));
  float least = 1;
  for (const Part& part : car->parts.part)
    if (part.kind == PartKind::wheel) least = std::min(least, part.position[2] - part.radius);
  EXPECT_NEAR(least, 0, 1e-4f);
  size_t missing = 0;
  for (const Vec3& v : body.vertex) missing += !there.contains(place(v + lifted));
  EXPECT_LT(missing, 30u) << "rounding may move a few";
}

TEST(CarParts, GlTFOfVersion1IsRefused) {
  const Files files;
  const auto file = files.write("old.gltf", R"({"asset":{"version":"1.0"},"scene":"s","scenes":{"s":{"nodes":["n"]}},
    "nodes":{"n":{"children":[],"meshes":["m"]}},"meshes":{"m":{"primitives":[{"attributes":{"POSITION":"a"},"mode":4}]}},
    "accessors":{"a":{"bufferView":"v","byteOffset":0,"byteStride":12,"componentType":5126,"count":3,"type":"VEC3"}},
    "bufferViews":{"v":{"buffer":"b","byteOffset":0,"byteLength":36,"target":34962}},
    "buffers":{"b":{"byteLength":36,"type":"arraybuffer","uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}}})");
  expect_sentence(refusal([&] { (void)import_surface(file, {}); }), "old.gltf", "glTF 2.0");
}

}  // namespace
}  // namespace crumple

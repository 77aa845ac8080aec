// Tests reading a baked car: an accepted car is sound and points into the file, and every other file is refused with a
// sentence.

#include "car/car.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <cstring>
#include <limits>

#include "bake/bake.h"
#include "bake/load_car.h"
#include "box_car.h"
#include "refusal.h"
#include "schema/car_generated.h"

namespace crumple {
namespace {

TEST(Car, ViewsPointIntoTheFileAndAreWhatWasWritten) {
  const auto car = box_car();
  const BoxMesh box = box_mesh({});
  ASSERT_EQ(car->model.node.size(), box.tets.node.size());
  for (size_t i = 0; i < box.tets.node.size(); ++i) EXPECT_EQ(car->model.node[i], box.tets.node[i]);
  const auto* first = reinterpret_cast<const std::byte*>(car->model.tet.data());
  EXPECT_TRUE(first > car->bytes.data() && first < car->bytes.data() + car->bytes.size());
  EXPECT_EQ(car->regions, std::vector<std::string>{"body"});
  EXPECT_EQ(car->hash.size(), 16u);
}

TEST(Car, OutlivesTheBytesItWasReadFrom) {
  auto bytes = box_car_bytes();
  const auto car = read_car(bytes, "box");
  std::fill(bytes.begin(), bytes.end(), std::byte{0xff});
  EXPECT_EQ(car->model.tet[0].node[0], box_mesh({}).tets.tet[0].node[0]);
}

TEST(Car, IsTheSameMappedFromAFileAndReadFromBytes) {
  const Files files;
  const auto read = box_car();
  write_car(*read, files.folder.path / "box.car");
  const auto loaded = load_car(files.folder.path / "box.car");
  EXPECT_EQ(loaded->hash, read->hash);
  EXPECT_TRUE(std::equal(loaded->bytes.begin(), loaded->bytes.end(), read->bytes.begin(), read->bytes.end()));
}

TEST(Car, RefusesEveryPrefixOfItself) {
  const auto bytes = box_car_bytes({2, 1, 1});
  for (size_t size = 0; size < bytes.size(); ++size) {
    const std::string why = refusal([&] { (void)read_car(std::span(bytes).first(size), "cut.car"); });
    ASSERT_TRUE(why.starts_with("cut.car: ")) << size << ": " << why;
  }
}

// Checks that every index of an accepted car is in range.
void expect_sound(const Car& car) {
  const Model& m = car.model;
  const auto below = [](uint32_t value, size_t limit) { ASSERT_LT(value, limit); };
  for (const Tet& tet : m.tet)
    for (uint32_t node : tet.node) below(node, m.node.size());
  for (const Edge& edge : m.edge)
    for (uint32_t node : edge.node) below(node, m.node.size());
  for (const Skin& skin : m.skin) {
    float sum = 0;
    for (int k = 0; k < 4; ++k) below(skin.node[k], m.node.size()), sum += skin.weight[k];
    ASSERT_NEAR(sum, 1, 0.1);
  }
  for (uint32_t corner : m.corner) below(corner, 4 * m.tet.size());
  for (uint32_t first : m.node_first) below(first, m.corner.size() + 1);
  for (uint32_t vertex : m.triangle) below(vertex, m.vertex.size());
  for (uint8_t region : m.node_region) below(region, car.regions.size());
  for (uint8_t region : m.tet_region) below(region, car.regions.size());
  for (float rest : m.tet_rest) ASSERT_GT(rest, 0);
  for (float rest : m.edge_rest) ASSERT_GT(rest, 0);
  for (float mass : m.node_mass) ASSERT_GT(mass, 0);
  ASSERT_EQ(m.node_mass.size(), m.node.size());
  ASSERT_EQ(m.gradients.size(), m.tet.size());
  ASSERT_EQ(m.skin.size(), m.vertex.size());
}

TEST(Car, IsRefusedOrSoundAfterAnySingleBitFlip) {
  auto bytes = box_car_bytes({2, 1, 1});
  size_t refused = 0;
  for (size_t bit = 0; bit < 8 * bytes.size(); ++bit) {
    const std::byte flip{static_cast<unsigned char>(1u << bit % 8)};
    bytes[bit / 8] ^= flip;
    std::shared_ptr<const Car> car;
    refused += !refusal([&] { car = read_car(bytes, "flipped.car"); }).empty();
    if (car) expect_sound(*car);
    ASSERT_FALSE(HasFatalFailure()) << "bit " << bit;
    bytes[bit / 8] ^= flip;
  }
  EXPECT_GT(refused, 4 * bytes.size());  // not all, because low bits of mantissas and of names may have any value
}

TEST(Car, SaysWhatIsWrongWithAFile) {
  const Files files;
  expect_sentence(refusal([&] { (void)load_car(files.folder.path / "none.car"); }), "none.car", "cannot be opened");
  expect_sentence(refusal([&] { (void)load_car(files.folder.path); }), files.folder.path, "not a file");
  expect_sentence(refusal([&] { (void)load_car(files.write("empty.car", "")); }), "empty.car", "empty");
  expect_sentence(refusal([&] { (void)load_car(files.write("text.car", "a text, not a car")); }), "text.car",
                  "not a baked car");
}

constexpr size_t region_name_limit = 256;  // bytes

// The bytes of a car with `count` regions that all share one name of `size` bytes.
std::vector<std::byte> car_of_regions(size_t count, size_t size) {
  const auto bytes = box_car_bytes({2, 1, 1});
  schema::CarT car;
  schema::GetCar(bytes.data())->UnPackTo(&car);
  car.region.assign(count, "");
  car.region[0].assign(size, 'x');
  flatbuffers::FlatBufferBuilder builder;
  schema::FinishCarBuffer(builder, schema::Car::Pack(builder, &car));
  const auto* list = schema::GetCar(builder.GetBufferPointer())->region();
  const auto* shared = reinterpret_cast<const uint8_t*>(list->Get(0));
  for (size_t k = 0; k < count; ++k) {
    auto* offset = const_cast<uint8_t*>(list->Data()) + 4 * k;
    flatbuffers::WriteScalar(offset, static_cast<flatbuffers::uoffset_t>(shared - offset));
  }
  const auto* begin = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return {begin, begin + builder.GetSize()};
}

// 8 MB of names would take terabytes if each were copied before they are counted.
TEST(Car, RegionsThatShareOneLongNameTakeNoMemory) {
  const auto peak = [] {
    rusage used;
    getrusage(RUSAGE_SELF, &used);
    return used.ru_maxrss / 1024;  // MiB
  };
  const auto bytes = car_of_regions(2'000, 1 << 20);
  const auto before = peak();
  expect_sentence(refusal([&] { (void)read_car(bytes, "many.car"); }), "many.car", "2000 regions");
  EXPECT_LT(peak() - before, 100) << "MiB";
  expect_sentence(refusal([&] { (void)read_car(car_of_regions(16, region_name_limit + 1), "long.car"); }), "long.car",
                  "name of a region is longer than 256 bytes");
  EXPECT_EQ(read_car(car_of_regions(16, region_name_limit), "good.car")->regions[15], std::string(region_name_limit, 'x'));
}

// Writes `value` into list `field` of a car and reads it again.
template <class T, class Get>
std::string spoiled(Get get, size_t index, T value) {
  auto bytes = box_car_bytes({2, 1, 1});
  const auto car = read_car(bytes, "box");
  const size_t at = reinterpret_cast<const std::byte*>(get(car->model).data()) - car->bytes.data() + index * sizeof(T);
  std::memcpy(bytes.data() + at, &value, sizeof value);
  return refusal([&] { (void)read_car(bytes, "spoiled.car"); });
}

TEST(Car, ChecksEveryList) {
  constexpr float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
  const auto refused = [](const std::string& why, const std::string& fact) {
    SCOPED_TRACE(fact);
    expect_sentence(why, "spoiled.car", fact);
  };
  refused(spoiled<float>([](auto& m) { return m.node; }, 4, nan), "position");
  refused(spoiled<float>([](auto& m) { return m.node; }, 4, 51), "position");
  refused(spoiled<float>([](auto& m) { return m.node; }, 4, 0.3f), "agree with its nodes");
  refused(spoiled<float>([](auto& m) { return m.vertex; }, 4, nan), "position");
  refused(spoiled<float>([](auto& m) { return m.node_mass; }, 1, -1), "mass");
  refused(spoiled<float>([](auto& m) { return m.node_mass; }, 1, 900), "mass, inertia or centre of mass does not agree");
  refused(spoiled<uint8_t>([](auto& m) { return m.node_region; }, 1, 1), "region");
  refused(spoiled<uint8_t>([](auto& m) { return m.tet_region; }, 1, 1), "region");
  refused(spoiled<uint8_t>([](auto& m) { return m.node_anchored; }, 1, 2), "anchor");
  refused(spoiled<uint32_t>([](auto& m) { return m.tet; }, 2, 1u << 30), "tet names a node");
  refused(spoiled<float>([](auto& m) { return m.gradients; }, 3, nan), "gradients");
  refused(spoiled<float>([](auto& m) { return m.gradients; }, 3, 1e-3f), "gradients");
  for (size_t k = 0; k < 9; ++k) refused(spoiled<float>([](auto& m) { return m.gradients; }, 9 * 4 + k, infinity), "gradients");
  refused(spoiled<float>([](auto& m) { return m.tet_rest; }, 3, 0), "rest volume");
  refused(spoiled<float>([](auto& m) { return m.tet_rest; }, 3, 0.7f), "rest volume");
  refused(spoiled<float>([](auto& m) { return m.tet_rest; }, 3, infinity), "rest volume");
  refused(spoiled<uint32_t>([](auto& m) { return m.edge; }, 1, 99'999), "edge names a node");
  refused(spoiled<float>([](auto& m) { return m.edge_rest; }, 1, -0.0f), "rest length");
  refused(spoiled<float>([](auto& m) { return m.edge_rest; }, 1, infinity), "rest length");
  refused(spoiled<uint32_t>([](auto& m) { return m.node_first; }, 1, UINT32_MAX), "tets around each node");
  refused(spoiled<uint32_t>([](auto& m) { return m.corner; }, 1, UINT32_MAX), "tets around each node");
  refused(spoiled<uint32_t>([](auto& m) { return m.corner; }, 5, 47), "tets around each node");  // a tet of another node
  refused(spoiled<uint32_t>([](auto& m) { return m.triangle; }, 0, 12), "triangle");
  refused(spoiled<uint32_t>([](auto& m) { return m.skin; }, 1, 12), "vertex follows");
  refused(spoiled<float>([](auto& m) { return m.skin; }, 4, 0.9f), "sum to 1");
  refused(spoiled<float>([](auto& m) { return m.skin; }, 4, infinity), "sum to 1");
}

}  // namespace
}  // namespace crumple

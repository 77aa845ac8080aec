// The binary part holds, in this order: indices, rest positions, the displacements of each shape, then times, translations,
// rotations and weights of the keys. Each has one buffer view and one accessor. A first pass describes them, a second writes
// them.
#include "recording/gltf.h"

#include <flatbuffers/util.h>

#include <bit>
#include <cmath>
#include <cstdio>
#include <stdexcept>

#include "io/files.h"

namespace crumple {
namespace {

static_assert(std::endian::native == std::endian::little, "as glTF is");

constexpr int type_float = 5126, type_uint = 5125;                 // componentType
constexpr int array_buffer = 34962, element_array_buffer = 34963;  // target

std::string quoted(const std::string& text) {
  std::string out;
  if (!flatbuffers::EscapeString(text.data(), text.size(), &out, true, true))
    throw std::runtime_error("the attribution of a car (or its id) is not UTF-8: bake the car with another --attribution");
  return out;
}

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.9g", value);  // enough for every float
  return text;
}

std::string bounds(std::span<const Vec3> points) {
  Vec3 low = points[0], high = points[0];
  for (const Vec3& point : points) {
    low = low.cwiseMin(point);
    high = high.cwiseMax(point);
  }
  const auto list = [](const Vec3& v) { return "[" + number(v.x()) + "," + number(v.y()) + "," + number(v.z()) + "]"; };
  return ",\"min\":" + list(low) + ",\"max\":" + list(high);
}

// Accessors over one buffer, each with a view of its own.
struct Layout {
  std::string views, accessors;
  uint64_t size = 0;
  int count = 0;

  int add(size_t elements, const char* type, int numbers, int component, int target, const std::string& more) {
    const uint64_t bytes = uint64_t{4} * numbers * elements;
    const char* comma = count ? "," : "";
    views += comma + ("{\"buffer\":0,\"byteOffset\":" + std::to_string(size)) + ",\"byteLength\":" + std::to_string(bytes) +
             (target ? ",\"target\":" + std::to_string(target) : "") + "}";
    accessors += comma + ("{\"bufferView\":" + std::to_string(count)) + ",\"componentType\":" + std::to_string(component) +
                 ",\"count\":" + std::to_string(elements) + ",\"type\":\"" + type + "\"" + more + "}";
    size += bytes;
    return count++;
  }
};

// Converts X forward, Y left, Z up to glTF's Z forward, X left, Y up: a third of a turn about (1, 1, 1).
constexpr const char* upright = "\"rotation\":[-0.5,-0.5,-0.5,0.5]";

std::string describe(const Animation& animation, uint64_t& size) {
  Layout layout;
  const size_t keys = animation.keys.size();
  std::vector<int> indices;
  for (size_t i = 0; i < animation.groups.size(); ++i) {
    const size_t end = i + 1 < animation.groups.size() ? animation.groups[i + 1].first : animation.triangle.size();
    indices.push_back(layout.add(end - animation.groups[i].first, "SCALAR", 1, type_uint, element_array_buffer, ""));
  }
  const int rest = layout.add(animation.vertex.size(), "VEC3", 3, type_float, array_buffer, bounds(animation.vertex));
  std::string targets, weights;
  for (size_t i = 0; i < animation.shapes; ++i) {
    const int shape =
        layout.add(animation.vertex.size(), "VEC3", 3, type_float, array_buffer, bounds(animation.displacement(i)));
    targets += (i ? "," : "") + ("{\"POSITION\":" + std::to_string(shape)) + "}";
    weights += i ? ",0" : "0";
  }
  const std::string range = ",\"min\":[" + number(float(animation.keys.front().time)) + "],\"max\":[" +
                            number(float(animation.keys.back().time)) + "]";
  const int time = layout.add(keys, "SCALAR", 1, type_float, 0, range);
  const int outputs[] = {layout.add(keys, "VEC3", 3, type_float, 0, ""), layout.add(keys, "VEC4", 4, type_float, 0, ""),
                         animation.shapes ? layout.add(keys * animation.shapes, "SCALAR", 1, type_float, 0, "") : -1};
  const char* paths[] = {"translation", "rotation", "weights"};
  std::string samplers, channels;
  for (int i = 0; i < 3 && outputs[i] >= 0; ++i) {
    samplers += (i ? "," : "") + ("{\"input\":" + std::to_string(time)) + ",\"output\":" + std::to_string(outputs[i]) + "}";
    channels +=
        (i ? "," : "") + ("{\"sampler\":" + std::to_string(i)) + ",\"target\":{\"node\":1,\"path\":\"" + paths[i] + "\"}}";
  }
  size = layout.size;
  std::string primitives, materials;
  for (size_t i = 0; i < indices.size(); ++i) {
    const auto& [name, color, metallic, roughness] = animation.groups[i].look;
    primitives += (i ? "," : "") + ("{\"attributes\":{\"POSITION\":" + std::to_string(rest)) +
                  "},\"indices\":" + std::to_string(indices[i]) + ",\"material\":" + std::to_string(i) +
                  (animation.shapes ? ",\"targets\":[" + targets + "]}" : "}");
    materials += (i ? "," : "") + ("{\"name\":" + quoted(name)) + ",\"doubleSided\":true," +
                 (color[3] < 1 ? "\"alphaMode\":\"BLEND\"," : "") + "\"pbrMetallicRoughness\":{\"baseColorFactor\":[" +
                 number(double(color[0])) + "," + number(double(color[1])) + "," + number(double(color[2])) + "," +
                 number(double(color[3])) + "],\"metallicFactor\":" + number(double(metallic)) +
                 ",\"roughnessFactor\":" + number(double(roughness)) + "}}";
  }
  return "{\"asset\":{\"version\":\"2.0\",\"generator\":\"crumple export\",\"copyright\":" + quoted(animation.copyright) +
         "},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"name\":\"world\"," + upright +
         ",\"children\":[1]},{\"name\":" + quoted(animation.name) +
         ",\"mesh\":0}],\"meshes\":[{\"name\":" + quoted(animation.name) + ",\"primitives\":[" + primitives + "]" +
         (animation.shapes ? ",\"weights\":[" + weights + "]" : "") + "}],\"materials\":[" + materials +
         "],\"animations\":[{\"samplers\":[" + samplers + "],\"channels\":[" + channels + "]}],\"bufferViews\":[" +
         layout.views + "],\"accessors\":[" + layout.accessors +
         "],\"buffers\":[{\"byteLength\":" + std::to_string(layout.size) + "}]}";
}

template <class T>
void put(FileWriter& file, std::span<const T> values) {
  file.put(values.data(), values.size_bytes());
}

void put_words(FileWriter& file, std::initializer_list<uint32_t> words) { put(file, std::span(words.begin(), words.size())); }

}  // namespace

void write_glb(const std::string& path, const Animation& animation) {
  uint64_t size = 0;
  std::string json = describe(animation, size);
  json.resize((json.size() + 3) / 4 * 4, ' ');
  const uint64_t whole = 12 + 8 + json.size() + 8 + size;
  if (whole > UINT32_MAX)
    throw std::runtime_error(path + ": the file would have over 4 GiB, the most that GLB allows: lower --fps");
  FileWriter file(path);
  put_words(file, {0x46546c67, 2, uint32_t(whole), uint32_t(json.size()), 0x4e4f534a});  // "glTF", version; "JSON"
  file.put(json);
  put_words(file, {uint32_t(size), 0x004e4942});  // "BIN"
  put(file, animation.triangle);
  put(file, animation.vertex);
  for (size_t i = 0; i < animation.shapes; ++i) put<Vec3>(file, animation.displacement(i));
  std::vector<float> times, places, turns;
  for (const Animation::Key& key : animation.keys) {
    times.push_back(float(key.time));
    for (const double x : key.pose.position) places.push_back(float(x));
    const Eigen::Quaterniond turn = key.pose.orientation.normalized();
    for (const double x : turn.coeffs()) turns.push_back(float(x));  // x, y, z, w
  }
  for (const auto& values : {times, places, turns}) put<float>(file, values);
  std::vector<float> weights(animation.shapes);
  for (const Animation::Key& key : animation.keys) {
    std::fill(weights.begin(), weights.end(), 0.0f);
    if (key.shape > 0) weights[key.shape - 1] = 1;
    put<float>(file, weights);
  }
  file.finish();
}

}  // namespace crumple

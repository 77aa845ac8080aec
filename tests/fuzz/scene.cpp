// Fuzzes files that people write by hand: scenes for `crumple drive`, and regions and parts for `crumple bake`.
#include "cpp/scene.h"

#include <filesystem>
#include <stdexcept>

#include "bake/paint_regions.h"
#include "bake/parts.h"
#include "box_car.h"
#include "fuzz/entries.h"
#include "paths.h"
#include "wheeled_car.h"

namespace crumple::fuzz {
namespace {

// Reports the sentence without the file's name.
bool saw_refusal(const std::exception& refused, const MemoryFile& file) {
  const std::string_view sentence = refused.what();
  saw(sentence.substr(std::min(sentence.size(), file.path().size())));
  return false;
}

}  // namespace

bool scene_run(Input input) {
  const MemoryFile file(input);
  try {
    client::read_scene(file.path());
    return true;
  } catch (const std::runtime_error& refused) {
    return saw_refusal(refused, file);
  }
}

std::vector<std::vector<uint8_t>> scene_seeds() {
  std::vector<std::vector<uint8_t>> seeds;
  for (const auto& file : std::filesystem::directory_iterator(in_repository("clients/scenes")))
    seeds.push_back(bytes_of_file(file.path()));
  return seeds;
}

bool regions_run(Input input) {
  static const TetMesh mesh = box_mesh({4, 2, 2}).tets;
  const MemoryFile file(input);
  std::vector<std::string> report;
  try {
    const Regions regions = paint_regions(mesh, {}, read_regions(file.path()), "box", report);
    expect(regions.name.size() <= max_regions, "there are no more regions than a car may have");
    for (const uint8_t region : regions.tet_region) expect(region < regions.name.size(), "tets are of regions that are there");
    return true;
  } catch (const std::runtime_error& refused) {
    return saw_refusal(refused, file);
  }
}

std::vector<std::vector<uint8_t>> regions_seeds() {
  const std::string_view text =
      "{ regions: [ { name: \"cell\", anchored: true, box: { center: {x: 0, y: 0, z: 0.6}, half: {x: 1.2, y: 0.7, z: 0.5},\n"
      "  orientation: {x: 0, y: 0, z: 0, w: 1} } },\n"
      "  { name: \"engine\", sphere: { center: {x: 1.4, y: 0, z: 0.5}, radius: 0.9 } } ] }\n";
  return {{text.begin(), text.end()}};
}

bool parts_run(Input input) {
  static const ImportedSurface surface = [] {
    const Surface car = wheeled_box_surface();
    std::vector<Eigen::Vector3d> positions;
    for (const Vec3& vertex : car.vertex) positions.push_back(vertex.cast<double>());
    ImportedSurface out = place_surface(positions, {}, car.triangle, {}, "box");
    out.named = {{"body", 0, {"paint", "body", "car"}}, {"roof", 40, {"window", "roof", "car"}, true}};
    return out;
  }();
  const MemoryFile file(input);
  try {
    const Division division = divide_surface(surface, read_parts(file.path()), "box");
    expect(division.part.size() <= max_parts, "there are no more parts than a car may have");
    for (const uint8_t part : division.of_triangle)
      expect(part < division.part.size(), "triangles are of parts that are there");
    return true;
  } catch (const std::runtime_error& refused) {
    return saw_refusal(refused, file);
  }
}

std::vector<std::vector<uint8_t>> parts_seeds() {
  const std::string_view text =
      "{ parts: [ { name: \"glass\", kind: \"glass\", source: [\"window*\", \"*oo?\"] },\n"
      "  { name: \"wheel\", kind: \"wheel\", position: {x: 1.3, y: 1, z: 0.3}, orientation: {x: 0, y: 0, z: 0, w: 1},\n"
      "    radius: 0.3, width: 0.2 }, { name: \"camera\", kind: \"point\", position: {x: 0.2, y: 0, z: 1.2} } ] }\n";
  return {{text.begin(), text.end()}};
}

}  // namespace crumple::fuzz

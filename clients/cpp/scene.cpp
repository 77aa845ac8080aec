// The program contains the schema in binary form, so that it can read scenes wherever it runs.
#include "cpp/scene.h"

#include <flatbuffers/idl.h>

#include <cmath>
#include <stdexcept>

#include "io/files.h"

// SCENE_BFBS: schema/scene.fbs with what it includes, compiled by flatc.
asm(".pushsection .rodata\n.balign 8\nscene_schema:\n.incbin \"" SCENE_BFBS "\"\nscene_schema_end:\n.popsection");
extern "C" const uint8_t scene_schema[], scene_schema_end[];

namespace crumple::client {
namespace {

[[noreturn]] void refuse(const std::string& file, const std::string& why) { throw std::runtime_error(file + ": " + why); }

double length(const schema::Vec3& v) { return std::hypot(v.x(), v.y(), v.z()); }

void check(const std::string& file, const schema::SceneT& scene) {
  if (scene.hits.empty()) refuse(file, "hits is empty: give at least one hit");
  if (!(scene.rate >= 1 && scene.rate <= 1000)) refuse(file, "rate is not in [1, 1000] poses a second");
  if (!(scene.mass >= 0 && std::isfinite(scene.mass))) refuse(file, "mass is negative");
  for (size_t i = 0; i < scene.hits.size(); ++i) {
    const schema::HitT& hit = *scene.hits[i];
    const std::string which = "hit " + std::to_string(i + 1) + ": ";
    if (!(std::abs(length(*hit.direction) - 1) < 1e-3)) refuse(file, which + "direction is not of length 1");
    if (!(hit.seconds > 0 && hit.seconds <= 3600)) refuse(file, which + "seconds is not in (0, 3600]");
    if (!(hit.repair >= 0 && hit.repair <= 1)) refuse(file, which + "repair is not in [0, 1]");
    if (!(std::abs(hit.speed_kmh) <= 1800)) refuse(file, which + "speed_kmh is over 1800 (500 m/s)");
  }
}

template <class Table>
typename Table::NativeTableType parse(const std::string& file, const char* root) {
  const std::string text = read_file(file, text_limit, "give a file in the form of schema/scene.fbs");
  flatbuffers::Parser parser;
  if (!parser.Deserialize(scene_schema, static_cast<size_t>(scene_schema_end - scene_schema)) || !parser.SetRootType(root))
    refuse(file, "the schema inside this program is damaged: build it again");
  // The sentence of the parser begins with file and line.
  if (!parser.ParseJson(text.c_str(), file.c_str())) throw std::runtime_error(parser.error_ + " (its form: schema/scene.fbs)");
  typename Table::NativeTableType out;
  flatbuffers::GetRoot<Table>(parser.builder_.GetBufferPointer())->UnPackTo(&out);
  return out;
}

}  // namespace

schema::SceneT read_scene(const std::string& file) {
  auto scene = parse<schema::Scene>(file, "crumple.schema.Scene");
  check(file, scene);
  return scene;
}

schema::PresetT read_preset(const std::string& file) { return parse<schema::Preset>(file, "crumple.schema.Preset"); }

}  // namespace crumple::client

// The program contains the schema in binary form, so that it can read scenes wherever it runs.
#include "cpp/scene.h"

#include <flatbuffers/idl.h>

#include <cmath>
#include <set>
#include <stdexcept>

#include "io/files.h"
#include "protocol/key.h"

// SCENE_BFBS: schema/scene.fbs with what it includes, compiled by flatc.
asm(".pushsection .rodata\n.balign 8\nscene_schema:\n.incbin \"" SCENE_BFBS "\"\nscene_schema_end:\n.popsection");
extern "C" const uint8_t scene_schema[], scene_schema_end[];

namespace crumple::client {
namespace {

constexpr size_t cars_most = 64;  // a scene that one process can drive, and half of the largest island

[[noreturn]] void refuse(const std::string& file, const std::string& why) { throw std::runtime_error(file + ": " + why); }

double length(const schema::Vec3& v) { return std::hypot(v.x(), v.y(), v.z()); }

// of: names the car before each sentence, if there are several.
void check_car(const std::string& file, const std::string& of, const schema::SceneCarT& car) {
  if (car.hits.empty()) refuse(file, of + "hits is empty: give at least one hit");
  if (!(car.mass >= 0 && std::isfinite(car.mass))) refuse(file, of + "mass is negative");
  for (size_t i = 0; i < car.hits.size(); ++i) {
    const schema::HitT& hit = *car.hits[i];
    const std::string which = of + "hit " + std::to_string(i + 1) + ": ";
    if (!(std::abs(length(*hit.direction) - 1) < 1e-3)) refuse(file, which + "direction is not of length 1");
    if (!(hit.seconds > 0 && hit.seconds <= 3600)) refuse(file, which + "seconds is not in (0, 3600]");
    if (!(hit.repair >= 0 && hit.repair <= 1)) refuse(file, which + "repair is not in [0, 1]");
    if (!(std::abs(hit.speed_kmh) <= 1800)) refuse(file, which + "speed_kmh is over 1800 (500 m/s)");
  }
}

void check_cars(const std::string& file, const schema::SceneT& scene) {
  if (scene.cars.size() > cars_most)
    refuse(file, "there are over " + std::to_string(cars_most) + " cars: divide them among several files");
  std::set<std::string> ids;
  for (const auto& each : scene.cars) {
    const schema::SceneCarT& car = *each;
    if (!is_id(car.id)) refuse(file, "\"" + car.id + "\" is not an id of a car: use " + id_rule);
    const std::string of = "car " + car.id + ": ";
    if (!ids.insert(car.id).second) refuse(file, of + "another car has the same id");
    if (!car.host.empty() && !is_id(car.host)) refuse(file, of + "\"" + car.host + "\" is not an id of a host: use " + id_rule);
    check_car(file, of, car);
    if (car.hits.size() != scene.cars.front()->hits.size())
      refuse(file, of + "it has another number of hits than car " + scene.cars.front()->id +
                       ": each hit begins at once for all cars");
  }
}

// The only car of a scene becomes the one of a list, without an id.
void list_cars(const std::string& file, schema::SceneT& scene) {
  if (!(scene.rate >= 1 && scene.rate <= 1000)) refuse(file, "rate is not in [1, 1000] poses a second");
  if (!(scene.mass >= 0 && std::isfinite(scene.mass))) refuse(file, "mass is negative");
  if (!scene.cars.empty()) {
    if (!scene.hits.empty()) refuse(file, "it has hits and cars: give each car its own hits");
    return check_cars(file, scene);
  }
  auto only = std::make_unique<schema::SceneCarT>();
  only->hits = std::move(scene.hits);
  scene.hits.clear();
  check_car(file, "", *only);
  scene.cars.push_back(std::move(only));
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
  list_cars(file, scene);
  return scene;
}

schema::PresetT read_preset(const std::string& file) { return parse<schema::Preset>(file, "crumple.schema.Preset"); }

}  // namespace crumple::client

#include "protocol/parts.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <string_view>

namespace crumple {
namespace {

using schema::PartKind;

const char* read_part(const schema::Part& from, Part& part) {
  part.name = from.name()->str();
  part.kind = from.kind();
  part.position = {from.position()->x(), from.position()->y(), from.position()->z()};
  const schema::Quat& q = *from.orientation();
  part.orientation = {q.x(), q.y(), q.z(), q.w()};
  part.radius = from.radius();
  part.width = from.width();
  if (!is_part_name(part.name)) return "the name of a part is not 1 to 64 printable characters";
  if (part.kind > PartKind::MAX) return "a part is of no kind";
  for (const float x : part.position)
    if (!(std::abs(x) <= most_part_position)) return "a part is not within 50 m of the origin";
  const float norm = std::hypot(std::hypot(q.x(), q.y()), std::hypot(q.z(), q.w()));
  if (!(std::abs(norm - 1) < 1e-3f)) return "the orientation of a part is not a unit quaternion";
  const bool wheel = part.kind == PartKind::wheel;
  for (const float size : {part.radius, part.width})
    if (wheel ? !(size > 0 && size <= most_wheel_size) : size != 0) return "radius and width of a part are those of no wheel";
  return nullptr;
}

}  // namespace

bool is_part_name(std::string_view name) {
  return !name.empty() && name.size() <= part_name_limit &&
         std::all_of(name.begin(), name.end(), [](char c) { return c >= ' ' && c <= '~'; });
}

const char* read_parts(const schema::Car& car, Parts& parts) {
  const auto* list = car.part();
  const auto* of_vertex = car.vertex_part();
  const size_t count = list ? list->size() : 0, vertices = of_vertex ? of_vertex->size() : 0;
  if (count > max_parts) return "it has over 255 parts";
  if (vertices != (count ? car.vertex()->size() : 0)) return "its lists of parts do not have matching lengths";
  parts = {};
  if (count == 0) return nullptr;
  std::set<std::string_view> names;
  parts.part.resize(count);
  for (size_t i = 0; i < count; ++i) {
    Part& part = parts.part[i];
    if (const char* why = read_part(*list->Get(static_cast<flatbuffers::uoffset_t>(i)), part)) return why;
    if (!names.insert(part.name).second) return "two of its parts have one name";
  }
  if (parts.part[0].kind != PartKind::body) return "its first part is not the body";
  parts.of_vertex = {of_vertex->data(), vertices};
  for (const uint8_t part : parts.of_vertex)
    if (part >= count || parts.part[part].kind == PartKind::point) return "a vertex names a part that has no vertices";
  const auto& corner = *car.triangle();
  for (flatbuffers::uoffset_t i = 0; i < corner.size(); i += 3) {
    const uint8_t part = parts.of_vertex[corner.Get(i)];
    if (part != parts.of_vertex[corner.Get(i + 1)] || part != parts.of_vertex[corner.Get(i + 2)])
      return "a triangle belongs to two parts";
  }
  return nullptr;
}

const char* read_looks(const schema::Car& car, Looks& looks) {
  const auto* list = car.look();
  const auto* of_triangle = car.triangle_look();
  const size_t count = list ? list->size() : 0, triangles = of_triangle ? of_triangle->size() : 0;
  if (count > max_looks) return "it has over 255 looks";
  if (triangles != (count ? car.triangle()->size() / 3 : 0)) return "its lists of looks do not have matching lengths";
  looks = {};
  if (count == 0) return nullptr;
  for (const schema::Look* from : *list) {
    const schema::Color& color = *from->color();
    Look& look = looks.look.emplace_back();
    look = {
        from->name()->str(), {color.red(), color.green(), color.blue(), color.opacity()}, from->metallic(), from->roughness()};
    if (!is_part_name(look.name)) return "the name of a look is not 1 to 64 printable characters";
    const auto share = [](float x) { return x >= 0 && x <= 1; };
    if (!std::all_of(look.color.begin(), look.color.end(), share) || !share(look.metallic) || !share(look.roughness))
      return "a number of a look is not from 0 to 1";
  }
  looks.of_triangle = {of_triangle->data(), triangles};
  for (const uint8_t look : looks.of_triangle)
    if (look >= count && look != no_look) return "a triangle names a look that does not exist";
  return nullptr;
}

}  // namespace crumple

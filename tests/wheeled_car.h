// The box car of the tests with parts: four wheels in front of its sides, a roof of glass, and a point on the roof.
#pragma once

#include <cmath>
#include <numbers>

#include "bake/bake.h"
#include "box_car.h"

namespace crumple {

// A closed cylinder about y.
inline void add_cylinder(Surface& surface, const Vec3& hub, float radius, float width, int segments = 24) {
  const auto first = uint32_t(surface.vertex.size()), count = uint32_t(segments);
  for (float side : {-0.5f, 0.5f}) {
    surface.vertex.push_back(hub + Vec3(0, side * width, 0));
    for (int k = 0; k < segments; ++k) {
      const float turn = 2 * std::numbers::pi_v<float> * float(k) / float(segments);
      surface.vertex.push_back(hub + Vec3(radius * std::cos(turn), side * width, radius * std::sin(turn)));
    }
  }
  const uint32_t other = first + count + 1;
  for (uint32_t k = 0; k < count; ++k) {
    const uint32_t a = 1 + k, b = 1 + (k + 1) % count;
    for (const Triangle& t : {Triangle{first, first + a, first + b}, Triangle{other, other + b, other + a},
                              Triangle{first + a, other + a, other + b}, Triangle{first + a, other + b, first + b}})
      surface.triangle.push_back(t);
  }
}

inline constexpr float wheel_radius = 0.3f, wheel_width = 0.2f;
inline const std::array<Vec3, 4> wheel_hubs = {Vec3(1.3f, 1.0f, 0.3f), Vec3(1.3f, -1.0f, 0.3f), Vec3(-1.3f, 1.0f, 0.3f),
                                               Vec3(-1.3f, -1.0f, 0.3f)};

inline Surface box_surface_of(const BoxMesh& box) {
  Surface surface;
  for (uint32_t node : box.surface) surface.vertex.push_back(box.tets.node[node]);
  for (size_t i = 0; i < box.triangle.size(); i += 3)
    surface.triangle.push_back({box.triangle[i], box.triangle[i + 1], box.triangle[i + 2]});
  return surface;
}

// Without parts.
inline Surface wheeled_box_surface(BoxCells cells = {}) {
  Surface surface = box_surface_of(box_mesh(cells));
  for (const Vec3& hub : wheel_hubs) add_cylinder(surface, hub, wheel_radius, wheel_width);
  return surface;
}

inline BakeResult wheeled_box_car(BoxCells cells = {}) {
  const BoxMesh box = box_mesh(cells);
  Surface surface = box_surface_of(box);
  std::vector<uint8_t> part_of(surface.triangle.size(), 0);
  for (size_t t = 0; t < part_of.size(); ++t) {
    const Triangle& corner = surface.triangle[t];
    part_of[t] = std::all_of(corner.begin(), corner.end(), [&](uint32_t v) { return surface.vertex[v].z() > 1.49f; });
  }
  std::vector<Part> parts = {{.name = "body", .position = {0, 0, 0.75f}},
                             {.name = "glass", .kind = schema::PartKind::glass, .position = {0, 0, 1.5f}}};
  for (const Vec3& hub : wheel_hubs) {
    add_cylinder(surface, hub, wheel_radius, wheel_width);
    part_of.resize(surface.triangle.size(), uint8_t(parts.size()));
    parts.push_back({.name = "wheel " + std::to_string(parts.size() - 1),
                     .kind = schema::PartKind::wheel,
                     .position = {hub.x(), hub.y(), hub.z()},
                     .radius = wheel_radius,
                     .width = wheel_width});
  }
  parts.push_back({.name = "lamp", .kind = schema::PartKind::point, .position = {1.5f, 0, 1.5f}});
  split_at_parts(surface, part_of);
  BakeOptions options;
  options.input = "wheeled box";
  options.attribution = "made by the tests";
  return assemble_car(std::move(surface), box.tets, options, {}, parts);
}

}  // namespace crumple

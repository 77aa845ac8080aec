#include "sim/obstacle.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace crumple {
namespace {

float middle_of(const Vec3& v) { return std::max(std::min(v.x(), v.y()), std::min(std::max(v.x(), v.y()), v.z())); }

}  // namespace

void make_box(const Vec3& half_extents, Obstacle& obstacle) {
  obstacle.faces.clear();
  for (int axis = 0; axis < 3; ++axis) {
    for (float side : {1.0f, -1.0f}) {
      obstacle.faces.push_back({side * Vec3::Unit(axis), half_extents[axis]});
    }
  }
  obstacle.reach = half_extents.norm();
  obstacle.width = 2 * middle_of(half_extents);
}

void make_sphere(float radius, Obstacle& obstacle) { make_capsule(radius, 0, obstacle); }

void make_capsule(float radius, float half_length, Obstacle& obstacle) {
  obstacle.faces.clear();
  obstacle.radius = radius;
  obstacle.half_length = half_length;
  obstacle.reach = radius + half_length;
  obstacle.width = 2 * radius;
}

void make_half_space(Obstacle& obstacle) {
  obstacle.faces.assign(1, {Vec3::UnitZ(), 0});
  obstacle.reach = obstacle.width = std::numeric_limits<float>::infinity();
}

std::optional<std::string> make_hull(std::span<const Vec3> points, Obstacle& obstacle) {
  const int count = int(points.size());
  if (count < 4 || count > hull_point_limit) {
    return "a hull has " + std::to_string(count) + " points; 4 to " + std::to_string(hull_point_limit) + " are allowed";
  }
  float reach = 0;
  Vec3 low = points[0], high = points[0];
  for (const Vec3& point : points) {
    reach = std::max(reach, point.norm());
    low = low.cwiseMin(point);
    high = high.cwiseMax(point);
  }
  const float tolerance = 1e-5f * reach;
  std::vector<Plane> faces;
  const auto add_face = [&](Vec3 normal, const Vec3& through) {
    const float offset = normal.dot(through);
    for (const Vec3& point : points) {
      if (normal.dot(point) > offset + tolerance) return;
    }
    for (const Plane& face : faces) {
      if (face.normal.dot(normal) > 1 - 1e-6f) return;
    }
    faces.push_back({normal, offset});
  };
  for (int a = 0; a < count; ++a) {
    for (int b = a + 1; b < count; ++b) {
      for (int c = b + 1; c < count; ++c) {
        const Vec3 normal = (points[b] - points[a]).cross(points[c] - points[a]);
        const float area = normal.norm();
        if (area < tolerance * tolerance) continue;
        add_face(normal / area, points[a]);
        add_face(-normal / area, points[a]);
      }
    }
  }
  // Flat or collinear points give two opposite faces through all of them, or none.
  float thickness = 0;
  if (!faces.empty()) {
    for (const Vec3& point : points) thickness = std::max(thickness, faces[0].offset - faces[0].normal.dot(point));
  }
  if (faces.size() < 4 || thickness < 1e-3f) return std::string("the points of a hull span no volume (under 1 mm thick)");
  obstacle.faces = std::move(faces);
  obstacle.reach = reach;
  obstacle.width = middle_of(high - low);
  return std::nullopt;
}

Plane separating_plane(const Obstacle& obstacle, const Vec3& point) {
  if (obstacle.faces.empty()) {
    const Vec3 centre(0, 0, std::clamp(point.z(), -obstacle.half_length, obstacle.half_length));
    const Vec3 offset = point - centre;
    const float distance = offset.norm();
    const Vec3 normal = distance > 1e-6f ? Vec3(offset / distance) : Vec3::UnitX();
    return {normal, normal.dot(centre) + obstacle.radius};
  }
  const Plane* best = &obstacle.faces[0];
  float highest = best->normal.dot(point) - best->offset;
  for (const Plane& face : obstacle.faces) {
    const float height = face.normal.dot(point) - face.offset;
    if (height > highest) {
      highest = height;
      best = &face;
    }
  }
  return *best;
}

}  // namespace crumple

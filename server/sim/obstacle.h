// Rigid convex obstacles. Inside, every shape is one of two kinds: an intersection of half-spaces (box, half-space, hull) or
// a segment with a radius (sphere, capsule). Both answer the one question that contacts ask: which plane separates this
// point from the obstacle?
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "sim/math.h"

namespace crumple {

inline constexpr int hull_point_limit = 32;  // the faces of a hull are found by trying every three points

// normal . x <= offset is solid; the unit normal points out.
struct Plane {
  Vec3 normal;
  float offset;
};

struct Obstacle {
  // Local frame. Faces, or (if empty) a segment along z of this half length and radius.
  std::vector<Plane> faces;
  float half_length = 0;
  float radius = 0;
  // Bounding sphere about the local origin, m; infinite for a half-space.
  float reach = 0;
  // Across the longest side, m: nodes that are farther apart pass it on either side. Infinite for a half-space.
  float width = 0;
  float friction = 0.3f;                                       // Coulomb
  Pose pose;                                                   // at the start of the tick
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();          // of pose.position, m/s, world
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  // rad/s, world
};

// Sizes in m, local frame.
void make_box(const Vec3& half_extents, Obstacle&);
void make_sphere(float radius, Obstacle&);
void make_capsule(float radius, float half_length, Obstacle&);
void make_half_space(Obstacle&);  // solid at local z <= 0
// At least four points that span a volume, at most hull_point_limit; otherwise a sentence, and the obstacle is untouched.
[[nodiscard]] std::optional<std::string> make_hull(std::span<const Vec3> points, Obstacle&);

// The plane that touches the obstacle and is farthest below the point: where the point is outside it separates the two,
// where it is inside it is the nearest way out. Local frame; signed distance = normal . point - offset.
Plane separating_plane(const Obstacle&, const Vec3& point);

}  // namespace crumple

// Rigid convex obstacles. Internally a shape is either an intersection of half-spaces (box, half-space, hull) or a segment with
// a radius (sphere, capsule). Contacts ask both kinds one question: which plane separates this point from the obstacle?
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "sim/math.h"

namespace crumple {

inline constexpr int hull_point_limit = 32;  // make_hull() tries every three points as a face

// normal . x <= offset is solid; the unit normal points out.
struct Plane {
  Vec3 normal;
  float offset;
};

struct Obstacle {
  // Local frame. The shape is its faces or, if there are none, a segment along z with this half length and radius.
  std::vector<Plane> faces;
  float half_length = 0;
  float radius = 0;
  // Bounding sphere about the local origin, m; infinite for a half-space.
  float reach = 0;
  // Second longest side, m: nodes farther apart than this may pass the obstacle on both sides. Infinite for a half-space.
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
// Needs at least four points that span a volume, and at most hull_point_limit. Otherwise returns a sentence and leaves the
// obstacle as it was.
[[nodiscard]] std::optional<std::string> make_hull(std::span<const Vec3> points, Obstacle&);

// The face plane for which normal . point - offset is largest, local frame. If the point is outside, the plane separates it
// from the obstacle; if it is inside, the plane is the nearest way out. normal . point - offset is the signed distance.
Plane separating_plane(const Obstacle&, const Vec3& point);

}  // namespace crumple

#include "fit/crash_test.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>

namespace crumple {
namespace {

using Eigen::Vector3d;

constexpr double gap = 0.001;        // m between car and obstacle at the start
constexpr double inward = 0.01;      // m, steps in which a station beside the front looks for it
constexpr double outer_share = 0.9;  // of a car's width that is front rather than round corner
constexpr int heights = 3;           // at which the gauge looks, from bumper_low to bumper_high

// Where a line along x through (y, z) meets a triangle: the weights of its corners; nothing if it does not.
std::optional<Vector3d> meet(const Vec3& a, const Vec3& b, const Vec3& c, double y, double z) {
  const auto side = [&](const Vec3& p, const Vec3& q) {
    return (double(q.y()) - double(p.y())) * (z - double(p.z())) - (double(q.z()) - double(p.z())) * (y - double(p.y()));
  };
  const Vector3d weight(side(b, c), side(c, a), side(a, b));
  const double sum = weight.sum();
  if (sum == 0 || (weight / sum).minCoeff() < 0) return std::nullopt;
  return weight / sum;
}

// How far the nearest node is from the obstacle at least, m; negative inside.
double clearance(const DeformableState& body, const Obstacle& obstacle) {
  double least = std::numeric_limits<double>::infinity();
  const auto turn = obstacle.pose.orientation.conjugate();
  for (const Vec3& node : body.node) {
    const Vec3 local = (turn * (node.cast<double>() - obstacle.pose.position)).cast<float>();
    const Plane plane = separating_plane(obstacle, local);
    least = std::min(least, double(plane.normal.dot(local) - plane.offset));
  }
  return least;
}

// Moves the obstacle along `direction` from far ahead to where it all but touches the body.
void approach(const DeformableState& body, const Vector3d& direction, Obstacle& obstacle) {
  obstacle.pose.position += 20 * direction;
  for (int k = 0; k < 1000; ++k) {
    const double away = clearance(body, obstacle);
    if (away < 1.5 * gap) return;
    obstacle.pose.position -= std::max(away - gap, 1e-4) * direction;
    if (obstacle.pose.position.norm() > 100) break;
  }
  throw std::runtime_error("the car's way does not lead to the obstacle; give another direction or place.");
}

}  // namespace

Obstacle rigid_wall() {
  Obstacle wall;
  make_box({0.5f, 5, 5}, wall);
  return wall;
}

Obstacle rigid_pole(double diameter) {
  Obstacle pole;
  make_capsule(float(diameter / 2), 4, pole);
  return pole;
}

Obstacle offset_wall(double overlap, double width, double edge_radius) {
  // A hull of two boxes' corners: the face spans y from the edge to far beyond the car's left side; the edge is a quarter of a
  // circle, in eight straight pieces.
  constexpr int pieces = 8;
  const double edge = width / 2 - overlap * width, far = edge + 4;
  std::vector<Vec3> point;
  for (const double z : {-3.0, 3.0}) {
    point.emplace_back(0.f, float(far), float(z));
    point.emplace_back(1.f, float(far), float(z));
    point.emplace_back(1.f, float(edge), float(z));
    for (int k = 0; k <= pieces; ++k) {
      const double angle = 0.5 * M_PI * k / pieces;
      point.emplace_back(float(edge_radius * (1 - std::sin(angle))), float(edge + edge_radius * (1 - std::cos(angle))),
                         float(z));
    }
  }
  Obstacle wall;
  if (const auto refused = make_hull(point, wall)) throw std::runtime_error("offset wall: " + *refused);
  return wall;
}

double mean_crush(const Profile& c) { return (c[0] / 2 + c[1] + c[2] + c[3] + c[4] + c[5] / 2) / 5; }

double FrontGauge::Mark::at(std::span<const Vec3> nodes) const {
  double x = 0;
  for (size_t k = 0; k < 3; ++k) x += weight[k] * double(nodes[node[k]].x());
  return x;
}

FrontGauge::FrontGauge(const Car& car, double damaged_width) {
  const auto nodes = car.model.node;
  double ground = 1e9, left = -1e9, right = 1e9;
  for (const Vec3& vertex : car.model.vertex) {
    ground = std::min(ground, double(vertex.z()));
    left = std::max(left, double(vertex.y())), right = std::min(right, double(vertex.y()));
  }
  const double whole = outer_share * (left - right), width = damaged_width > 0 ? std::min(damaged_width, whole) : whole;
  // The foremost point of the front on the line along x through (y, z).
  const auto foremost = [&](double y, double z) {
    std::optional<Mark> found;
    for (const auto& [a, b, c] : car.boundary.triangle) {
      const auto weight = meet(nodes[a], nodes[b], nodes[c], y, z);
      if (!weight) continue;
      const Mark mark{{a, b, c}, {(*weight)[0], (*weight)[1], (*weight)[2]}};
      if (!found || mark.at(nodes) > found->at(nodes)) found = mark;
    }
    return found;
  };
  for (size_t k = 0; k < marks_.size(); ++k) {
    // A station beside the car's round corner moves inward.
    for (double y = width * (0.5 - double(k) / 5); marks_[k].empty() && std::fabs(y) > inward; y -= std::copysign(inward, y)) {
      for (int i = 0; i < heights; ++i) {
        const auto mark = foremost(y, ground + bumper_low + (bumper_high - bumper_low) * i / (heights - 1));
        if (mark) marks_[k].push_back(*mark);
      }
    }
    if (marks_[k].empty())
      throw std::runtime_error(
          car.name +
          ": it has no front 0.41 to 0.51 m above its lowest point, where bumpers are; bake it in metres, with x forward and z "
          "up.");
  }
  rest_ = depth(nodes);  // of rest_ that is 0
  for (double& each : rest_) each = -each;
}

Profile FrontGauge::depth(std::span<const Vec3> nodes) const {
  Profile out = rest_;
  for (size_t k = 0; k < out.size(); ++k) {
    for (const Mark& mark : marks_[k]) out[k] -= mark.at(nodes) / double(marks_[k].size());
  }
  return out;
}

std::vector<double> HitResult::force_by_sixtieth() const {
  std::vector<double> sum;
  double before = 0;
  for (const Instant& each : pulse) {
    const double seconds = each.seconds - before;
    if (seconds > 0) {
      const auto slot = size_t(60 * (before + 0.5 * seconds));
      if (slot >= sum.size()) sum.resize(slot + 1);
      sum[slot] += 60 * seconds * each.force;
    }
    before = each.seconds;
  }
  return sum;
}

CrashTest::CrashTest(std::shared_ptr<const Car> car, const Parameters& parameters, double damaged_width)
    : mass{double(car->model.mass), car->model.inertia.cast<double>(), car->model.center_of_mass.cast<double>(), true},
      car_(std::move(car)),
      parameters_(parameters),
      gauge_(*car_, damaged_width),
      body_(make_body(car_->model)),
      scratch_(make_scratch()) {}

HitResult CrashTest::hit(Obstacle obstacle, const Vector3d& velocity, double rate, double seconds) {
  HitResult out;
  const double speed = velocity.norm();
  const Vector3d direction = velocity / speed;
  approach(body_, direction, obstacle);
  Motion motion;
  motion.velocity = velocity;
  const auto energy = [&] { return kinetic_energy(motion, mass) + body_.absorbed + body_.stored; };
  const double brought = energy(), start = direction.dot(motion.pose.position + motion.pose.orientation * mass.center);
  out.pulse.push_back({0, 0, 0, speed});
  // It starts the gap's time before contact, so that time 0 is the contact.
  double now = -gap / speed, contact = -1;
  for (int k = 0; k < int(std::lround(seconds * rate)); ++k) {
    const double before = direction.dot(motion.velocity);
    const StepResult result = deform({car_->model, parameters_, mass, {&obstacle, 1}, 1 / rate}, *scratch_, body_, motion);
    now += 1 / rate;
    const double after = direction.dot(motion.velocity);
    const double way = direction.dot(motion.pose.position + motion.pose.orientation * mass.center) - start - gap;
    out.travel = std::max(out.travel, way);
    if (contact < 0 && before > 0 && after <= 0) contact = now - 1 / rate * (0 - after) / (before - after);
    out.pulse.push_back({now, -direction.dot(result.impulse) / mass.mass * rate, way, after});
    if (contact >= 0 && result.contacts == 0 && body_.settled) break;
  }
  out.rest = contact;
  out.depth = gauge_.depth(body_.node);
  out.crush = mean_crush(out.depth);
  out.restitution = -direction.dot(motion.velocity) / speed;
  out.energy = energy() / brought;
  for (size_t i = 0; i < body_.node.size(); ++i)
    out.deepest = std::max(out.deepest, double((body_.node[i] - car_->model.node[i]).norm()));
  out.change = motion.velocity - velocity;
  out.yaw_rate = motion.angular_velocity.z();
  return out;
}

}  // namespace crumple

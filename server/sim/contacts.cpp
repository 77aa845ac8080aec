#include "sim/contacts.h"

#include <algorithm>
#include <optional>

namespace crumple {

Relative relative(const Pose& car, const Pose& obstacle) {
  const Eigen::Quaterniond back = obstacle.orientation.conjugate();
  return {(back * car.orientation).toRotationMatrix().cast<float>(), (back * (car.position - obstacle.position)).cast<float>()};
}

namespace {

// In encounter(): distance between two tests, m (less than half a car's length), and the most tests.
constexpr float look_travel = 1, most_looks = 32;

// A car and an obstacle that may meet: the transform at the start of the tick, how far any point of the car moves relative to
// the obstacle, and the distance below which a node is a candidate.
struct Approach {
  Relative start;
  float travel, near;
};

// Whether the body's box is farther than `near` from the obstacle: one of the obstacle's planes has the whole box outside.
bool beyond(const Obstacle& obstacle, const Relative& start, const DeformableState& body, float near) {
  const Vec3 half = 0.5f * (body.high - body.low);
  const Vec3 centre = start.rotation * (body.low + half) + start.translation;
  const auto beyond_plane = [&](const Plane& plane) {
    const Vec3 normal = start.rotation.transpose() * plane.normal;
    return plane.normal.dot(centre) - plane.offset - normal.cwiseAbs().dot(half) > near;
  };
  if (obstacle.faces.empty()) return beyond_plane(separating_plane(obstacle, centre));
  return std::any_of(obstacle.faces.begin(), obstacle.faces.end(), beyond_plane);
}

// `travel` is the farthest that a point of the rigid car moves relative to the obstacle, rotation included. It counts twice,
// because an obstacle may also drive nodes as far in the car's frame.
template <class Metres>
Metres candidate_distance(Metres travel) {
  return 2 * travel + Metres(contact_margin);
}

// Cheap bounding-sphere test that rejects far obstacles; computed once per car.
class Reach {
 public:
  Reach(const StepInput& input, const DeformableState& body, const Motion& motion)
      : centre_(motion.pose.position + motion.pose.orientation * input.model.center_of_mass.cast<double>()),
        velocity_(motion.velocity),
        speed_(motion.velocity.norm()),
        turning_(motion.angular_velocity.norm() *
                 (3 * double(body.reach) + (input.mass.center - input.model.center_of_mass.cast<double>()).norm())),
        own_(double(body.reach) + 1e-3),
        seconds_(input.seconds) {}
  // travel: least travel to assume, m.
  bool excludes(const Obstacle& obstacle, double travel = 0) const {
    if (!obstacle.angular_velocity.isZero(0)) return false;  // relative to it, the car moves the faster the farther away it is
    const double speed = obstacle.velocity.isZero(0) ? speed_ : (velocity_ - obstacle.velocity).norm();
    const double far = own_ + double(obstacle.reach) + candidate_distance(std::max(travel, (speed + turning_) * seconds_));
    return (centre_ - obstacle.pose.position).squaredNorm() > far * far;
  }

 private:
  Eigen::Vector3d centre_, velocity_;
  double speed_, turning_, own_, seconds_;
};

std::optional<Approach> approach(const StepInput& input, const DeformableState& body, const Motion& motion,
                                 const Obstacle& obstacle, float least = 0) {
  const Relative start = relative(motion.pose, obstacle.pose);
  const Relative end = relative(advance(motion, input.mass, input.seconds),
                                advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, input.seconds));
  const Mat3 turn = end.rotation - start.rotation;
  const float travel =
      (turn * input.model.center_of_mass + end.translation - start.translation).norm() + turn.norm() * body.reach;
  const float near = candidate_distance(std::max(travel, least));
  if (beyond(obstacle, start, body, near)) return std::nullopt;
  return Approach{start, travel, near};
}

bool is_near(const Obstacle& obstacle, const Approach& approach, const Vec3& node) {
  const Vec3 local = approach.start.rotation * node + approach.start.translation;
  const Plane face = separating_plane(obstacle, local);
  return face.normal.dot(local) - face.offset < approach.near;
}

}  // namespace

Encounter encounter(const StepInput& input, const DeformableState& body, const Motion& motion) {
  const Reach reach(input, body, motion);
  const auto meets = [&](const Obstacle& obstacle, float travel) {
    if (travel < contact_margin) return false;
    const int looks = int(std::min(most_looks, 1 + travel / look_travel));
    for (int k = 1; k <= looks; ++k) {
      const double time = input.seconds * k / looks;
      const Pose there = advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, time);
      if (!beyond(obstacle, relative(advance(motion, input.mass, time), there), body, 0)) return true;
    }
    return false;
  };
  Encounter out;
  for (const Obstacle& obstacle : input.obstacles) {
    if (reach.excludes(obstacle)) continue;
    const auto found = approach(input, body, motion, obstacle);
    const auto near = [&](const Vec3& node) { return is_near(obstacle, *found, node); };
    if (!found || std::none_of(body.node.begin(), body.node.end(), near)) continue;
    out.near = true;
    out.width = std::min(out.width, obstacle.width);
    out.hit = out.hit || meets(obstacle, found->travel);
  }
  return out;
}

void find_candidates(const StepInput& input, const DeformableState& body, const Motion& motion, ContactSet& contacts,
                     float travel) {
  const std::span<const Obstacle> obstacles = input.obstacles;
  std::vector<Candidates>& out = contacts.candidate;
  out.clear();
  const Reach reach(input, body, motion);
  if (travel == 0) travel = -1;
  for (const Obstacle& obstacle : input.obstacles) {
    if (reach.excludes(obstacle)) continue;
    if (const auto found = approach(input, body, motion, obstacle)) travel = std::max(travel, found->travel);
  }
  if (travel < 0) return;
  for (uint32_t index = 0; index < obstacles.size(); ++index) {
    if (reach.excludes(obstacles[index], double(travel))) continue;
    const auto found = approach(input, body, motion, obstacles[index], travel);
    if (!found) continue;
    Candidates candidates{index, {}};
    for (uint32_t node = 0; node < body.node.size(); ++node) {
      if (is_near(obstacles[index], *found, body.node[node])) candidates.node.push_back(node);
    }
    if (!candidates.node.empty()) out.push_back(std::move(candidates));
  }
}

bool find_contacts(const DeformableState& body, std::span<const Obstacle> obstacles, const FramePath& frame,
                   ContactSet& contacts) {
  std::vector<Contact>& out = contacts.contact;
  out.clear();
  for (const Candidates& near : contacts.candidate) {
    const Obstacle& obstacle = obstacles[near.obstacle];
    const auto at = [&](double time) { return advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, time); };
    const Relative first = relative(frame.from, at(frame.start));
    const Relative last = relative(frame.to, at(frame.start + frame.seconds));
    const Mat3 back = last.rotation.transpose();
    for (uint32_t node : near.node) {
      const Vec3 local = first.rotation * body.node[node] + first.translation;
      const Plane plane = separating_plane(obstacle, local);
      Contact contact{node,
                      near.obstacle,
                      back * plane.normal,
                      plane.offset - plane.normal.dot(last.translation),
                      0,
                      0,
                      back * (local - last.translation),
                      obstacle.friction};
      contact.before = plane.normal.dot(local) - plane.offset;
      contact.after = contact.normal.dot(body.node[node]) - contact.offset;
      if (contact.after > contact_margin) continue;
      if (contact.before < 0) contact.offset -= std::max(0.0f, -contact.before - push_out_speed * float(frame.seconds));
      out.push_back(contact);
    }
  }
  std::stable_sort(out.begin(), out.end(),
                   [](const Contact& a, const Contact& b) { return a.node != b.node ? a.node < b.node : a.after < b.after; });
  // Keep the deepest of each node.
  bool all = true;
  size_t kept = 0, run = 0;
  for (size_t i = 0; i < out.size(); ++i) {
    run = i > 0 && kept > 0 && out[kept - 1].node == out[i].node ? run + 1 : 0;
    if (run < contacts_per_node) {
      out[kept++] = out[i];
    } else {
      all = false;
    }
  }
  out.resize(kept);
  return all;
}

void index_contacts(size_t nodes, ContactSet& contacts) {
  contacts.first.assign(nodes, 0);
  for (size_t k = contacts.contact.size(); k-- > 0;) contacts.first[contacts.contact[k].node] = uint32_t(k + 1);
}

}  // namespace crumple

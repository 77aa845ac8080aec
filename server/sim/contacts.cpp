#include "sim/contacts.h"

#include <algorithm>

namespace crumple {

Relative relative(const Pose& car, const Pose& obstacle) {
  const Eigen::Quaterniond back = obstacle.orientation.conjugate();
  return {(back * car.orientation).toRotationMatrix().cast<float>(), (back * (car.position - obstacle.position)).cast<float>()};
}

void find_candidates(const Model& model, const Body& body, const Motion& motion, const Mass& mass,
                     std::span<const Obstacle> obstacles, double seconds, std::vector<Candidates>& out) {
  out.clear();
  const Pose car_end = advance(motion, mass, seconds);
  for (uint32_t index = 0; index < obstacles.size(); ++index) {
    const Obstacle& obstacle = obstacles[index];
    const Relative start = relative(motion.pose, obstacle.pose);
    const Relative end = relative(car_end, advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, seconds));
    // No point of the car moves farther against the obstacle than this, rotation included. Twice: nodes move in the car's
    // frame too, as far as the obstacle drives them.
    const Mat3 turn = end.rotation - start.rotation;
    const Vec3 centre = start.rotation * model.center_of_mass + start.translation;
    const float travel = (turn * model.center_of_mass + end.translation - start.translation).norm() + turn.norm() * body.reach;
    const float near = 2 * travel + contact_margin;
    const Plane plane = separating_plane(obstacle, centre);
    if (plane.normal.dot(centre) - plane.offset > body.reach + near) continue;

    Candidates candidates{index, {}};
    for (uint32_t node = 0; node < body.node.size(); ++node) {
      const Vec3 local = start.rotation * body.node[node] + start.translation;
      const Plane face = separating_plane(obstacle, local);
      if (face.normal.dot(local) - face.offset < near) candidates.node.push_back(node);
    }
    if (!candidates.node.empty()) out.push_back(std::move(candidates));
  }
}

bool find_contacts(const Body& body, std::span<const Obstacle> obstacles, std::span<const Candidates> candidates,
                   const Pose& from, const Pose& to, double start, double h, std::vector<Contact>& out) {
  out.clear();
  for (const Candidates& near : candidates) {
    const Obstacle& obstacle = obstacles[near.obstacle];
    const Relative first = relative(from, advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, start));
    const Relative last = relative(to, advance(obstacle.pose, obstacle.velocity, obstacle.angular_velocity, start + h));
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
      if (contact.before < 0) contact.offset -= std::max(0.0f, -contact.before - push_out_speed * float(h));
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

}  // namespace crumple

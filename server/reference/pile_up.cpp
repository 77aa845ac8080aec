#include "reference/pile_up.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "car/nearest.h"

namespace crumple {

using Eigen::Vector3d;

double CrashCar::nose_crush() const {
  const auto rest = car->model.node;
  float front = -1e9f;
  for (const Vec3& node : rest) front = std::max(front, node.x());
  double sum = 0;
  int count = 0;
  for (size_t i = 0; i < rest.size(); ++i) {
    if (rest[i].x() < front - 0.15f) continue;
    sum += double(rest[i].x() - body.node[i].x());
    ++count;
  }
  return sum / count;
}

double CrashCar::largest_displacement() const {
  float most = 0;
  for (size_t i = 0; i < body.node.size(); ++i) most = std::max(most, (body.node[i] - car->model.node[i]).norm());
  return double(most);
}

CrashCar& PileUp::add(std::shared_ptr<const Car> car, double x, double y, double heading, double speed) {
  CrashCar one;
  one.car = std::move(car);
  const Model& model = one.car->model;
  one.mass = {double(model.mass), model.inertia.cast<double>(), model.center_of_mass.cast<double>(), true};
  one.body = make_body(model);
  one.scratch = make_scratch();
  one.motion.pose.orientation = Eigen::AngleAxisd(heading, Vector3d::UnitZ());
  one.motion.pose.position = Vector3d(x, y, 0) - one.motion.pose.orientation * one.mass.center;
  one.motion.pose.position.z() = 0;
  one.motion.velocity = one.motion.pose.orientation * Vector3d(speed, 0, 0);
  return cars.emplace_back(std::move(one));
}

void PileUp::tick(double seconds) {
  std::vector<Member> island;
  island.reserve(cars.size());
  for (size_t k = 0; k < cars.size(); ++k) {
    CrashCar& car = cars[k];
    car.motion.velocity += seconds * car.pull;
    island.push_back({{car.car->model, car.parameters, car.mass, obstacles, seconds, car.pull},
                      k + 1,
                      *car.scratch,
                      {car.body, car.motion}});
  }
  deform(island);
  for (size_t k = 0; k < cars.size(); ++k) {
    CrashCar& car = cars[k];
    car.last = island[k].state.result;
    car.impulse += car.last.impulse;
    car.peak = std::max(car.peak, car.last.impulse.norm() / seconds);
    car.sweeps += car.last.sweeps;
    car.substeps += car.last.substeps;
  }
  for (Obstacle& each : obstacles) each.pose = advance(each.pose, each.velocity, each.angular_velocity, seconds);
}

void PileUp::run(double seconds, double rate) {
  for (int k = 0; k < int(std::lround(seconds * rate)); ++k) tick(1 / rate);
}

Vector3d PileUp::momentum() const {
  Vector3d sum = Vector3d::Zero();
  for (const CrashCar& car : cars) sum += car.mass.mass * car.motion.velocity;
  return sum;
}

Vector3d PileUp::angular_momentum() const {
  Vector3d sum = Vector3d::Zero();
  for (const CrashCar& car : cars) {
    const Pose& pose = car.motion.pose;
    const Vector3d center = pose.position + pose.orientation * car.mass.center;
    const Vector3d spin = pose.orientation.conjugate() * car.motion.angular_velocity;
    sum += center.cross(car.mass.mass * car.motion.velocity) + pose.orientation * spin.cwiseProduct(car.mass.inertia);
  }
  return sum;
}

double PileUp::kinetic() const {
  double sum = 0;
  for (const CrashCar& car : cars) sum += kinetic_energy(car.motion, car.mass);
  return sum;
}

double PileUp::energy() const {
  double sum = kinetic();
  for (const CrashCar& car : cars) sum += car.body.absorbed + car.body.stored;
  return sum;
}

Overlap measure_overlap(const CrashCar& inner, const CrashCar& outer) {
  const Relative path = relative(inner.motion.pose, outer.motion.pose);
  const Boundary &own = inner.car->boundary, &faces = outer.car->boundary;
  const std::vector<Vec3>&node = inner.body.node, &corner = outer.body.node;
  const auto in_frame = [&](const Vec3& p) { return Vec3(path.rotation * p + path.translation); };
  const auto depth = [&](const Vec3& p) {
    if ((p.array() < outer.body.low.array()).any() || (p.array() > outer.body.high.array()).any()) return 0.0;
    double angle = 0, nearest = 1e9;
    for (const auto& t : faces.triangle) {
      const Vector3d a = (corner[t[0]] - p).cast<double>(), b = (corner[t[1]] - p).cast<double>(),
                     c = (corner[t[2]] - p).cast<double>();
      const double la = a.norm(), lb = b.norm(), lc = c.norm();
      angle += 2 * std::atan2(a.dot(b.cross(c)), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb);
      nearest = std::min(nearest, squared_distance_to_triangle(Vector3d::Zero(), a, b, c));
    }
    return angle > 2 * 3.14159265 ? std::sqrt(nearest) : 0.0;  // winding number above a half: inside
  };
  Overlap out;
  for (uint32_t i : own.node) {
    const double deep = depth(in_frame(node[i]));
    out.nodes += deep > 0;
    out.node = std::max(out.node, deep);
  }
  out.any = out.node;
  for (const auto& t : own.triangle) {
    out.any = std::max(out.any, depth(in_frame((node[t[0]] + node[t[1]] + node[t[2]]) / 3)));
    for (size_t k = 0; k < 3; ++k) {
      if (t[k] < t[(k + 1) % 3]) out.any = std::max(out.any, depth(in_frame(0.5f * (node[t[k]] + node[t[(k + 1) % 3]]))));
    }
  }
  return out;
}

PileUp random_crash(const std::shared_ptr<const Car>& car, uint32_t seed) {
  std::mt19937 generator(seed);
  const auto uniform = [&](double low, double high) { return low + (high - low) * double(generator()) / 4294967296.0; };
  const auto factor = [&](double low, double high) { return std::exp(uniform(std::log(low), std::log(high))); };
  PileUp scene;
  scene.cars.reserve(2);
  const double direction = uniform(-M_PI, M_PI), aside = uniform(-2.2, 2.2);
  const Vector3d away(std::cos(direction), std::sin(direction), 0), side(-away.y(), away.x(), 0);
  Vector3d place = uniform(3, 5.5) * away + aside * side;
  CrashCar& first = scene.add(car, 0, 0, uniform(-M_PI, M_PI), 0);
  CrashCar& second = scene.add(car, place.x(), place.y(), uniform(-M_PI, M_PI), 0);
  const auto overlap = [&] { return measure_overlap(first, second).any > 0 || measure_overlap(second, first).any > 0; };
  while (overlap()) second.motion.pose.position += 0.15 * away;
  first.motion.velocity = uniform(2, 30) * away;
  second.motion.velocity = -uniform(2, 30) * away;
  for (CrashCar& each : scene.cars) {
    const double stiffness = factor(0.5, 3), mass = factor(0.1, 10), friction = uniform(0, 0.8);
    for (Material& material : each.parameters.region) {
      material.young_modulus *= float(stiffness);
      material.friction = float(friction);
    }
    each.mass.mass *= mass;
    each.mass.inertia *= mass;
    if (seed % 4 == 3) each.motion.angular_velocity.z() = uniform(-5, 5);
  }
  return scene;
}

}  // namespace crumple

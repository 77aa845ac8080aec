#include "wire/decode.h"

#include <algorithm>
#include <cmath>

#include "wire/check.h"
#include "wire/state_fields.h"

namespace crumple {
namespace {

// Most triples of points over all hulls of one message. Trying a triple takes up to 80 ns, so these take 5 ms: 12 hulls of 32
// points, or a thousand of 8.
constexpr uint64_t hull_threes_limit = 60'000;

Intent read(const schema::CarPose& from, const Place& place, Checker& check) {
  Intent intent;
  intent.car = check.id(place, "car", from.car());
  intent.motion.pose = check.pose(place, "pose", *from.pose());
  intent.motion.velocity = check.vector(place, "velocity", *from.velocity(), check.limits.fastest, "m/s");
  intent.motion.angular_velocity =
      check.vector(place, "angular_velocity", *from.angular_velocity(), check.limits.fastest_turn, "rad/s");
  intent.seen = from.seen();
  intent.importance = check.number(place, "importance", from.importance(), 0, 1, "");
  return intent;
}

void read_hull(const schema::Obstacle& from, const Place& place, Checker& check, Obstacle& obstacle) {
  if (!from.points()) return check.refuse(Reason::bad_hull, place, "points", "is absent; a hull needs at least 4");
  if (from.points()->size() > uint32_t(hull_point_limit)) {
    return check.refuse(
        Reason::bad_hull, place, "points",
        "has " + std::to_string(from.points()->size()) + " entries; a hull may have " + std::to_string(hull_point_limit));
  }
  std::vector<Vec3> points;
  for (const schema::Vec3* point : *from.points()) {
    points.push_back(check.vector(place, "points", *point, check.limits.widest, "m").cast<float>());
  }
  if (check.refusal) return;
  if (auto sentence = make_hull(points, obstacle)) check.refuse(Reason::bad_hull, place, "points", "is refused: " + *sentence);
}

void read_shape(const schema::Obstacle& from, const Place& place, Checker& check, Obstacle& obstacle) {
  const Limits& limits = check.limits;
  const schema::Vec3 none;
  const schema::Vec3& size = from.size() ? *from.size() : none;
  const auto length = [&](const char* field, float value, double least) {
    return check.number(place, field, value, least, limits.widest, "m");
  };
  switch (from.shape()) {
    case schema::Shape::box: {
      const Vec3 half(length("size.x", size.x(), limits.thinnest), length("size.y", size.y(), limits.thinnest),
                      length("size.z", size.z(), limits.thinnest));
      return make_box(half, obstacle);
    }
    case schema::Shape::sphere:
      return make_sphere(length("size.x", size.x(), limits.thinnest), obstacle);
    case schema::Shape::capsule:
      return make_capsule(length("size.x", size.x(), limits.thinnest), length("size.y", size.y(), 0), obstacle);
    case schema::Shape::half_space:
      return make_half_space(obstacle);
    case schema::Shape::hull:
      return read_hull(from, place, check, obstacle);
  }
  check.refuse(Reason::malformed, place, "shape",
               "is " + std::to_string(int(from.shape())) + "; shapes are box, sphere, capsule, half_space, hull (0 to 4)");
}

Obstacle read(const schema::Obstacle& from, const Place& place, Checker& check) {
  Obstacle obstacle;
  read_shape(from, place, check, obstacle);
  obstacle.pose = check.pose(place, "pose", *from.pose());
  if (from.velocity()) obstacle.velocity = check.vector(place, "velocity", *from.velocity(), check.limits.fastest, "m/s");
  if (from.angular_velocity()) {
    obstacle.angular_velocity =
        check.vector(place, "angular_velocity", *from.angular_velocity(), check.limits.fastest_turn, "rad/s");
  }
  obstacle.friction = check.number(place, "friction", from.friction(), 0, check.limits.roughest, "");
  return obstacle;
}

// Sorts the ids and refuses the first one that occurs twice.
template <class Id, class Text>
void refuse_duplicates(std::vector<Id>& ids, const char* list, Text text, Checker& check) {
  std::sort(ids.begin(), ids.end());
  const auto twice = std::adjacent_find(ids.begin(), ids.end());
  if (twice != ids.end()) check.refuse(Reason::duplicate, {}, list, "names " + text(*twice) + " twice; once is allowed");
}

SpawnOrder read(const schema::Spawn& from, Checker& check) {
  const Place spawn{"spawn"};
  const Limits& limits = check.limits;
  SpawnOrder order;
  order.asset = check.asset(spawn, from.asset());
  order.host = check.id(spawn, "host", from.host());
  order.pose = check.pose(spawn, "pose", *from.pose());
  order.planar = from.planar();
  order.mass = check.number(spawn, "mass", from.mass(), 0, limits.heaviest, "kg");
  if (order.mass > 0 && order.mass < 1) check.refuse(Reason::out_of_range, spawn, "mass", "is below 1 kg and not 0");
  if (from.inertia() && (from.inertia()->x() != 0 || from.inertia()->y() != 0 || from.inertia()->z() != 0)) {
    const auto axis = [&](const char* field, float value) {
      return double(check.number(spawn, field, value, 1e-3, limits.greatest_inertia, "kg m^2"));
    };
    order.inertia = {axis("inertia.x", from.inertia()->x()), axis("inertia.y", from.inertia()->y()),
                     axis("inertia.z", from.inertia()->z())};
  }
  if (from.center_of_mass()) {
    order.center_of_mass = check.vector(spawn, "center_of_mass", *from.center_of_mass(), limits.farthest_center, "m");
  }
  const bool center_given = order.center_of_mass && !order.center_of_mass->isZero(0);
  if (order.mass == 0 && (order.inertia || center_given)) {
    check.refuse(Reason::out_of_range, spawn, "mass",
                 "is 0 (as baked), yet inertia or center_of_mass is given; give all or none");
  }
  if (order.mass == 0) order.center_of_mass.reset();
  return order;
}

ParametersOrder read(const schema::Parameters& from, Checker& check) {
  const Place parameters{"parameters"};
  ParametersOrder order;
  if (from.solver()) {
    if (*from.solver() > schema::Solver::MAX) {
      check.refuse(Reason::malformed, parameters, "solver", "is neither nodal (0) nor classic (1)");
    }
    order.solver = *from.solver() == schema::Solver::classic ? Solver::classic : Solver::nodal;
  }
  if (from.iterations()) order.iterations = *from.iterations();
  if (from.tolerance()) order.tolerance = *from.tolerance();
  if (from.substeps()) order.substeps = *from.substeps();
  order.region = int(check.number(parameters, "region", float(from.region()), -1, region_limit - 1, ""));
  const auto take = [&](const char* field, flatbuffers::Optional<float> value, float Material::*member) {
    if (!value) return;
    check.finite(parameters, field, *value);
    order.changes.emplace_back(member, *value);
  };
  take("young_modulus", from.young_modulus(), &Material::young_modulus);
  take("poisson_ratio", from.poisson_ratio(), &Material::poisson_ratio);
  take("yield_strain", from.yield_strain(), &Material::yield_strain);
  take("hardening", from.hardening(), &Material::hardening);
  take("hardening_strain", from.hardening_strain(), &Material::hardening_strain);
  take("densification", from.densification(), &Material::densification);
  take("densification_strain", from.densification_strain(), &Material::densification_strain);
  take("plastic_limit", from.plastic_limit(), &Material::plastic_limit);
  take("drag", from.drag(), &Material::drag);
  take("friction", from.friction(), &Material::friction);
  take("distance_stiffness", from.distance_stiffness(), &Material::distance_stiffness);
  take("volume_stiffness", from.volume_stiffness(), &Material::volume_stiffness);
  take("plasticity", from.plasticity(), &Material::plasticity);
  return order;
}

void take(const flatbuffers::Vector<const schema::Vec3*>* from, std::vector<Vec3>& list) {
  for (const schema::Vec3* each : *from) list.emplace_back(each->x(), each->y(), each->z());
}
void take(const flatbuffers::Vector<float>* from, std::vector<Gradients>& list) {
  list.resize(from->size() / 9);
  for (uint32_t k = 0; k < 9 * list.size(); ++k) list[k / 9].corner[k % 9 / 3][k % 3] = from->Get(k);
}
void take(const flatbuffers::Vector<float>* from, std::vector<float>& list) { list.assign(from->begin(), from->end()); }
template <class Value>
void take(Value from, Value& value) {
  value = from;
}

LoadOrder read(const schema::Load& from, Checker& check) {
  LoadOrder order;
  const std::span bytes(reinterpret_cast<const std::byte*>(from.state()->data()), from.state()->size());
  const schema::State* state = checked<schema::State>(bytes, "load.state", "State", 1, check);
  if (!state) return order;
  order.asset = check.asset({"load.state"}, state->asset());
  if (state->gradients()->size() % 9 != 0) {
    check.refuse(Reason::bad_state, {"load.state"}, "gradients",
                 "has " + std::to_string(state->gradients()->size()) + " numbers; 9 per tet are needed");
    return order;
  }
  DeformableState& body = order.state;
  for_each_saved_field([&](auto field, auto get, auto) { take((state->*get)(), body.*field); });
  body.absorbed = check.energy({"load.state"}, "absorbed", body.absorbed);
  body.stored = check.energy({"load.state"}, "stored", body.stored);
  return order;
}

}  // namespace

static_assert(int{schema::Poses::VT_SEQUENCE} == sequence_field && int{schema::Obstacles::VT_SEQUENCE} == sequence_field);

std::optional<Refusal> decode(std::span<const std::byte> bytes, const Limits& limits, Intents& out) {
  Checker check{limits};
  const auto* from = checked<schema::Poses>(bytes, "poses", "Poses", limits.cars, check);
  if (!from) return check.refusal;
  if (from->cars()->size() > limits.cars) {
    check.refuse(Reason::too_many_cars, {}, "cars", count_sentence(from->cars()->size(), limits.cars));
    return check.refusal;
  }
  out.sequence = from->sequence();
  out.time = from->time();
  check.finite({}, "time", from->time());
  out.cars.clear();
  std::vector<std::string_view> ids;
  for (uint32_t i = 0; i < from->cars()->size() && !check.refusal; ++i) {
    out.cars.push_back(read(*from->cars()->Get(i), {"cars", i}, check));
    ids.push_back(from->cars()->Get(i)->car()->string_view());
  }
  refuse_duplicates(
      ids, "cars", [](std::string_view id) { return std::string(id); }, check);
  return check.refusal;
}

std::optional<Refusal> decode(std::span<const std::byte> bytes, const Limits& limits, ObstacleList& out) {
  Checker check{limits};
  const auto* from = checked<schema::Obstacles>(bytes, "obstacles", "Obstacles", limits.obstacles_per_host, check);
  if (!from) return check.refusal;
  const auto& list = *from->obstacles();
  if (list.size() > limits.obstacles_per_host) {
    check.refuse(Reason::too_many_obstacles, {}, "obstacles", count_sentence(list.size(), limits.obstacles_per_host));
    return check.refusal;
  }
  size_t points = 0;
  uint64_t threes = 0;
  for (const schema::Obstacle* obstacle : list) {
    const uint64_t n = obstacle->points() ? obstacle->points()->size() : 0;
    points += n;
    if (n >= 3 && n <= uint64_t(hull_point_limit)) threes += n * (n - 1) * (n - 2) / 6;
  }
  if (points > limits.hull_points_per_host) {
    check.refuse(Reason::too_many_obstacles, {}, "points of all hulls", count_sentence(points, limits.hull_points_per_host));
    return check.refusal;
  }
  if (threes > hull_threes_limit) {
    check.refuse(Reason::too_many_obstacles, {}, "hulls",
                 "need " + std::to_string(threes) + " triples of points to be tried; " + std::to_string(hull_threes_limit) +
                     " are allowed: give fewer hulls, or hulls of fewer points");
    return check.refusal;
  }
  std::vector<uint32_t> ids;
  std::vector<uint32_t> order(list.size());
  for (uint32_t i = 0; i < list.size(); ++i) {
    ids.push_back(list.Get(i)->id());
    order[i] = i;
  }
  std::sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return ids[a] < ids[b]; });
  refuse_duplicates(
      ids, "obstacles", [](uint32_t id) { return "id " + std::to_string(id); }, check);
  out.sequence = from->sequence();
  out.obstacles.clear();
  for (uint32_t i : order) {
    if (check.refusal) break;
    out.obstacles.push_back(read(*list.Get(i), {"obstacles", i}, check));
  }
  return check.refusal;
}

std::optional<Refusal> decode(std::span<const std::byte> bytes, const Limits& limits, Order& out) {
  Checker check{limits};
  const auto* from = checked<schema::Command>(bytes, "command", "Command", 1, check);
  if (!from) return check.refusal;
  if (const auto* spawn = from->order_as_Spawn()) {
    out = read(*spawn, check);
  } else if (from->order_as_Despawn()) {
    out = DespawnOrder{};
  } else if (const auto* repair = from->order_as_Repair()) {
    out = RepairOrder{check.number({"repair"}, "amount", repair->amount(), 0, 1, "")};
  } else if (const auto* parameters = from->order_as_Parameters()) {
    out = read(*parameters, check);
  } else if (from->order_as_Save()) {
    out = SaveOrder{};
  } else if (const auto* load = from->order_as_Load()) {
    out = read(*load, check);
  } else if (const auto* replace = from->order_as_Replace()) {
    out = ReplaceOrder{check.asset({"replace"}, replace->asset())};
  } else {
    check.refuse(Reason::malformed, {"command"}, "order",
                 "is of kind " + std::to_string(int(from->order_type())) +
                     "; kinds are Spawn, Despawn, Repair, Parameters, Save, Load, Replace (1 to 7)");
  }
  return check.refusal;
}

std::optional<Refusal> decode(std::span<const std::byte> bytes, const Limits& limits, Budget& out) {
  Checker check{limits};
  if (const auto* from = checked<schema::Budget>(bytes, "budget", "Budget", 1, check)) out = {from->work()};
  return check.refusal;
}

std::optional<Refusal> decode(std::span<const std::byte> bytes, const Limits& limits, UploadedAsset& out) {
  Checker check{limits};
  if (const auto* from = checked<schema::Asset>(bytes, "asset", "Asset", 1, check))
    out.car = std::as_bytes(std::span(from->car()->data(), from->car()->size()));
  return check.refusal;
}

std::optional<Refusal> decode(std::span<const std::byte> bytes, TickEnd& out) {
  const Limits limits;
  Checker check{limits};
  if (const auto* from = checked<schema::TickEnd>(bytes, "tick end", "TickEnd", 1, check)) {
    out = {from->tick(), from->hash(), from->lost_inputs(), from->lost_outputs(), from->inputs()};
  }
  return check.refusal;
}

void apply(const ParametersOrder& order, Parameters& parameters) {
  if (order.solver) parameters.solver = *order.solver;
  if (order.iterations) parameters.iterations = *order.iterations;
  if (order.tolerance) parameters.tolerance = *order.tolerance;
  if (order.substeps) parameters.substeps = *order.substeps;
  for (int region = 0; region < region_limit; ++region) {
    if (order.region >= 0 && order.region != region) continue;
    for (const auto& [member, value] : order.changes) parameters.region[region].*member = value;
  }
}

}  // namespace crumple

// The fields of a world, each of them once, for all who walk them: a snapshot writes and reads them (snapshot.cpp), the hash
// sums them up (hash.cpp). A File takes numbers (`raw`) and sizes of lists (`resize`), and says whether it `reads` into them or
// only `sums` them up: then bodies, logs and surfaces are left to the hashes that their car keeps.
#pragma once

#include <string>
#include <type_traits>
#include <vector>

#include "tick/state.h"

namespace crumple {

template <class File, class Number>
requires std::is_arithmetic_v<Number> || std::is_enum_v<Number>
void field(File& file, Number& value) { file.raw(&value, sizeof value); }
template <class File>
void field(File& file, bool& value) {
  uint8_t number = value;
  file.raw(&number, sizeof number);
  if constexpr (File::reads) value = number != 0;  // damage may be any number
}
template <class File, int Rows>
void field(File& file, Eigen::Matrix<float, Rows, 1>& v) {
  file.raw(v.data(), sizeof(float) * Rows);
}
template <class File>
void field(File& file, Eigen::Vector3d& v) {
  file.raw(v.data(), 3 * sizeof(double));
}
template <class File>
void field(File& file, std::string& text) {
  file.resize(text);
  file.raw(text.data(), text.size());
}
// Of numbers without padding.
template <class File, class Number>
void field(File& file, std::vector<Number>& list) {
  file.resize(list);
  file.raw(static_cast<void*>(list.data()), list.size() * sizeof(Number));
}
template <class File, size_t Rows, size_t Columns>
void field(File& file, std::array<std::array<double, Columns>, Rows>& table) {
  file.raw(table.data(), sizeof table);
}
template <class File>
void field(File& file, std::optional<uint64_t>& value) {
  uint8_t there = value.has_value();
  field(file, there);
  if constexpr (File::reads) value = there ? std::optional<uint64_t>(0) : std::nullopt;
  if (there) field(file, *value);
}
template <class File, class... Fields>
requires(sizeof...(Fields) > 1) void field(File& file, Fields&... each) { (field(file, each), ...); }

template <class File>
void field(File& file, Pose& pose) {
  field(file, pose.position);
  file.raw(pose.orientation.coeffs().data(), 4 * sizeof(double));
}
template <class File>
void field(File& file, Motion& motion) {
  field(file, motion.pose, motion.velocity, motion.angular_velocity);
}
template <class File>
void field(File& file, Parameters& parameters) {
  static_assert(sizeof(Material) == 9 * sizeof(float));
  field(file, parameters.solver, parameters.iterations, parameters.tolerance, parameters.substeps);
  file.raw(parameters.region.data(), sizeof parameters.region);
}
template <class File>
void field(File& file, AndersonHistory& history) {
  each_field(history, [&](auto& each) { field(file, each); });
}
template <class File>
void field(File& file, Body& body) {
  field(file, body.node, body.step, body.step_seconds, body.gradients, body.hardening, body.edge_rest, body.tet_rest);
  field(file, body.history);
  field(file, body.absorbed, body.stored, body.owed, body.force, body.moment);
  field(file, body.touching, body.drift, body.lost, body.settled);
}
template <class File>
void field(File& file, Told& told) {
  if constexpr (!File::sums) field(file, told.keyframe, told.latest);
  field(file, told.tick, told.keyframe_tick, told.due, told.flowing);
}
template <class File>
void field(File& file, Obstacle& obstacle) {
  field(file, obstacle.faces, obstacle.half_length, obstacle.radius, obstacle.reach, obstacle.width, obstacle.friction);
  field(file, obstacle.pose, obstacle.velocity, obstacle.angular_velocity);
}

// Without levels and body.
template <class File>
void field(File& file, Instance& car) {
  field(file, car.level_tick, car.importance, car.host, car.mass.mass, car.mass.inertia, car.mass.center, car.mass.planar);
  field(file, car.parameters, car.motion);
  if constexpr (!File::sums)
    for (ImpulseLog::Change& change : car.log.changes) field(file, change.tick, change.velocity, change.angular_velocity);
  field(file, car.touched_tick, car.sweeps, car.substeps, car.fresh);
  if constexpr (File::sums) file.raw(&car.hashes, sizeof car.hashes);
  for (Told& told : car.told) field(file, told);
  field(file, car.response.sweeps, car.response.substeps, car.response.work, car.response.residual);
}

// tick, budget, hosts and obstacles.
template <class File>
void field(File& file, World& world) {
  field(file, world.tick, world.budget);
  uint64_t hosts = world.hosts.size();
  field(file, hosts);
  auto at = world.hosts.begin();
  for (uint64_t k = 0; k < hosts; ++k) {
    std::string id;
    if constexpr (!File::reads) id = at->first;
    field(file, id);
    if constexpr (File::reads) at = world.hosts.try_emplace(id).first;
    Host& host = at->second;
    field(file, host.poses_sequence, host.obstacles_sequence, host.cars, host.obstacles);
    ++at;
  }
  uint64_t obstacles = world.obstacles.size();
  field(file, obstacles);
  for (uint64_t k = 0; k < obstacles; ++k) {
    if constexpr (File::reads) world.obstacles.emplace_back();
    field(file, world.obstacles[k]);
  }
}

}  // namespace crumple

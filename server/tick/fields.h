// Lists every field of a world once. The snapshot writes and reads the fields (snapshot.cpp), the hash hashes them (hash.cpp).
// A File takes numbers (`raw`) and sizes of lists (`resize`). `reads` says that it reads into the fields. `sums` says that it
// only hashes them; it then leaves out bodies, logs and surfaces and takes the hashes that the car keeps of them.
#pragma once

#include <array>
#include <concepts>
#include <string>
#include <type_traits>
#include <vector>

#include "tick/state.h"

namespace crumple {

// A T to read into, or a const T to write.
template <class T, class Type>
concept Is = std::same_as<std::remove_const_t<T>, Type>;
template <class T>
concept Numeric = (std::is_arithmetic_v<T> || std::is_enum_v<T>)&&!Is<T, bool>;
template <class T>
constexpr bool is_array = false;
template <class T, size_t Size>
constexpr bool is_array<std::array<T, Size>> = true;

template <class File>
void field(File& file, Numeric auto& value) {
  file.raw(&value, sizeof value);
}
template <class File>
void field(File& file, Is<bool> auto& value) {
  uint8_t number = value;
  file.raw(&number, sizeof number);
  if constexpr (File::reads) value = number != 0;  // damaged bytes may hold any number
}
template <class File>
void field(File& file, Is<Eigen::Vector3d> auto& v) {
  file.raw(v.data(), 3 * sizeof(double));
}
template <class File>
void field(File& file, Is<std::string> auto& text) {
  file.resize(text);
  file.raw(text.data(), text.size());
}
// Lists of numbers without padding.
template <class File, class List>
requires Is<List, std::vector<typename List::value_type>>
void field(File& file, List& list) {
  file.resize(list);
  file.raw(list.data(), list.size() * sizeof(typename List::value_type));
}
template <class File, class Array>
requires is_array<std::remove_const_t<Array>>
void field(File& file, Array& array) {
  for (auto& each : array) field(file, each);
}
template <class File>
void field(File& file, Is<std::optional<uint64_t>> auto& value) {
  uint8_t there = value.has_value();
  field(file, there);
  if constexpr (File::reads) value = there ? std::optional<uint64_t>(0) : std::nullopt;
  if (there) field(file, *value);
}
template <class File, class... Fields>
requires(sizeof...(Fields) > 1) void field(File& file, Fields&... each) { (field(file, each), ...); }

template <class File>
void field(File& file, Is<Pose> auto& pose) {
  field(file, pose.position);
  file.raw(pose.orientation.coeffs().data(), 4 * sizeof(double));
}
template <class File>
void field(File& file, Is<Motion> auto& motion) {
  field(file, motion.pose, motion.velocity, motion.angular_velocity);
}
template <class File>
void field(File& file, Is<Parameters> auto& parameters) {
  static_assert(sizeof(Material) == 13 * sizeof(float));
  field(file, parameters.solver, parameters.iterations, parameters.tolerance, parameters.substeps);
  file.raw(parameters.region.data(), sizeof parameters.region);
}
template <class File>
void field(File& file, Is<AndersonHistory> auto& history) {
  each_field(history, [&](auto& each) { field(file, each); });
}
template <class File>
void field(File& file, Is<PairMemory> auto& memory) {
  field(file, memory.touch, memory.push, memory.near, memory.passing);
}
template <class File>
void field(File& file, Is<DeformableState> auto& body) {
  for_each_field([&](const auto& each) { field(file, body.*each.value); });
}
template <class File>
void field(File& file, Is<ViewerState> auto& told) {
  if constexpr (!File::sums) field(file, told.keyframe, told.latest);
  field(file, told.tick, told.keyframe_tick, told.due, told.flowing);
}
template <class File>
void field(File& file, Is<Obstacle> auto& obstacle) {
  field(file, obstacle.faces, obstacle.half_length, obstacle.radius, obstacle.reach, obstacle.width, obstacle.friction);
  field(file, obstacle.pose, obstacle.velocity, obstacle.angular_velocity);
}

// All fields of a car except levels and body.
template <class File>
void field(File& file, Is<Instance> auto& car) {
  field(file, car.level_tick, car.importance, car.host, car.mass.mass, car.mass.inertia, car.mass.center, car.mass.planar);
  field(file, car.parameters, car.motion);
  if constexpr (!File::sums)
    for (auto& change : car.log.changes) field(file, change.tick, change.velocity, change.angular_velocity);
  field(file, car.touched_tick, car.sweeps, car.substeps, car.fresh);
  if constexpr (File::sums) file.raw(&car.hashes, sizeof car.hashes);
  for (auto& told : car.told) field(file, told);
  field(file, car.result.sweeps, car.result.substeps, car.result.work, car.result.residual);
}

// tick, budget, hosts and obstacles.
template <class File>
void field(File& file, Is<World> auto& world) {
  field(file, world.tick, world.budget);
  uint64_t hosts = world.hosts.size();
  field(file, hosts);
  auto at = world.hosts.begin();
  for (uint64_t k = 0; k < hosts; ++k) {
    std::string id;
    if constexpr (!File::reads) id = at->first;
    field(file, id);
    if constexpr (File::reads) at = world.hosts.try_emplace(id).first;
    auto& host = at->second;
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

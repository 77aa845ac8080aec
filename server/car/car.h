// A baked car: the file in memory and views into it. bake builds it, or it is read from a file, an attachment or a reply. After
// that it does not change, and all instances share it.
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

#include "protocol/parts.h"
#include "sim/model.h"

namespace crumple {

// Limits of a baked car: one tick can still be computed for it, and indices can address it.
inline constexpr uint32_t max_nodes = 200'000;
inline constexpr uint32_t max_tets = 1'000'000;
inline constexpr uint32_t max_vertices = 200'000;
inline constexpr uint32_t max_regions = 16;
inline constexpr float max_extent = 50;                       // m from the origin along each axis: twice the longest car
inline constexpr float least_mass = 10, most_mass = 100'000;  // kg: a pedal car, a loaded lorry
inline constexpr double smallest_volume = 1e-12;  // m^3 of a tet, a tenth of a millimetre cubed: nothing divides by less

struct Car {
  Model model;
  SweepOrder order;
  Boundary boundary;
  float mean_edge = 0;              // m
  std::vector<uint32_t> skin_node;  // nodes that some vertex follows, ascending: viewers receive their displacements
  std::string name;
  std::string attribution;
  std::vector<std::string> regions;
  Parts parts;
  Looks looks;
  std::span<const double> source_to_car;  // 12: rows of a 3 x 4 matrix (schema/car.fbs); or empty
  std::string hash;                       // 16 hexadecimal digits: XXH64 of the bytes
  std::span<const std::byte> bytes;       // the whole file
  std::shared_ptr<const void> owner;      // keeps the bytes alive
};

// Checks every size and index of a baked car's bytes, so no other code needs to. `name` names the bytes in sentences. Throws
// std::runtime_error with one sentence: name, fact, remedy. The first function keeps the bytes, the second copies them.
std::shared_ptr<const Car> read_car(std::string bytes, const std::string& name);
std::shared_ptr<const Car> read_car(std::span<const std::byte> bytes, const std::string& name);

}  // namespace crumple

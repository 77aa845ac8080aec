// The parts and looks of a baked car (schema/car.fbs), which servers and clients read and check alike.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "schema/car_generated.h"

namespace crumple {

inline constexpr size_t max_parts = 255;       // vertex_part has 8 bits
inline constexpr size_t part_name_limit = 64;  // bytes of printable ASCII
inline constexpr size_t max_looks = 255;
inline constexpr uint8_t no_look = 255;          // of a triangle: the program that shows the car chooses
inline constexpr float most_wheel_size = 5;      // m, of radius and width: the wheel of a mining truck has a radius of 2 m
inline constexpr float most_part_position = 50;  // m from the origin along each axis, as of vertices

struct Part {
  std::string name;
  schema::PartKind kind = schema::PartKind::body;
  std::array<float, 3> position{};               // m, car's frame
  std::array<float, 4> orientation{0, 0, 0, 1};  // x, y, z, w
  float radius = 0, width = 0;                   // m, of a wheel
};

struct Parts {
  std::vector<Part> part;
  std::span<const uint8_t> of_vertex;  // empty if there are no parts; it points into the car's bytes
};

// The looks of a material of the source, as in glTF; numbers from 0 to 1, colours in linear light.
struct Look {
  std::string name;
  std::array<float, 4> color{1, 1, 1, 1};  // red, green, blue, opacity
  float metallic = 0, roughness = 1;
  bool operator==(const Look&) const = default;
};

struct Looks {
  std::vector<Look> look;
  std::span<const uint8_t> of_triangle;  // empty if there are no looks; it points into the car's bytes
};

// Whether this can be the name of a part.
bool is_part_name(std::string_view);

// Reads and checks the parts of a car whose triangles name existing vertices. Returns what is wrong, or NULL.
const char* read_parts(const schema::Car&, Parts&);
const char* read_looks(const schema::Car&, Looks&);

}  // namespace crumple

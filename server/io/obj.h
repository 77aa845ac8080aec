// Writes a car's surface at one tick as a Wavefront OBJ file, in the car's frame. The first line is the attribution.
#pragma once

#include <cstdint>
#include <span>
#include <string>

namespace crumple {

// rest, displacement: 3 numbers per vertex, m. triangle: 3 vertices each. Throws std::runtime_error with one sentence if the
// file cannot be written.
void write_obj(const std::string& path, std::string attribution, const std::string& car, uint64_t tick,
               std::span<const float> rest, std::span<const float> displacement, std::span<const uint32_t> triangle);

}  // namespace crumple

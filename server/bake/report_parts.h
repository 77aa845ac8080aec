// Names the parts of a file whose vertices lie far outside the tets: they follow the nearest tet, which may belong to another
// part.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "bake/import_surface.h"

namespace crumple {

inline constexpr double far_from_tets = 0.04;  // m; the picture of a car draws the surface red from here on

// One sentence for each of the three worst parts. distance: m, from each vertex to its tet. triangle: three corners each.
std::vector<std::string> report_far_parts(std::span<const Vec3> vertex, std::span<const uint32_t> triangle,
                                          std::span<const double> distance, const std::vector<NamedPart>&);

}  // namespace crumple

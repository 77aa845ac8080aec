// Whether a surface looks like a car that stands on its wheels and drives forward: longest along x, the same left and right,
// broadest below. The shape does not tell which end is the front, but names such as "headlight" do.
#pragma once

#include <string>
#include <vector>

#include "bake/import_surface.h"

namespace crumple {

// A line on the shape, and at most one warning, which names the flag to give. options: the axes and the scale by which the
// surface was placed; both axes are given.
std::vector<std::string> check_shape(const Surface&, const ImportOptions& options);

// One line: the names that tell which end is the front, a warning if they tell the other end, or a question if none does.
std::string check_front(const ImportedSurface&, const ImportOptions& options);

// A length in the units of a file -> the scale that makes it most like a car's, and the unit's name, as in "0.0254 (inches)".
std::string likely_scale(double length);

}  // namespace crumple

#pragma once

#include <vector>

#include "viewer/surface.h"

namespace crumple::fuzz {

// Whoever makes a keyframe or a delta up makes its hash up too: gives it the one that makes it whole, if it is a part of
// anything.
void fit_hash(bool keyframe, const viewer::Surface& before, std::vector<uint8_t>& bytes);

}  // namespace crumple::fuzz

#pragma once

#include <vector>

#include "viewer/surface.h"

namespace crumple::fuzz {

// An attacker can also forge the hash of a keyframe or delta. So this corrects the hash, if the message is a valid part.
void fit_hash(bool keyframe, const viewer::Surface& before, std::vector<uint8_t>& bytes);

}  // namespace crumple::fuzz

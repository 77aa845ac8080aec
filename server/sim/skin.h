// What a body looks like: its surface, and where nodes have gone.
#pragma once

#include <span>

#include "sim/body.h"
#include "sim/transfer.h"

namespace crumple {

// Surface vertices in the car's frame, m. vertex: as many as the model's.
void skin(const Model&, const DeformableState&, std::span<Vec3> vertex);

// Displacements of these nodes from rest, car's frame, m. out: as many as nodes.
void displace(const Model&, const DeformableState&, std::span<const uint32_t> nodes, std::span<Vec3> out);

// The same that the body's mesh `from` gives to these nodes of another level.
void displace(const Model& from, const LevelMap&, const DeformableState&, std::span<const uint32_t> nodes, std::span<Vec3> out);

}  // namespace crumple

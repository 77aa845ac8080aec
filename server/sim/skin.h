// The shape of a body as others see it: surface vertices and node displacements.
#pragma once

#include <span>

#include "sim/body.h"
#include "sim/transfer.h"

namespace crumple {

// Surface vertices in the car's frame, m. `vertex` has as many entries as the model.
void skin(const Model&, const DeformableState&, std::span<Vec3> vertex);

// Displacements of these nodes from rest, car's frame, m. `out` has as many entries as `nodes`.
void displace(const Model&, const DeformableState&, std::span<const uint32_t> nodes, std::span<Vec3> out);

// The same for nodes of another level: they follow the body's own mesh `from`.
void displace(const Model& from, const LevelMap&, const DeformableState&, std::span<const uint32_t> nodes, std::span<Vec3> out);

}  // namespace crumple

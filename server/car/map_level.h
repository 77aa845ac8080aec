// Levels of a car: baked cars with the same surface (vertices, triangles, regions) and other tets. In: two of them. Out: where
// each finds itself in the other, for transfer() (sim/transfer.h). The same for any thread count.
#pragma once

#include "car/car.h"
#include "sim/transfer.h"

namespace crumple {

bool same_surface(const Car&, const Car&);

// Where `to` finds itself in `from`.
LevelMap map_level(const Model& from, const Model& to);

}  // namespace crumple

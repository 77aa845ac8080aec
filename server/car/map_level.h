// Levels of a car: baked cars with the same surface (vertices, triangles, regions) and different tets. Finds where one mesh
// lies in another, for transfer() (sim/transfer.h). The result is the same for any thread count.
#pragma once

#include "car/car.h"
#include "sim/transfer.h"

namespace crumple {

bool same_surface(const Car&, const Car&);

// Where the nodes and tets of `to` lie in `from`.
LevelMap map_level(const Model& from, const Model& to);

}  // namespace crumple

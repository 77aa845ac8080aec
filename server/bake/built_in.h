// A car that needs no file (described in built_in.cpp).
#pragma once

#include "bake/import_surface.h"
#include "car/mesh.h"

namespace crumple {

// Its body: a closed surface with exactly `vertices` vertices (400 to 20,000; the thesis's meshes have 1,259 and 3,674).
Surface build_car_body(size_t vertices);

// The same body with names and materials, so that glass, lights and trim are told apart, with wheels and seats in it. Wheels
// stand on z = 0.
ImportedSurface build_car(size_t vertices);

}  // namespace crumple

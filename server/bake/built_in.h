// A car body that needs no file (described in built_in.cpp).
#pragma once

#include "car/mesh.h"

namespace crumple {

// A closed surface with exactly `vertices` vertices (400 to 20,000; the thesis's meshes have 1,259 and 3,674).
Surface build_car_body(size_t vertices);

}  // namespace crumple

// A baked car of other measures: for a test of a real car of which there is no mesh.
#pragma once

#include <memory>

#include "car/car.h"

namespace crumple {

// What a published test says of a car; 0: as the baked car has it.
struct Measures {
  double length = 0, width = 0;  // m
  double mass = 0;               // kg
};

// Length and width of the drawn surface, and the baked mass.
Measures measures_of(const Car&);

// Stretches the car along x and y, about its origin, and gives it the mass. Its height stays, because tests do not publish one.
// Only the model is scaled: the result has no parts and no bytes, so it can crash but not be sent. Throws std::runtime_error
// with one sentence if the result is larger than a car may be (car.h).
std::shared_ptr<const Car> scale_car(const std::shared_ptr<const Car>&, const Measures&);

}  // namespace crumple

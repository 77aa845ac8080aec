// Fuzzes a baked car from a file, and then hits the car.
#include "car/car.h"

#include <stdexcept>

#include "bake/load_car.h"
#include "fuzz/small_world.h"
#include "host.h"
#include "tick/health.h"
#include "tick/levels.h"
#include "wheeled_car.h"

namespace crumple::fuzz {

bool car_run(Input input) {
  const MemoryFile file(input);
  std::shared_ptr<const Car> car;
  try {
    car = load_car(file.path());
  } catch (const std::runtime_error&) {
    return false;
  }
  const WorldHandle world = make_world(60, 0.0005f);
  add_asset(*world, coarse_car());
  add_asset(*world, car);
  warm_up(*world, 1);
  const host::Thing ball{1, schema::Shape::sphere, {1, 0, 0}, host::pose_at(3.2, 0, 0.5), {-14, 0, 0}};
  advance(*world, {{"car/a", host::spawn(car->hash, "h"), 1}, {"host/h/obstacles", host::obstacles(1, {ball})}});
  for (int k = 0; k < 3; ++k) advance(*world, {});
  return refusal_count(*world) == 0;
}

std::vector<std::vector<uint8_t>> car_seeds() {
  std::vector<std::vector<uint8_t>> seeds;
  for (const auto& car : {coarse_car(), fine_car(), wheeled_box_car({4, 2, 2}).car}) {
    const Input bytes = input_of(car->bytes);
    seeds.emplace_back(bytes.begin(), bytes.end());
  }
  return seeds;
}

}  // namespace crumple::fuzz

#include "bake/load_car.h"

#include "io/files.h"

namespace crumple {

std::shared_ptr<const Car> load_car(const std::filesystem::path& file) {
  return read_car(read_file(file, max_car_size, "make it with `crumple bake` or name another file"), file.string());
}

}  // namespace crumple

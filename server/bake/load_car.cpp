#include "bake/load_car.h"

#include "io/files.h"
#include "protocol/asset.h"

namespace crumple {

std::shared_ptr<const Car> load_car(const std::filesystem::path& file) {
  return read_car(read_file(file, asset_limit, "make it with `crumple bake` or name another file"), file.string());
}

}  // namespace crumple

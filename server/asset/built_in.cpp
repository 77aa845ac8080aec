#include "asset/built_in.h"

#include <stdexcept>

namespace crumple {

Surface build_car_body(size_t) { throw std::runtime_error("built-in: not there yet."); }

}  // namespace crumple

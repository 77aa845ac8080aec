// Checks the result of functions of io that must not fail.
#pragma once

#include <stdexcept>

#include "io/transport.h"

namespace crumple {

// Throws std::runtime_error with the error's sentence if the status is an error.
inline void need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
}

}  // namespace crumple

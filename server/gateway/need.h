// For functions of io that must not fail.
#pragma once

#include <stdexcept>

#include "io/transport.h"

namespace crumple {

// Throws std::runtime_error with the sentence of the error, if the status is one.
inline void need(int status) {
  if (status < 0) throw std::runtime_error(transport_error());
}

}  // namespace crumple

// `crumple info FILE...`: what is in a recording or a baked car, told from the file alone.
#pragma once

#include <string>
#include <vector>

namespace crumple {

// Returns the exit code. Throws std::runtime_error with one sentence for a file that is neither.
int info(const std::vector<std::string>& files);

}  // namespace crumple

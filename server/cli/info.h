// `crumple info FILE...`: reports what a recording or a baked car contains, from the file alone.
#pragma once

#include <string>
#include <vector>

namespace crumple {

// Returns the exit code. Throws std::runtime_error with one sentence if a file is neither.
int info(const std::vector<std::string>& files);

}  // namespace crumple

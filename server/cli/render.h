// `crumple render FILE`: draws pictures of a recording or a baked car with the Python package (crumple.render), which explains
// its own options.
#pragma once

#include <string>
#include <vector>

namespace crumple {

// Returns the exit code. Throws std::runtime_error with one sentence: file, fact, remedy.
int render(const std::vector<std::string>& arguments);

}  // namespace crumple

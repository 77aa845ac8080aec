// `crumple map CAR FILE`: says how well a mesh fits a baked car whose dents it is to show.
#pragma once

#include <string>

namespace crumple {

// Returns the exit code: 1 if the mesh is of another car, or in other coordinates. Throws std::runtime_error with one sentence:
// file, fact, remedy.
int map_mesh(const std::string& car, const std::string& mesh);

}  // namespace crumple

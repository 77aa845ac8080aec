// Paths that the build knows. Only paths.cpp contains them, so that ccache can share all other objects between clones.
#pragma once

#include <string>

namespace crumple {

std::string in_repository(const std::string& name);  // absolute path of a file or folder, named from the top of the repository
std::string program_path();                          // crumple
std::string hang_path();                             // library that makes a write hang (service/hang.c)

}  // namespace crumple

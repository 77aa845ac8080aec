#include "paths.h"

namespace crumple {

std::string in_repository(const std::string& name) { return CRUMPLE_SOURCE_DIR "/" + name; }
std::string program_path() { return CRUMPLE_PROGRAM; }
std::string hang_path() { return CRUMPLE_HANG; }

}  // namespace crumple

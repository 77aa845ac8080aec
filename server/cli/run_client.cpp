#include "cli/run_client.h"

#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <stdexcept>

namespace crumple {

int run_client(const std::string& verb, const std::vector<std::string>& arguments) {
  const std::string program = std::filesystem::read_symlink("/proc/self/exe").parent_path() / "crumple-client";
  std::vector<const char*> pointers = {program.c_str(), verb.c_str()};
  for (const std::string& argument : arguments) pointers.push_back(argument.c_str());
  pointers.push_back(nullptr);
  execv(program.c_str(), const_cast<char* const*>(pointers.data()));
  throw std::runtime_error(program + ": it cannot be started (" + std::strerror(errno) +
                           "); it must be in the folder of crumple, and `server/setup crumple-client` builds it");
}

}  // namespace crumple

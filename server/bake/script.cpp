#include "bake/script.h"

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>

extern char** environ;

namespace crumple {
namespace {

std::string interpreter() {
  const char* chosen = std::getenv("CRUMPLE_PYTHON");
  return chosen && *chosen ? chosen : CRUMPLE_PYTHON;
}

// Starts the child with stdout and stderr on one pipe; returns the end to read from.
int start(const std::vector<std::string>& command, pid_t& child) {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0)
    throw std::runtime_error(std::string("no pipe can be opened: ") + std::strerror(errno) + ".");
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_adddup2(&actions, ends[1], 1);
  posix_spawn_file_actions_adddup2(&actions, ends[1], 2);
  std::vector<char*> arguments;
  for (const std::string& part : command) arguments.push_back(const_cast<char*>(part.c_str()));
  arguments.push_back(nullptr);
  const int error = posix_spawnp(&child, arguments[0], &actions, nullptr, arguments.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(ends[1]);
  if (error != 0) {
    close(ends[0]);
    throw std::runtime_error(command[0] + ": it cannot be started (" + std::strerror(error) +
                             "); run server/setup, or set CRUMPLE_PYTHON to a Python with server/requirements.txt installed.");
  }
  return ends[0];
}

}  // namespace

TemporaryFolder::TemporaryFolder() {
  std::string name = (std::filesystem::temp_directory_path() / "crumple-XXXXXX").string();
  if (!mkdtemp(name.data()))
    throw std::runtime_error(name + ": no temporary folder can be made; set TMPDIR to a folder that can be written.");
  path = name;
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path, ignored);
}

int run_script(const std::string& text, const std::vector<std::string>& arguments, const OnLine& on_line) {
  std::vector<std::string> command = {interpreter(), "-u", "-c", text};
  command.insert(command.end(), arguments.begin(), arguments.end());
  pid_t child = 0;
  FILE* output = fdopen(start(command, child), "r");
  char* line = nullptr;
  size_t capacity = 0;
  for (ssize_t length; (length = getline(&line, &capacity, output)) > 0;)
    on_line(std::string(line, static_cast<size_t>(length - (line[length - 1] == '\n'))));
  std::free(line);
  std::fclose(output);
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

}  // namespace crumple

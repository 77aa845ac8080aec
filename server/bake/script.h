// Runs scripts in the project's Python environment, as a child process. Arrays pass through files in a temporary folder. The
// child's output comes back line by line.
#pragma once

#include <filesystem>
#include <fstream>
#include <functional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

namespace crumple {

// A new folder below the system's temporary folder, deleted with the object.
struct TemporaryFolder {
  std::filesystem::path path;
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
};

// Receives the child's output, one line of stdout or stderr at a time. Must not throw.
using OnLine = std::function<void(const std::string&)>;

// Runs a script given as text. Returns its exit status (128 + signal if it was killed). The interpreter is CRUMPLE_PYTHON of
// the environment or, without it, that of the build's Python environment. Throws std::runtime_error if it cannot start.
int run_script(const std::string& text, const std::vector<std::string>& arguments, const OnLine&);

template <class T>
void write_array(const std::filesystem::path& file, std::span<const T> values) {
  std::ofstream stream(file, std::ios::binary);
  stream.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(values.size_bytes()));
  stream.close();
  if (!stream)
    throw std::runtime_error(file.string() + ": it cannot be written; make room there, or set TMPDIR to another folder.");
}

template <class T>
std::vector<T> read_array(const std::filesystem::path& file) {
  std::vector<T> values(std::filesystem::file_size(file) / sizeof(T));
  std::ifstream stream(file, std::ios::binary);
  stream.read(reinterpret_cast<char*>(values.data()), static_cast<std::streamsize>(values.size() * sizeof(T)));
  if (!stream) throw std::runtime_error(file.string() + ": it cannot be read back; is the temporary folder still there?");
  return values;
}

}  // namespace crumple

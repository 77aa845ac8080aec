// Reads and writes whole files, for every verb. Reading takes only regular files that are not too large. Writing leaves a whole
// file or none. Both throw std::runtime_error with one sentence: file, fact, remedy.
#pragma once

#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

namespace crumple {

// Most bytes of a text that somebody wrote: a scene, a preset, options, a network, a mask. A mask of 1,000 dabs has 0.1 MB.
inline constexpr size_t text_limit = size_t{16} << 20;

// Reads a whole file. Refuses folders, pipes and devices, which may never end, and more than `most` bytes, whatever size the
// file claims, because it may change while it is read. The result is a copy: later changes of the file do not affect it.
std::string read_file(const std::filesystem::path&, size_t most, const std::string& remedy);

// Reads a pipe to its end; nothing if it gives more than `most` bytes.
std::optional<std::string> read_pipe(int from, size_t most);

// Writes beside the file and renames it at the end, so no half file is ever left. If the path is a pipe or a device, it writes
// directly to it.
class FileWriter {
 public:
  explicit FileWriter(std::filesystem::path);
  ~FileWriter();
  FileWriter(const FileWriter&) = delete;
  FileWriter& operator=(const FileWriter&) = delete;
  void put(std::string_view);
  void put(const void* bytes, size_t size) { put({static_cast<const char*>(bytes), size}); }
  void finish();

 private:
  [[noreturn]] void fail();
  std::filesystem::path path_, beside_;
  FILE* file_;
};

}  // namespace crumple

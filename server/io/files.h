// Whole files, in and out, for every verb. In: bytes of what is a file and not too large. Out: a file that is there whole or
// not at all. Both throw std::runtime_error with one sentence: file, fact, remedy.
#pragma once

#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

namespace crumple {

// Bytes of a text that somebody wrote: a scene, a preset, options, a network, a mask. A mask of 1,000 dabs has a tenth of a MB.
inline constexpr size_t text_limit = size_t{16} << 20;

// Refuses a folder, a pipe and a device, which may never end, and more than `most` bytes, whatever size the file claims: it may
// be changed while it is read. What is refused so is none of these bytes, and they are the reader's own from then on.
std::string read_file(const std::filesystem::path&, size_t most, const std::string& remedy);

// What comes through a pipe until its end; nothing where that are more than `most` bytes.
std::optional<std::string> read_pipe(int from, size_t most);

// Writes beside the file and gives it its name in the end, so that no half file is ever left. Where there is a pipe or a device
// already it is written to.
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

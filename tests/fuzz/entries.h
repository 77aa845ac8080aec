// Every entry of bytes that somebody else made, as a function of bytes: what libFuzzer feeds (libfuzzer.cpp), and what
// fuzz_test.cpp feeds with the inputs that are kept in corpus/ENTRY. A refusal is a good end; a crash is not, nor is a broken
// promise (expect).
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace crumple::fuzz {

using Input = std::span<const uint8_t>;

struct Entry {
  const char* name;
  // Whether nothing of it was refused.
  bool (*run)(Input);
  // Good inputs, made by today's code, so that they fit it: where fuzzing begins.
  std::vector<std::vector<uint8_t>> (*seeds)();
};
std::span<const Entry> entries();

// Throws Broken unless it holds.
struct Broken {
  std::string promise;
};
inline void expect(bool holds, const std::string& promise) {
  if (!holds) throw Broken{promise};
}

// Tells libFuzzer of something new that it cannot see: what came of code that is built without its counters (Rust, flatc's
// parser). Digits do not count as new.
void saw(std::string_view);

// A file that is nowhere on a disk.
class MemoryFile {
 public:
  explicit MemoryFile(Input = {});
  ~MemoryFile();
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;
  std::string path() const;
  std::vector<uint8_t> bytes() const;

 private:
  int number_;
};

// An input that is a list of messages: each `kind`, `which`, its size (16 bits, little endian), its bytes.
struct Part {
  uint8_t kind = 0, which = 0;
  std::vector<uint8_t> bytes;  // of its own, so that they are aligned as the transport's are
};
std::vector<Part> parts_of(Input);
void put(uint8_t kind, uint8_t which, Input bytes, std::vector<uint8_t>& to);

std::vector<uint8_t> bytes_of_file(const std::string& path);

inline Input input_of(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()};
}
inline std::span<const std::byte> bytes_of(Input input) {
  return {reinterpret_cast<const std::byte*>(input.data()), input.size()};
}

}  // namespace crumple::fuzz

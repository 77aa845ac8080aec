// Every reader of foreign bytes is an entry: a function of bytes. libFuzzer calls it with new inputs (libfuzzer.cpp), and
// fuzz_test.cpp with the inputs in corpus/ENTRY. An entry may refuse its input, but it must not crash or break a promise
// (expect).
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
  // True if the entry refused no part of the input.
  bool (*run)(Input);
  // Good inputs, made by the present code so that they match it. Fuzzing starts with them.
  std::vector<std::vector<uint8_t>> (*seeds)();
};
std::span<const Entry> entries();

// Throws Broken unless the condition holds.
struct Broken {
  std::string promise;
};
inline void expect(bool holds, const std::string& promise) {
  if (!holds) throw Broken{promise};
}

// Reports a result to libFuzzer that its counters cannot show, because the code (Rust, flatc's parser) is built without them.
// Results that differ only in digits are not new.
void saw(std::string_view);

// A file in memory.
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

// An input that is a list of messages. Each has `kind`, `which`, its size (16 bits, little endian), and its bytes.
struct Part {
  uint8_t kind = 0, which = 0;
  std::vector<uint8_t> bytes;  // a copy, so that they are aligned like the transport's
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

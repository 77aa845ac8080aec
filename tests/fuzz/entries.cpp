#include "fuzz/entries.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <fstream>
#include <iterator>

namespace crumple::fuzz {

// Each NAME has functions NAME_run and NAME_seeds, in NAME.cpp or beside a similar entry.
#define ENTRIES(each)                                                                                                \
  each(key) each(tick) each(inputs) each(snapshot) each(surface) each(client) each(car) each(recording) each(config) \
      each(network) each(scene) each(regions) each(parts) each(crash_tests)
#define DECLARE(name)     \
  bool name##_run(Input); \
  std::vector<std::vector<uint8_t>> name##_seeds();
#define LIST(name) {#name, name##_run, name##_seeds},
ENTRIES(DECLARE)
namespace {
constexpr Entry all[] = {ENTRIES(LIST)};
}

std::span<const Entry> entries() { return all; }

// libFuzzer watches these in addition to the counters of the code.
#if defined(CRUMPLE_SANITIZE)
__attribute__((section("__libfuzzer_extra_counters")))
#endif
static uint8_t seen[512];

void saw(std::string_view what) {
  size_t sum = 0;
  for (const char c : what)
    if (!std::isdigit(static_cast<unsigned char>(c))) sum = 31 * sum + static_cast<unsigned char>(c);
  seen[sum % sizeof seen] = 1;
}

MemoryFile::MemoryFile(Input input) : number_(memfd_create("fuzz", MFD_CLOEXEC)) {
  expect(number_ >= 0 && write(number_, input.data(), input.size()) == ssize_t(input.size()), "a file in memory can be made");
}
MemoryFile::~MemoryFile() { close(number_); }
std::string MemoryFile::path() const { return "/proc/self/fd/" + std::to_string(number_); }
std::vector<uint8_t> MemoryFile::bytes() const {
  std::vector<uint8_t> out(size_t(lseek(number_, 0, SEEK_END)));
  expect(pread(number_, out.data(), out.size(), 0) == ssize_t(out.size()), "a file in memory can be read");
  return out;
}

std::vector<uint8_t> bytes_of_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::vector<Part> parts_of(Input input) {
  std::vector<Part> parts;
  while (input.size() >= 4) {
    const size_t said = input[2] + 256u * input[3];
    Part part{input[0], input[1], {}};
    input = input.subspan(4);
    const size_t size = std::min(said, input.size());
    part.bytes.assign(input.begin(), input.begin() + ptrdiff_t(size));
    input = input.subspan(size);
    parts.push_back(std::move(part));
  }
  return parts;
}

void put(uint8_t kind, uint8_t which, Input bytes, std::vector<uint8_t>& to) {
  to.insert(to.end(), {kind, which, uint8_t(bytes.size()), uint8_t(bytes.size() >> 8)});
  to.insert(to.end(), bytes.begin(), bytes.end());
}

}  // namespace crumple::fuzz

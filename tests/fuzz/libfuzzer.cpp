// crumple_fuzz runs libFuzzer with the entry named by the environment variable ENTRY. With --seeds FOLDER it writes the entry's
// good inputs to the folder instead. With --entries it prints the names of all entries.
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <fstream>

#include "fuzz/entries.h"

using namespace crumple::fuzz;

namespace {
const Entry* chosen = nullptr;
int out = -1;  // a copy of stderr from before libFuzzer closed it for the tested code

int write_seeds(const std::string& folder) {
  size_t number = 0;
  for (const auto& seed : chosen->seeds())
    std::ofstream(folder + "/seed" + std::to_string(number++), std::ios::binary)
        .write(reinterpret_cast<const char*>(seed.data()), std::streamsize(seed.size()));
  return 0;
}
}  // namespace

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv) {
  out = dup(STDERR_FILENO);
  const bool list = *argc == 2 && std::strcmp((*argv)[1], "--entries") == 0;
  const char* name = std::getenv("ENTRY");
  for (const Entry& entry : entries()) {
    if (list) std::puts(entry.name);
    if (name && std::strcmp(entry.name, name) == 0) chosen = &entry;
  }
  if (list) std::exit(0);
  if (!chosen) {
    std::fprintf(stderr, "ENTRY names no entry: see --entries\n");
    std::exit(2);
  }
  if (*argc == 3 && std::strcmp((*argv)[1], "--seeds") == 0) std::exit(write_seeds((*argv)[2]));
  return 0;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  try {
    chosen->run({data, size});
  } catch (const Broken& broken) {
    dprintf(out, "broken promise: %s\n", broken.promise.c_str());
    std::abort();
  }
  return 0;
}

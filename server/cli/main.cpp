// Only main() catches errors.
#include <malloc.h>

#include <cstdio>
#include <exception>

#include "cli/command_line.h"

int main(int argc, char** argv) {
#ifdef M_ARENA_MAX
  // glibc's default is eight arenas a core. What one thread allocates and another frees leaves holes in each of them: a
  // server's memory grew by 4 to 11 MB an hour, and grows by less than 1 MB with two arenas (tests/chaos/soak).
  mallopt(M_ARENA_MAX, 2);
#endif
  try {
    return crumple::run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple%s%s: %s\n", argc > 1 ? " " : "", argc > 1 ? argv[1] : "", error.what());
    return 1;
  }
}

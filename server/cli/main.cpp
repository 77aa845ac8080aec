// Only main() catches errors.
#include <malloc.h>

#include <cstdio>
#include <exception>

#include "cli/command_line.h"

int main(int argc, char** argv) {
#ifdef M_ARENA_MAX
  // With glibc's default of eight arenas a core, what one thread allocates and another frees leaves holes in each of them: a
  // server's memory grew by 11 MB an hour, with two by 0.1 (server/README.md).
  mallopt(M_ARENA_MAX, 2);
#endif
  try {
    return crumple::run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple%s%s: %s\n", argc > 1 ? " " : "", argc > 1 ? argv[1] : "", error.what());
    return 1;
  }
}

// Only main() catches errors.
#include <cstdio>
#include <exception>

#include "cli/command_line.h"

int main(int argc, char** argv) {
  try {
    return crumple::run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple%s%s: %s\n", argc > 1 ? " " : "", argc > 1 ? argv[1] : "", error.what());
    return 1;
  }
}

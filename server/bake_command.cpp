#include "bake_command.h"

#include <unistd.h>

#include <cstdio>

namespace crumple {

int bake_command(const BakeCommandOptions& options) {
  const bool terminal = isatty(STDERR_FILENO);
  const BakeResult result = bake(options.bake, [&](const std::string& what) {
    if (terminal) std::fprintf(stderr, "\r%s\x1b[K", what.c_str());
  });
  if (terminal) std::fprintf(stderr, "\r\x1b[K");
  write_car(*result.car, options.output);
  for (const std::string& line : result.report) std::printf("%s\n", line.c_str());
  std::printf("%s  %s  %s\n", options.output.c_str(), result.car->hash.c_str(), result.car->attribution.c_str());
  return 0;
}

}  // namespace crumple

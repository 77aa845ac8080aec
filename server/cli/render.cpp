#include "cli/render.h"

#include <unistd.h>

#include <cstdio>
#include <stdexcept>

#include "bake/script.h"

namespace crumple {
namespace {

constexpr char script[] = R"(
import sys
try:
    from crumple.render import main
except ImportError as error:
    sys.exit(f"{error}: run server/setup python_package, or `pip install clients/python[render]` where CRUMPLE_PYTHON is")
main()
)";

}  // namespace

int render(const std::vector<std::string>& arguments) {
  const bool terminal = isatty(STDERR_FILENO);
  std::string said;
  const int status = run_script(script, arguments, [&](const std::string& line) {
    if (!line.starts_with("... "))
      said += (said.empty() ? "" : "\n") + line;
    else if (terminal)
      std::fprintf(stderr, "\r%s\x1b[K", line.c_str() + 4);
  });
  if (terminal) std::fprintf(stderr, "\r\x1b[K");
  if (status == 0)
    std::printf("%s\n", said.c_str());
  else if (status == 1)
    throw std::runtime_error(said);
  else if (!said.empty())
    std::fprintf(stderr, "%s\n", said.c_str());
  return status;
}

}  // namespace crumple

#include "cli/render.h"

#include <unistd.h>

#include <cstdio>
#include <stdexcept>

#include "bake/script.h"

namespace crumple {
namespace {

constexpr char script[] = R"(
import importlib, sys
try:
    main = importlib.import_module(f"crumple.{sys.argv.pop(1)}").main
except ImportError as error:
    sys.exit(f"{error}: run server/setup python_package, or `pip install clients/python[render]` where CRUMPLE_PYTHON is")
main()
)";

// Runs the main() of a module of the Python package.
int run_module(const std::string& name, std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), name);
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

}  // namespace

int render(const std::vector<std::string>& arguments) { return run_module("render", arguments); }

int export_model(const ExportOptions& options, const std::string& model) {
  return run_module("export", {options.file, options.folder, model, std::to_string(options.fps)});
}

}  // namespace crumple

#include "cli/bake_command.h"

#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <stdexcept>

#include "cli/render.h"
#include "io/files.h"

namespace crumple {

namespace {

int bake_one(const BakeOptions& options, const std::filesystem::path& output, const BakeCommandOptions& command) {
  const bool terminal = isatty(STDERR_FILENO);
  const BakeResult result = bake(options, [&](const std::string& what) {
    if (terminal) std::fprintf(stderr, "\r%s\x1b[K", what.c_str());
  });
  if (terminal) std::fprintf(stderr, "\r\x1b[K");
  write_car(*result.car, output);
  for (const std::string& line : result.report) std::printf("%s\n", line.c_str());
  std::printf("%s  %s  %s\n", output.c_str(), result.car->hash.c_str(), result.car->attribution.c_str());
  if (!command.write_parts.empty()) {
    FileWriter writer(command.write_parts);
    writer.put(result.parts);
    writer.finish();
  }
  const std::string& pictures = command.pictures;
  if (pictures.empty()) return 0;
  std::fflush(stdout);
  try {
    return render({std::filesystem::absolute(output).string(), "--output=" + pictures});
  } catch (const std::runtime_error& refused) {
    throw std::runtime_error(output.string() + ": the car is baked, but not its picture: " + refused.what());
  }
}

}  // namespace

int bake_command(const BakeCommandOptions& options) {
  if (options.nodes.size() > 1 && !options.bake.tets.empty())
    throw std::runtime_error("--nodes: --tets gives one level only; bake the levels one by one, or leave --tets out.");
  if (!options.mesher.empty() && !options.bake.tets.empty())
    throw std::runtime_error("--mesher: the tets of --tets need no mesher; leave --mesher or --tets out.");
  BakeOptions one = options.bake;
  const ImportOptions& import = one.import;
  const bool placed = !import.forward.empty() || !import.up.empty() || import.scale != 1;
  if (is_baked_car(one.input) && (!options.parts.empty() || !options.write_parts.empty()))
    throw std::runtime_error(
        one.input + ": this is a baked car, so its parts cannot change; give --parts and --write-parts with the surface.");
  if (is_baked_car(one.input) && (!options.nodes.empty() || !options.mesher.empty() || !one.tets.empty() || placed))
    throw std::runtime_error(
        one.input +
        ": this is a baked car, so its tets and axes cannot change; give only --regions, --mass, --name and "
        "--attribution, or bake from the surface again.");
  if (!options.mesher.empty()) one.mesher = options.mesher == "lattice" ? Mesher::lattice : Mesher::ftetwild;
  if (!options.regions.empty()) one.regions = read_regions(options.regions);
  if (!options.parts.empty()) one.parts = read_parts(options.parts);
  if (options.nodes.empty()) return bake_one(one, options.output, options);
  for (const size_t nodes : options.nodes) {
    one.nodes = nodes;
    std::filesystem::path output = options.output;
    if (options.nodes.size() > 1)
      output.replace_filename(output.stem().string() + "-" + std::to_string(nodes) + output.extension().string());
    if (const int status = bake_one(one, output, options)) return status;
  }
  return 0;
}

}  // namespace crumple

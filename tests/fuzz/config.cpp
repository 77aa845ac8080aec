// Fuzzes an operator's files: options (serve --config), and the configuration of Zenoh (--network).
#include <cstring>
#include <stdexcept>

#include "cli/command_line.h"
#include "fuzz/small_world.h"
#include "io/net.h"
#include "paths.h"

namespace crumple::fuzz {

bool config_run(Input input) {
  const MemoryFile file(input), car(input_of(coarse_car()->bytes));
  const std::string path = file.path(), baked = car.path();
  bool taken = true;
  for (const char* what : {"--check-config", "--print-config"}) {
    const char* arguments[] = {"crumple", "serve", "--car", baked.c_str(), "--config", path.c_str(), what};
    try {
      taken &= run(7, arguments) == 0;
    } catch (const std::exception&) {  // main catches it
      taken = false;
    }
  }
  return taken;
}

std::vector<std::vector<uint8_t>> config_seeds() {
  const std::string_view text =
      "# a comment\nscene=\"arena\"\nrate=30\nthreads=2\nbudget=1.5\nquantum=0.25\nlisten='tcp/127.0.0.1:0'\nseconds=0\n"
      "standby=false\nmetrics=\"\"\nrecord=\"%F.mcap\"\nnetwork=\"\"\n";
  return {{text.begin(), text.end()}};
}

bool network_run(Input input) {
  const std::string text(input.begin(), input.end());
  if (net_check(text.c_str()) == 0) return true;
  saw(transport_error());
  return false;
}

std::vector<std::vector<uint8_t>> network_seeds() {
  std::vector<std::vector<uint8_t>> seeds;
  for (const std::string file : {"server/network.json5", "clients/network.json5"})
    seeds.push_back(bytes_of_file(in_repository(file)));
  return seeds;
}

}  // namespace crumple::fuzz

// crumple_bench [GOOGLE BENCHMARK'S OPTIONS] CAR ...: one benchmark for each room and car. bench/run calls it.
#include <cstdio>
#include <exception>

#include "bake/load_car.h"
#include "rooms.h"

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (argc < 2 || argv[1][0] == '-') {
    std::fprintf(stderr, "crumple_bench: name the baked cars to measure, or call bench/run, which bakes them\n");
    return 2;
  }
  try {
    for (int i = 1; i < argc; ++i) {
      const std::filesystem::path file = argv[i];
      const auto bench = std::make_shared<const crumple::Bench>(file, file.stem().string(), crumple::load_car(file));
      crumple::register_bake(bench);
      crumple::register_loop(bench);
    }
    benchmark::RunSpecifiedBenchmarks();
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple_bench: %s\n", error.what());
    return 1;
  }
}

// Plays the scene of the peers (bench/peers/scene.py, play.py) once with deform(): `nodal`, elastic, one or more sub-steps in a
// step.
//   crumple_peer SCENE OUT THREADS SUBSTEPS SWEEPS STEPS
// SCENE is the little-endian file that play.py also writes for Jolt. OUT gets the final node positions as float32. Prints one
// line of JSON: the milliseconds to build constraints and colours, the milliseconds of every step, and the share of the blocks
// that the last sub-step solved. The scene holds the pushed nodes (held_mesh.h).
#include <tbb/global_control.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <exception>
#include <fstream>
#include <map>
#include <stdexcept>
#include <string>

#include "bake/order_spatially.h"
#include "reference/held_mesh.h"
#include "sim/scratch.h"

namespace {

using namespace crumple;

struct Scene {
  TetMesh tets;                       // in the order of a baked car
  std::vector<uint32_t> origin;       // index of each node in the file
  std::vector<uint8_t> held, pushed;  // per node
  float dt = 0, speed = 0;            // s; m/s along -x
};

template <class T>
T take(std::istream& in) {
  T value{};
  if (!in.read(reinterpret_cast<char*>(&value), sizeof value)) throw std::runtime_error("the scene ends too soon.");
  return value;
}

Scene read_scene(const std::string& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) throw std::runtime_error(file + ": cannot be read.");
  const int nodes = take<int>(in), tets = take<int>(in), edges = take<int>(in);
  Scene scene;
  scene.dt = take<float>(in);
  scene.speed = take<float>(in);
  std::vector<std::array<float, 5>> node;  // position, inverse mass, pushed
  for (int i = 0; i < nodes; ++i) node.push_back(take<std::array<float, 5>>(in));
  for (int i = 0; i < edges; ++i) take<std::array<int, 3>>(in);
  for (int i = 0; i < tets; ++i) {
    scene.tets.tet.push_back(take<Tet>(in));
    take<float>(in);
  }
  std::map<std::array<float, 3>, uint32_t> at;
  for (uint32_t i = 0; i < node.size(); ++i) {
    scene.tets.node.emplace_back(node[i][0], node[i][1], node[i][2]);
    at[{node[i][0], node[i][1], node[i][2]}] = i;
  }
  order_spatially(scene.tets);
  for (const Vec3& x : scene.tets.node) {
    const uint32_t i = at.at({x.x(), x.y(), x.z()});
    scene.origin.push_back(i);
    scene.held.push_back(node[i][3] == 0);
    scene.pushed.push_back(node[i][4] != 0);
  }
  return scene;
}

double milliseconds() {
  return 1e3 * std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

void play(const Scene& scene, int substeps, int sweeps, int steps, const std::string& out) {
  const double begin = milliseconds();
  HeldMesh mesh(scene.tets, scene.held, 1100);
  std::printf("{\"build_ms\":%.5g,\"ms\":[", milliseconds() - begin);
  Parameters parameters;
  parameters.iterations = uint16_t(sweeps);
  parameters.tolerance = 0;
  parameters.substeps = uint16_t(substeps);
  for (Material& material : parameters.region) {
    material.young_modulus = 15e6f;  // as bench/peers/scene.py
    material.plastic_limit = 0;
    material.yield_strain = 1;  // so no tet flows
  }
  const ScratchHandle scratch = make_scratch();
  DeformableState body = make_body(mesh.model());
  for (int step = 0; step < steps; ++step) {
    double spent = 0;
    for (int k = 1; k <= substeps; ++k) {
      const double way = double(scene.speed * scene.dt) * (step + double(k) / substeps);
      for (size_t i = 0; i < scene.pushed.size(); ++i) {
        if (scene.pushed[i]) mesh.place[i].x() = float(double(scene.tets.node[i].x()) - way);
      }
      const double start = milliseconds();
      hold(mesh, parameters, {}, *scratch, body);
      spent += milliseconds() - start;
    }
    std::printf("%s%.5g", step > 0 ? "," : "", spent);
  }
  const ActiveSet& active = scratch->solver.active;
  std::printf("],\"awake\":%.3g}\n", double(active.node.size()) / double(active.awake.size()));
  std::vector<Vec3> found(scene.origin.size());
  for (size_t i = 0; i < found.size(); ++i) found[scene.origin[i]] = body.node[i];
  std::ofstream(out, std::ios::binary).write(reinterpret_cast<const char*>(found.data()), std::streamsize(12 * found.size()));
}

}  // namespace

int main(int argc, char** argv) {
  try {
    if (argc != 7) throw std::runtime_error("six arguments are needed; bench/peers/play.py gives them.");
    const Scene scene = read_scene(argv[1]);
    const int threads = std::stoi(argv[3]);
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, size_t(threads));
    tbb::task_arena(threads).execute([&] { play(scene, std::stoi(argv[4]), std::stoi(argv[5]), std::stoi(argv[6]), argv[2]); });
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple_peer: %s\n", error.what());
    return 1;
  }
}

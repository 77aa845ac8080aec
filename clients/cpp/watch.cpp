// The viewer polls, prints once a second, and writes the surface that it holds as a Wavefront OBJ file.
#include "cpp/watch.h"

#include <chrono>
#include <crumple.hpp>
#include <cstdio>
#include <vector>

#include "io/obj.h"

namespace crumple::client {
namespace {

using Clock = std::chrono::steady_clock;

std::vector<std::string> held_cars(Session& session) {
  std::vector<std::string> held;
  for (const std::string& id : session.cars())
    if (session.surface(id)) held.push_back(id);
  return held;
}

void print(Session& session, double bytes_per_second) {
  const auto held = held_cars(session);
  if (held.empty()) std::printf("no car yet\n");
  for (const std::string& id : held) {
    const CrumpleSurface surface = *session.surface(id);
    uint32_t displaced = 0;
    for (uint32_t i = 0; i < surface.node_count; ++i) {
      const int16_t* d = surface.quanta + 3 * i;
      displaced += d[0] || d[1] || d[2];
    }
    std::printf("car %s  tick %llu  nodes %u  displaced %u  quantum %g mm  hash %016llx  %.0f bytes/s%s\n", id.c_str(),
                static_cast<unsigned long long>(surface.tick), surface.node_count, displaced,
                1e3 * static_cast<double>(surface.quantum), static_cast<unsigned long long>(surface.hash), bytes_per_second,
                surface.alive ? "" : "  (gone)");
  }
  std::fflush(stdout);
}

// It asks for the mesh while the server is still there.
void write_surface(Session& session, const std::string& id, const std::string& path) {
  const CrumpleMesh mesh = session.mesh(session.surface(id).value().asset);
  std::vector<float> displacement(size_t{3} * mesh.vertex_count);
  CrumpleVertices vertices{};
  vertices.displacement = displacement.data();
  vertices.stride = 3 * sizeof(float);
  vertices.capacity = mesh.vertex_count;
  const auto surface = session.surface(id);  // which may be newer now
  if (!surface || !session.copy(id, vertices))
    throw Error("car " + id + " is not held any more, because its server fell silent");
  write_obj(path, mesh.attribution, id, surface->tick, {mesh.vertex, displacement.size()}, displacement,
            {mesh.triangle, size_t{3} * mesh.triangle_count});
  std::printf("wrote %s\n", path.c_str());
}

}  // namespace

int watch(const WatchOptions& options, const std::atomic<bool>& stop) {
  Session session({options.connect, options.scene, "", options.network, std::chrono::seconds(5)});
  if (options.car.empty())
    session.follow_all(options.level);
  else
    session.follow(options.car, options.level);

  const double limit = options.seconds > 0 ? options.seconds : options.once ? 10 : 1e9;
  const auto start = Clock::now(),
             end = start + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(limit));
  auto next = start + std::chrono::seconds(1);
  uint64_t bytes = 0;
  while (!stop && Clock::now() < end && !(options.once && !held_cars(session).empty())) {
    session.poll(std::chrono::milliseconds(100));
    if (options.once || Clock::now() < next) continue;
    next += std::chrono::seconds(1);
    const uint64_t now = session.statistics().received_bytes;
    print(session, static_cast<double>(now - bytes));
    bytes = now;
  }
  if (options.once) print(session, 0);
  const auto held = held_cars(session);
  if (held.empty()) {
    std::fprintf(stderr, "crumple watch: no surface arrived%s%s: is such a car spawned?\n",
                 options.car.empty() ? "" : " of car ", options.car.c_str());
    return 1;
  }
  if (!options.obj.empty()) write_surface(session, held.front(), options.obj);
  return 0;
}

}  // namespace crumple::client

// The viewer that prints: polls, prints once a second, and writes the surface it holds as a Wavefront OBJ file.
#include "cpp/watch.h"

#include <chrono>
#include <cstdio>
#include <stdexcept>
#include <vector>

#include "cpp/crumple_client.h"
#include "cpp/obj.h"

namespace crumple::client {
namespace {

using Clock = std::chrono::steady_clock;

struct Session {
  Crumple* handle = nullptr;
  ~Session() { crumple_close(handle); }
};

int need(int status) {
  if (status < 0) throw std::runtime_error(crumple_error());
  return status;
}

std::vector<std::string> held_cars(Crumple* session) {
  std::vector<const char*> ids(crumple_cars(session, nullptr, 0));
  crumple_cars(session, ids.data(), ids.size());
  std::vector<std::string> held;
  CrumpleSurface surface;
  for (const char* id : ids)
    if (crumple_surface(session, id, &surface) == CRUMPLE_OK) held.emplace_back(id);
  return held;
}

void print(Crumple* session, double bytes_per_second) {
  const auto held = held_cars(session);
  if (held.empty()) std::printf("no car yet\n");
  for (const std::string& id : held) {
    CrumpleSurface surface{};
    crumple_surface(session, id.c_str(), &surface);
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

// The mesh is asked for while the server is still there.
CrumpleMesh mesh_of(Crumple* session, const CrumpleSurface& surface) {
  CrumpleMesh mesh{};
  const std::string asset = surface.asset;
  const auto deadline = Clock::now() + std::chrono::seconds(10);
  while (need(crumple_mesh(session, asset.c_str(), &mesh)) == CRUMPLE_PENDING) {
    if (Clock::now() > deadline) throw std::runtime_error("the server does not send asset " + asset);
    need(crumple_poll(session, 100'000));
  }
  return mesh;
}

void write_surface(Crumple* session, const std::string& id, const std::string& path) {
  CrumpleSurface surface{};
  need(crumple_surface(session, id.c_str(), &surface));
  const CrumpleMesh mesh = mesh_of(session, surface);
  need(crumple_surface(session, id.c_str(), &surface));
  std::vector<float> displacement(size_t{3} * mesh.vertex_count);
  CrumpleVertices vertices{};
  vertices.displacement = displacement.data();
  vertices.stride = 12;
  vertices.capacity = mesh.vertex_count;
  need(crumple_copy(session, id.c_str(), &vertices));
  write_obj(path, mesh.attribution, id, surface.tick, {mesh.vertex, displacement.size()}, displacement,
            {mesh.triangle, size_t{3} * mesh.triangle_count});
  std::printf("wrote %s\n", path.c_str());
}

}  // namespace

int watch(const WatchOptions& options, const std::atomic<bool>& stop) {
  Session session;
  const CrumpleOptions open{CRUMPLE_CLIENT_VERSION, 5000,    options.connect.c_str(),
                            options.scene.c_str(),  nullptr, options.network.c_str()};
  need(crumple_open(&open, &session.handle));
  need(crumple_follow(session.handle, options.car.empty() ? nullptr : options.car.c_str(), options.level));

  const double limit = options.seconds > 0 ? options.seconds : options.once ? 10 : 1e9;
  const auto start = Clock::now(),
             end = start + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(limit));
  auto next = start + std::chrono::seconds(1);
  uint64_t bytes = 0;
  while (!stop && Clock::now() < end && !(options.once && !held_cars(session.handle).empty())) {
    need(crumple_poll(session.handle, 100'000));
    if (options.once || Clock::now() < next) continue;
    next += std::chrono::seconds(1);
    CrumpleStatistics statistics;
    crumple_statistics(session.handle, &statistics);
    print(session.handle, static_cast<double>(statistics.received_bytes - bytes));
    bytes = statistics.received_bytes;
  }
  if (options.once) print(session.handle, 0);
  const auto held = held_cars(session.handle);
  if (held.empty()) {
    std::fprintf(stderr, "crumple watch: no surface arrived%s%s: is such a car spawned?\n",
                 options.car.empty() ? "" : " of car ", options.car.c_str());
    return 1;
  }
  if (!options.obj.empty()) write_surface(session.handle, held.front(), options.obj);
  return 0;
}

}  // namespace crumple::client

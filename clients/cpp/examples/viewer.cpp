// This viewer keeps a car's surface in an engine's own vertex buffer until the car is gone.
//   viewer ENDPOINT CAR        for example: viewer tcp/127.0.0.1:7447 car1
#include <chrono>
#include <cmath>
#include <crumple.hpp>
#include <cstdio>
#include <exception>
#include <optional>
#include <vector>

namespace {

using namespace std::chrono_literals;

struct Vertex {  // as the engine draws it
  float position[3], normal[3], uv[2];
};

// Here an engine hands the changed vertices to the graphics card: glBufferSubData, UpdateSubresource, ...
void upload(const std::vector<Vertex>&, uint32_t first, uint32_t count) {
  std::printf("%u vertices from %u on changed\n", count, first);
  std::fflush(stdout);
}

void view(const char* endpoint, const char* car) {
  crumple::client::Session session({.connect = endpoint, .timeout = 10s});
  session.follow(car);
  std::optional<CrumpleSurface> surface;
  while (!(surface = session.surface(car))) session.poll(100ms);
  const CrumpleMesh mesh = session.mesh(surface->asset);
  std::vector<Vertex> buffer(mesh.vertex_count);
  CrumpleVertices vertices{};
  vertices.position = buffer[0].position;
  vertices.normal = buffer[0].normal;
  vertices.stride = sizeof(Vertex);
  vertices.capacity = buffer.size();
  bool alive = true;
  while (alive) {
    session.poll(16ms);  // a frame; an engine does not wait here
    // The surface of a tenth of a second ago, between two ticks if need be: smooth even if messages come unevenly.
    vertices.time = session.time() - 0.1;
    if (session.copy(car, vertices) && vertices.count > 0) upload(buffer, vertices.first, vertices.count);
    if ((surface = session.surface(car))) alive = surface->alive;
  }
  vertices.time = 0;  // the newest
  if (!session.copy(car, vertices)) throw crumple::client::Error("the car was despawned while the viewer was stopped");
  float deepest = 0;
  for (size_t i = 0; i < buffer.size(); ++i) {
    const float *now = buffer[i].position, *rest = mesh.vertex + 3 * i;
    deepest = std::max(deepest, std::hypot(now[0] - rest[0], now[1] - rest[1], now[2] - rest[2]));
  }
  std::printf("%s: tick %llu, hash %016llx, deepest dent %.0f mm\n%s\n", car, static_cast<unsigned long long>(surface->tick),
              static_cast<unsigned long long>(surface->hash), 1e3 * double{deepest}, mesh.attribution);
}

}  // namespace

int main(int count, char** arguments) {
  try {
    if (count != 3) throw crumple::client::Error("usage: viewer ENDPOINT CAR");
    view(arguments[1], arguments[2]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "viewer: %s\n", error.what());
    return 1;
  }
}

// A host: spawns a car, drives it into a wall, continues with the motion after the crash, and despawns the car.
//   host ENDPOINT CARFILE      for example: host tcp/127.0.0.1:7447 car.car
#include <algorithm>
#include <chrono>
#include <crumple.hpp>
#include <cstdio>
#include <exception>
#include <thread>

namespace {

constexpr double step = 1.0 / 60;  // s, of this host; the server has its own

// The wall stands 1 m before the nose of a car at the origin.
CrumpleObstacle wall_before(const CrumpleMesh& mesh) {
  float nose = 0;
  for (uint32_t i = 0; i < mesh.vertex_count; ++i) nose = std::max(nose, mesh.vertex[3 * i]);
  CrumpleObstacle wall{};
  wall.shape = CRUMPLE_BOX;
  wall.size[0] = 1, wall.size[1] = 5, wall.size[2] = 5;  // m, half extents
  wall.pose = {{double{nose} + 2, 0, 0}, {0, 0, 0, 1}};
  wall.friction = 0.3f;
  return wall;
}

void drive(const char* endpoint, const char* file) {
  crumple::client::Session session({.connect = endpoint, .host = "example", .timeout = std::chrono::seconds(10)});
  const std::string asset = session.add_asset(file);
  CrumpleCarPose car{};
  car.car = "car1";
  car.pose.orientation[3] = 1;
  car.velocity[0] = 14;  // m/s
  CrumpleSpawn spawn{};
  spawn.pose = car.pose;
  spawn.planar = 1;
  car.seen = session.spawn(car.car, asset, spawn);
  const CrumpleObstacle wall = wall_before(session.mesh(asset));
  session.publish({&wall, 1});

  double absorbed = 0;  // J
  auto next = std::chrono::steady_clock::now();
  for (int i = 0; i < 180; ++i) {
    session.publish(i * step, {&car, 1});
    next += std::chrono::microseconds(static_cast<int>(1e6 * step));
    std::this_thread::sleep_until(next);
    session.poll();
    car.pose.position[0] += step * double{car.velocity[0]};
    // Takes over the motion after the crash from the reaction.
    while (const auto reaction = session.next_reaction()) {
      car.pose = reaction->pose;
      std::copy_n(reaction->velocity, 3, car.velocity);
      std::copy_n(reaction->angular_velocity, 3, car.angular_velocity);
      car.seen = reaction->tick;
      absorbed = reaction->energy_absorbed;
    }
  }
  session.despawn(car.car);
  std::printf("%.0f kJ absorbed, %.1f m/s left of 14\n", 1e-3 * absorbed, double{car.velocity[0]});
}

}  // namespace

int main(int count, char** arguments) {
  try {
    if (count != 3) throw crumple::client::Error("usage: host ENDPOINT CARFILE");
    drive(arguments[1], arguments[2]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "host: %s\n", error.what());
    return 1;
  }
}

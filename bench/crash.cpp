// Measures a baked car in crashes with the simulation alone (no network; no clock affects the result):
//   crumple_crash CAR [--long]
// in: a baked car; out: tables in Markdown: walls at four speeds, four tick rates, a slow push of 0.40 m with several numbers
// of sweeps (with --long up to 200), and the five hits of the 1986 Taurus series (NHTSA tests 1201-1205).
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <exception>
#include <limits>

#include "bake/load_car.h"
#include "car/car.h"
#include "sim/deform.h"

namespace {

using namespace crumple;

struct Run {
  const Model& model;
  Parameters parameters;
  Mass mass;
  DeformableState body;
  Motion motion;
  Obstacle wall;
  double nose = -1e9, tail = 1e9, dynamic = 0, peak = 0;
  ScratchHandle scratch = make_scratch();

  explicit Run(const Car& car) : model(car.model), body(make_body(model)) {
    mass = {double(model.mass), model.inertia.cast<double>(), model.center_of_mass.cast<double>(), true};
    for (const Vec3& node : model.node) {
      nose = std::max(nose, double(node.x()));
      tail = std::min(tail, double(node.x()));
    }
    make_box({0.5f, 5, 5}, wall);
    place_wall(0.02);
  }
  void place_wall(double gap) {
    double front = -1e9;
    for (const Vec3& node : body.node) front = std::max(front, double(node.x()));
    wall.pose.position = {front + 0.5 + gap, 0, 0};
  }
  void tick(double rate) {
    const StepResult result = deform({model, parameters, mass, {&wall, 1}, 1 / rate}, *scratch, body, motion);
    wall.pose = advance(wall.pose, wall.velocity, wall.angular_velocity, 1 / rate);
    dynamic = std::max(dynamic, front_crush());
    peak = std::max(peak, result.impulse.norm() / mass.mass * rate / 9.81);
  }
  // The mean over the nodes that form the front face at rest.
  double front_crush() const {
    double sum = 0;
    int count = 0;
    for (size_t i = 0; i < body.node.size(); ++i) {
      if (model.node[i].x() < nose - 0.02) continue;
      sum += model.node[i].x() - body.node[i].x();
      ++count;
    }
    return sum / count;
  }
  // The car drives into the wall with its present damage, from its initial pose.
  void hit(double speed, double rate = 60) {
    place_wall(0.02);
    motion = Motion{};
    motion.velocity = {speed, 0, 0};
    for (int k = 0; k < int(0.5 * rate); ++k) tick(rate);
  }
  double energy() const { return kinetic_energy(motion, mass) + body.absorbed + body.stored; }
};

void walls(const Car& car) {
  std::printf(
      "\n| wall, km/h | dynamic crush, mm | residual, mm | restitution | peak in one tick, g | energy found / brought |\n"
      "|---|---|---|---|---|---|\n");
  for (double speed : {16.0, 32.0, 48.0, 57.0}) {
    Run run(car);
    run.motion.velocity = {speed / 3.6, 0, 0};
    const double brought = run.energy();
    run.hit(speed / 3.6);
    std::printf("| %.0f | %.0f | %.0f | %.3f | %.1f | %.4f |\n", speed, 1e3 * run.dynamic, 1e3 * run.front_crush(),
                -run.motion.velocity.x() / (speed / 3.6), run.peak, run.energy() / brought);
  }
}

void rates(const Car& car) {
  std::printf("\n| ticks a second | 30 | 60 | 120 | 240 |\n|---|---|---|---|---|\n| residual crush at 50 km/h, mm |");
  for (double rate : {30.0, 60.0, 120.0, 240.0}) {
    Run run(car);
    run.hit(50 / 3.6, rate);
    std::printf(" %.1f |", 1e3 * run.front_crush());
  }
  std::printf("\n");
}

void push_once(const Car& car, float friction, int sweeps) {
  Run run(car);
  run.mass.mass = std::numeric_limits<double>::infinity();
  run.mass.inertia.setConstant(run.mass.mass);
  run.parameters.iterations = uint16_t(sweeps);
  run.parameters.tolerance = 0;
  run.wall.friction = friction;
  run.place_wall(0);
  run.wall.velocity = {-0.6, 0, 0};
  for (int k = 0; k < 40; ++k) run.tick(60);
  run.wall.velocity = {1.2, 0, 0};
  for (int k = 0; k < 70 && !(k > 3 && run.body.settled); ++k) run.tick(60);
  double rear = 0, bulge = 0;
  for (size_t i = 0; i < run.body.node.size(); ++i) {
    const Vec3 &rest = run.model.node[i], &now = run.body.node[i];
    if (rest.x() < run.tail + 0.18 * (run.nose - run.tail)) rear = std::max(rear, double((now - rest).norm()));
    bulge = std::max(bulge, double(std::fabs(now.y()) - std::fabs(rest.y())));
  }
  int inverted = 0;
  for (const Tet& tet : run.model.tet) {
    const auto& n = run.body.node;
    const Vec3 &a = n[tet.node[0]], b = n[tet.node[1]] - a, c = n[tet.node[2]] - a, d = n[tet.node[3]] - a;
    inverted += b.cross(c).dot(d) <= 0;
  }
  std::printf("| %.1f | %d | %.1f | %.3f | %.1f | %d |\n", double(friction), sweeps, 1e3 * run.front_crush(), 1e3 * rear,
              1e3 * bulge, inverted);
}

// If the wall holds the front by friction, the front turns about its lower edge and presses the sides out farther than if it
// slides.
void pushes(const Car& car, bool all) {
  std::printf(
      "\n| 0.40 m push in 40 ticks: wall's friction | sweeps | residual, mm | rear moved, mm | side bulge, mm | inverted tets "
      "|\n"
      "|---|---|---|---|---|---|\n");
  for (float friction : {0.3f, 0.0f}) {
    for (int sweeps : {5, 20, 200}) {
      if (sweeps < 200 || all) push_once(car, friction, sweeps);
    }
  }
}

void taurus(const Car& car) {
  constexpr double speed[] = {15.5, 31.9, 32.3, 29.9, 48.3};
  constexpr double measured[] = {63, 206, 359, 465, 753};
  std::printf("\n| hit of the same car, km/h | residual crush, mm | measured on a 1986 Taurus, mm |\n|---|---|---|\n");
  Run run(car);
  run.mass.mass = 1591;
  double squares = 0;
  for (int k = 0; k < 5; ++k) {
    run.hit(speed[k] / 3.6);
    const double crush = 1e3 * run.front_crush();
    squares += std::pow(crush / measured[k] - 1, 2);
    std::printf("| %.1f | %.0f | %.0f |\n", speed[k], crush, measured[k]);
  }
  std::printf("\nroot mean square of the relative difference: %.1f %%\n", 100 * std::sqrt(squares / 5));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2 || std::strcmp(argv[1], "--help") == 0) {
    std::fprintf(stderr, "usage: crumple_crash CAR [--long]   (a baked car: crumple bake; --long: 200 sweeps too, minutes)\n");
    return 2;
  }
  try {
    const auto car = load_car(argv[1]);
    std::printf("%s: %zu nodes, %zu tets; %s\n", car->name.c_str(), car->model.node.size(), car->model.tet.size(),
                car->attribution.c_str());
    walls(*car);
    rates(*car);
    pushes(*car, argc > 2 && std::strcmp(argv[2], "--long") == 0);
    taurus(*car);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple_crash: %s\n", error.what());
    return 1;
  }
}

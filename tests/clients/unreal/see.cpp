// Runs the Unreal sample with a stand-in of Unreal until its car is gone, then prints the deepest dent of the mesh. Also checks
// the laws of its axes.
//   see ENDPOINT CAR
#include <chrono>
#include <cmath>
#include <crumple.hpp>
#include <cstdlib>

#include "CrumpleCarComponent.h"

namespace {

using namespace std::chrono_literals;

void need(bool holds, const char* what) {
  if (holds) return;
  std::fprintf(stderr, "does not hold: %s\n", what);
  std::exit(1);
}

FVector cross(const FVector& a, const FVector& b) {
  return {a.Y * b.Z - a.Z * b.Y, a.Z * b.X - a.X * b.Z, a.X * b.Y - a.Y * b.X};
}
double dot(const FVector& a, const FVector& b) { return a.X * b.X + a.Y * b.Y + a.Z * b.Z; }
double apart(const FVector& a, const FVector& b) { return std::hypot(a.X - b.X, a.Y - b.Y, a.Z - b.Z); }

// v + 2 u x (u x v + w v): this formula holds in right-handed and in left-handed axes.
FVector turn(const FQuat& q, const FVector& v) {
  const FVector u{q.X, q.Y, q.Z}, t = cross(u, v);
  const FVector s = cross(u, {t.X + q.W * v.X, t.Y + q.W * v.Y, t.Z + q.W * v.Z});
  return {v.X + 2 * s.X, v.Y + 2 * s.Y, v.Z + 2 * s.Z};
}

void test_axes() {
  const float forward[] = {1, 0, 0}, left[] = {0, 1, 0}, up[] = {0, 0, 1};
  need(apart(CrumpleAxes::PointToUnreal(forward), {100, 0, 0}) < 1e-9, "forward is x, in cm");
  need(apart(CrumpleAxes::PointToUnreal(left), {0, -100, 0}) < 1e-9, "left is -y");
  need(apart(CrumpleAxes::PointToUnreal(up), {0, 0, 100}) < 1e-9, "up is z");
  const float v[] = {0.3F, -0.7F, 1.9F}, q[] = {0.5F, -0.1F, 0.7F, 0.5F};
  const FVector turned = turn({q[0], q[1], q[2], q[3]}, {v[0], v[1], v[2]});
  const float ours[] = {float(turned.X), float(turned.Y), float(turned.Z)};
  need(apart(CrumpleAxes::DirectionToUnreal(ours), turn(CrumpleAxes::ToUnreal(q), CrumpleAxes::DirectionToUnreal(v))) < 1e-6,
       "turned, then converted, and the other way round");
  const CrumplePose back = CrumpleAxes::FromUnreal(CrumpleAxes::PointToUnreal(v), CrumpleAxes::ToUnreal(q));
  for (int k = 0; k < 4; ++k)
    need(back.orientation[k] == q[k] && (k == 3 || std::fabs(back.position[k] - double{v[k]}) < 1e-9), "a pose comes back");
}

}  // namespace

int main(int count, char** arguments) {
  need(count == 3, "two arguments");
  test_axes();
  crumple::client::Session other({.connect = arguments[1], .timeout = 30s});
  other.follow(arguments[2]);
  const auto begun = [&] {
    auto car = std::make_unique<UCrumpleCarComponent>(FObjectInitializer());
    car->Endpoint = arguments[1];
    car->Car = arguments[2];
    car->Timeout = 30;
    car->BeginPlay();
    return car;
  };
  const auto car = begun();
  const auto frame = [&] {
    car->TickComponent(0.016F, LEVELTICK_All, nullptr);
    other.poll(10ms);
  };
  while (car->drawn.Num() == 0) frame();
  std::printf("drawn\n");
  std::fflush(stdout);
  const TArray<FVector> rest = car->drawn;
  for (bool alive = true; alive; frame())
    if (const auto surface = other.surface(arguments[2])) alive = surface->alive;
  // The shown surface is a tenth of a second old.
  for (const auto end = std::chrono::steady_clock::now() + 500ms; std::chrono::steady_clock::now() < end;) frame();

  double deepest = 0, volume = 0;
  const auto at = [&](int32 corner) { return car->drawn[size_t(car->corners[size_t(corner)])]; };
  for (size_t i = 0; i < rest.all.size(); ++i) {
    deepest = std::max(deepest, apart(car->drawn[i], rest.all[i]));
    need(std::fabs(dot(car->normals[i], car->normals[i]) - 1) < 1e-4, "a normal is of length 1");
  }
  // In left-handed axes the cross product of a counterclockwise front face points to its back.
  for (int32 i = 0; i < car->corners.Num(); i += 3) volume -= dot(at(i), cross(at(i + 1), at(i + 2))) / 6;
  need(volume > 1e6, "front sides look outwards");
  need(car->updates > 3, "it is updated as it dents");
  const auto second = begun();
  second->TickComponent(0.016F, LEVELTICK_All, nullptr);
  for (size_t i = 0; i < rest.all.size(); ++i) need(apart(second->drawn[i], car->drawn[i]) == 0, "a second one draws the same");
  std::printf("deepest dent %.0f mm\n%s\n", 10 * deepest, car->Attribution.c_str());
  car->EndPlay(EEndPlayReason::Destroyed);
}

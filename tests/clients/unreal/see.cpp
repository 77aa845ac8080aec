// Runs the Unreal sample with a stand-in of Unreal until its car is gone, then prints the deepest dent of the mesh. A second
// component draws the car as a mesh of the game. Also checks the laws of the axes.
//   see ENDPOINT CAR
#include <chrono>
#include <cmath>
#include <crumple.hpp>
#include <cstdlib>
#include <numeric>
#include <random>

#include "CrumpleCarComponent.h"

namespace {

using namespace std::chrono_literals;

void need(bool holds, const char* what) {
  if (holds) return;
  std::fprintf(stderr, "does not hold: %s\n", what);
  for (const FString& line : logged) std::fprintf(stderr, "  %s\n", line.c_str());
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

// A mesh of the game that has the shape of the baked car: two sections, all vertices split and in another order, in coordinates
// of its own.
struct Model {
  UStaticMesh mesh;
  FTransform place;              // in the car: turned by 90 degrees, twice as large, and moved
  std::vector<size_t> baked[2];  // for each vertex of a section the vertex of the baked car

  explicit Model(const UProceduralMeshComponent::Drawn& car) {
    place.Row[0] = {0, -2, 0}, place.Row[1] = {2, 0, 0}, place.Row[2] = {0, 0, 2}, place.Origin = {10, 20, -30};
    mesh.name = "Body";
    for (size_t k = 0; k < 2; ++k) {
      auto& [vertices, normals, corners, uvs, tangents] = mesh.section.emplace_back();
      std::vector<size_t> rank;
      for (size_t i = 0; i < car.corners.all.size(); ++i)
        if (i / 3 % 2 == k) rank.push_back(i);
      std::vector<size_t> order(rank.size());
      std::iota(order.begin(), order.end(), size_t{0});
      std::shuffle(order.begin(), order.end(), std::mt19937(3));
      corners.SetNumZeroed(int32(rank.size()));
      for (size_t i = 0; i < order.size(); ++i) {
        const auto b = size_t(car.corners.all[rank[order[i]]]);
        corners[order[i]] = int32(i);
        baked[k].push_back(b);
        const FVector at = car.vertices.all[b] - place.Origin, n = car.normals.all[b];
        vertices.Add({double(float(at.Y / 2)), double(float(-at.X / 2)), double(float(at.Z / 2))});
        normals.Add({n.Y, -n.X, n.Z});
        const FVector across = cross({n.Y, -n.X, n.Z}, {0.3, 0.5, 0.8});
        const double length = std::sqrt(dot(across, across));
        tangents.Add({{across.X / length, across.Y / length, across.Z / length}, i % 3 == 0});
        uvs.Add({0.001 * double(i), 0.25});
      }
    }
  }

  // Compares what a component draws with this mesh, moved as the vertices of the baked car from `rest` to `car`, cm.
  void compare(UProceduralMeshComponent& drawn, const TArray<FVector>& rest, const UProceduralMeshComponent::Drawn& car) {
    need(drawn.section.size() == 2, "both sections are drawn");
    for (size_t k = 0; k < 2; ++k) {
      size_t alike = 0;  // normals
      const auto &given = mesh.section[k], &is = drawn.section.at(int32(k));
      need(is.corners.all == given.corners.all, "the triangles stay");
      need(drawn.GetMaterial(int32(k)) == &mesh.material[k], "the material stays");
      for (size_t i = 0; i < baked[k].size(); ++i) {
        const FVector own = place.TransformPosition(is.vertices.all[i]) - place.TransformPosition(given.vertices.all[i]);
        need(apart(own, car.vertices.all[baked[k][i]] - rest.all[baked[k][i]]) < 1e-3, "a vertex moves as the baked one");
        need(is.uvs.all[i].X == given.uvs.all[i].X && is.uvs.all[i].Y == given.uvs.all[i].Y, "texture coordinates stay");
        const FProcMeshTangent &tangent = is.tangents.all[i], &before = given.tangents.all[i];
        need(tangent.bFlipTangentY == before.bFlipTangentY, "the side of a binormal stays");
        need(std::fabs(dot(tangent.TangentX, tangent.TangentX) - 1) < 1e-4, "a tangent is of length 1");
        need(std::fabs(dot(is.normals.all[i], is.normals.all[i]) - 1) < 1e-4, "an own normal is of length 1");
        need(std::fabs(dot(is.normals.all[i], tangent.TangentX)) < 1e-3, "they turn together");
        const FVector& n = car.normals.all[baked[k][i]];
        alike += apart(is.normals.all[i], {n.Y, -n.X, n.Z}) < 1e-3;
      }
      // At an edge the library turns a normal with fewer triangles.
      need(alike > baked[k].size() / 2, "normals turn as those of the baked car");
    }
  }
  void compare_at_rest(UProceduralMeshComponent& drawn) {
    for (size_t k = 0; k < 2; ++k)
      for (size_t i = 0; i < baked[k].size(); ++i) {
        const auto &given = mesh.section[k], &is = drawn.section.at(int32(k));
        need(apart(is.vertices.all[i], given.vertices.all[i]) == 0, "the numbers at rest");
        need(apart(is.normals.all[i], given.normals.all[i]) < 1e-5, "the normals at rest");
        need(apart(is.tangents.all[i].TangentX, given.tangents.all[i].TangentX) < 1e-5, "the tangents at rest");
      }
  }
};

}  // namespace

int main(int count, char** arguments) {
  need(count == 3, "two arguments");
  test_axes();
  crumple::client::Session other({.connect = arguments[1], .timeout = 30s});
  other.follow(arguments[2]);
  const auto begun = [&](UStaticMesh* mesh, const FTransform& place) {
    auto car = std::make_unique<UCrumpleCarComponent>(FObjectInitializer());
    car->Endpoint = arguments[1];
    car->Car = arguments[2];
    car->Timeout = 30;
    car->OwnMesh = mesh;
    car->place = place;
    car->BeginPlay();
    return car;
  };
  const auto car = begun(nullptr, {});
  std::unique_ptr<UCrumpleCarComponent> own;
  const auto frame = [&] {
    car->TickComponent(0.016F, LEVELTICK_All, nullptr);
    if (own) own->TickComponent(0.016F, LEVELTICK_All, nullptr);
    other.poll(10ms);
  };
  while (car->section.empty()) frame();
  UProceduralMeshComponent::Drawn& drawn = car->section[0];
  const TArray<FVector> rest = drawn.vertices;
  Model model(drawn);
  own = begun(&model.mesh, model.place);
  while (own->section.empty()) frame();
  model.compare(*own, rest, drawn);
  model.compare_at_rest(*own);
  need(logged.empty(), "a mesh that fits is told nothing about");
  std::printf("drawn\n");
  std::fflush(stdout);
  for (bool alive = true; alive; frame())
    if (const auto surface = other.surface(arguments[2])) alive = surface->alive;
  // The shown surface is a tenth of a second old.
  for (const auto end = std::chrono::steady_clock::now() + 500ms; std::chrono::steady_clock::now() < end;) frame();
  model.compare(*own, rest, drawn);
  need(own->updates > 3, "a mesh of the game is updated as it dents");

  double deepest = 0, volume = 0;
  const auto at = [&](int32 corner) { return drawn.vertices[drawn.corners[corner]]; };
  for (size_t i = 0; i < rest.all.size(); ++i) {
    deepest = std::max(deepest, apart(drawn.vertices[i], rest.all[i]));
    need(std::fabs(dot(drawn.normals[i], drawn.normals[i]) - 1) < 1e-4, "a normal is of length 1");
  }
  // In left-handed axes the cross product of a counterclockwise front face points to its back.
  for (int32 i = 0; i < drawn.corners.Num(); i += 3) volume -= dot(at(i), cross(at(i + 1), at(i + 2))) / 6;
  need(volume > 1e6, "front sides look outwards");
  need(car->updates > 3, "it is updated as it dents");
  const auto second = begun(nullptr, {});
  second->TickComponent(0.016F, LEVELTICK_All, nullptr);
  for (size_t i = 0; i < rest.all.size(); ++i)
    need(apart(second->section[0].vertices[i], drawn.vertices[i]) == 0, "a second one draws the same");

  // What does not fit is named.
  model.mesh.section.emplace_back();  // as Unreal gives it if the game may not read the mesh
  FTransform away = model.place, flat = model.place;
  away.Origin.X += 500;
  flat.Row[2] = {};
  for (const FTransform& each : {away, flat}) begun(&model.mesh, each)->TickComponent(0.016F, LEVELTICK_All, nullptr);
  const auto is_logged = [](const char* part) {
    return std::any_of(logged.begin(), logged.end(), [&](const FString& line) { return line.find(part) != FString::npos; });
  };
  need(is_logged("a vertex of section 1 of mesh Body is 5."), "a section that is far away");
  need(is_logged("section 2 of mesh Body gives no vertices; set \"Allow CPU Access\""), "a section without vertices");
  need(is_logged("section 0 of mesh Body is not drawn: to_car has no inverse"), "a section without a place");
  std::printf("deepest dent %.0f mm\n%s\n", 10 * deepest, car->Attribution.c_str());
  car->EndPlay(EEndPlayReason::Destroyed);
}

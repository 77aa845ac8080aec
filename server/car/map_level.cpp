#include "car/map_level.h"

#include <cstring>

#include "car/build_skin.h"

namespace crumple {
namespace {

template <class T>
bool same(std::span<const T> a, std::span<const T> b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size_bytes()) == 0;
}

}  // namespace

bool same_surface(const Car& a, const Car& b) {
  return same(a.model.vertex, b.model.vertex) && same(a.model.triangle, b.model.triangle) && a.regions == b.regions;
}

LevelMap map_level(const Model& from, const Model& to) {
  const TetMesh mesh{{from.node.begin(), from.node.end()}, {from.tet.begin(), from.tet.end()}};
  std::vector<Vec3> middle;
  for (const Tet& tet : to.tet) {
    const uint32_t* n = tet.node;
    middle.push_back(0.25f * (to.node[n[0]] + to.node[n[1]] + to.node[n[2]] + to.node[n[3]]));
  }
  return {build_skin(mesh, to.node).skin, build_skin(mesh, middle).tet};
}

}  // namespace crumple

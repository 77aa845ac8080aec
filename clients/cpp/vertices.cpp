// Converts a surface for an engine: writes positions and normals of the vertices into the caller's buffer, computed from the
// displacements of the skin's nodes, and reports which vertices have changed.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>

#include "cpp/session.h"

using namespace crumple::client;
using crumple::schema::PartKind;

namespace {

// Ticks between two messages of a deforming car, by surface level: the time of the interpolation to the next shape.
constexpr double interval[2] = {1, 6};

// Writes the displacements of the skin's nodes at a time, in ticks. Returns the quantum in which it wrote them, m.
float nodes_at(const FollowedCar& car, const std::deque<Past>& past, double tick, std::vector<float>& out) {
  const auto next =
      std::find_if(past.begin(), past.end(), [&](const Past& each) { return static_cast<double>(each.tick) >= tick; });
  const bool between = tick > 0 && next != past.end();
  const Quanta& to = between ? next->quanta : car.surface.quanta;
  out.assign(to.begin(), to.end());
  if (!between) return car.surface.quantum;
  const double left = (static_cast<double>(next->tick) - tick) / interval[car.level];
  if (next == past.begin() || left <= 0) return next->quantum;
  const Past& last = *std::prev(next);
  const auto share = static_cast<float>(std::min(left, 1.0));
  for (size_t i = 0; i < out.size(); ++i)
    out[i] += share * (last.quantum / next->quantum * static_cast<float>(last.quanta[i]) - out[i]);
  return next->quantum;
}

bool is_wheel(const Asset& asset, size_t part) { return asset.parts.part[part].kind == PartKind::wheel; }

// The part of a vertex, if that is a wheel, else 0.
uint8_t wheel_of(const Asset& asset, size_t vertex) {
  if (asset.parts.of_vertex.empty()) return 0;
  const uint8_t part = asset.parts.of_vertex[vertex];
  return is_wheel(asset, part) ? part : 0;
}

void move_wheels(const Asset& asset, const std::vector<float>& node, float quantum, std::vector<Motion>& out) {
  out.assign(asset.parts.part.size(), {});
  for (size_t k = 0; k < out.size(); ++k)
    if (is_wheel(asset, k)) out[k] = motion_of(asset.around[k], asset.rest, node, quantum);
}

void displace(const Asset& asset, const std::vector<float>& node, float quantum, const std::vector<Motion>& motion,
              std::vector<float>& out) {
  out.resize(3 * asset.skin.size());
  for (size_t i = 0; i < asset.skin.size(); ++i) {
    if (const uint8_t wheel = wheel_of(asset, i)) {
      const float* at = asset.mesh.vertex + 3 * i;
      std::ranges::copy(motion[wheel].displacement({at[0], at[1], at[2]}), &out[3 * i]);
      continue;
    }
    const SkinVertex& vertex = asset.skin[i];
    for (size_t axis = 0; axis < 3; ++axis) {
      float sum = 0;
      for (size_t k = 0; k < 4; ++k) sum += vertex.weight[k] * node[3 * vertex.at[k] + axis];
      out[3 * i + axis] = quantum * sum;
    }
  }
}

// The cross product of two edges of a triangle is its normal, with a length of twice its area.
void find_normals(const CrumpleMesh& mesh, const std::vector<float>& position, std::vector<float>& out) {
  out.assign(position.size(), 0);
  for (const uint32_t* corner = mesh.triangle; corner != mesh.triangle + 3 * size_t{mesh.triangle_count}; corner += 3) {
    const float *a = &position[3 * size_t{corner[0]}], *b = &position[3 * size_t{corner[1]}],
                *c = &position[3 * size_t{corner[2]}];
    const float u[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]}, v[3] = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
    const float cross[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    for (size_t k = 0; k < 3; ++k) {
      float* sum = &out[3 * size_t{corner[k]}];
      sum[0] += cross[0];
      sum[1] += cross[1];
      sum[2] += cross[2];
    }
  }
  for (float* normal = out.data(); normal != out.data() + out.size(); normal += 3) {
    const float square = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
    const bool flat = !(square > 0);  // no triangle here has an area, but a normal is needed
    const float scale = flat ? 0 : 1 / std::sqrt(square);
    normal[0] *= scale;
    normal[1] *= scale;
    normal[2] = flat ? 1 : normal[2] * scale;
  }
}

// Finds vertices that moved since the last copy, and those that share a triangle with one, because their normals turn.
void mark(const Asset& asset, const std::vector<float>& now, const std::vector<float>& before, std::vector<uint8_t>& moved) {
  moved.assign(asset.skin.size(), before.empty());
  if (before.empty() || before == now) return;
  const auto differs = [&](uint32_t node) {
    return std::memcmp(&now[size_t{3} * node], &before[size_t{3} * node], 3 * sizeof(float)) != 0;
  };
  constexpr uint8_t itself = 1, neighbour = 2;
  std::vector<uint8_t> rolled(asset.parts.part.size(), 0);
  for (size_t k = 0; k < rolled.size(); ++k)
    if (is_wheel(asset, k)) rolled[k] = std::ranges::any_of(asset.around[k].node, differs);
  for (size_t i = 0; i < moved.size(); ++i) {
    if (const uint8_t wheel = wheel_of(asset, i)) {
      moved[i] = rolled[wheel] ? itself : 0;
      continue;
    }
    for (size_t k = 0; k < 4; ++k)
      if (asset.skin[i].weight[k] > 0 && differs(asset.skin[i].at[k])) moved[i] = itself;
  }
  const uint32_t* triangle = asset.mesh.triangle;
  for (size_t t = 0; t < 3 * size_t{asset.mesh.triangle_count}; t += 3) {
    const uint32_t a = triangle[t], b = triangle[t + 1], c = triangle[t + 2];
    if (!((moved[a] | moved[b] | moved[c]) & itself)) continue;
    for (const uint32_t vertex : {a, b, c}) moved[vertex] |= neighbour;
  }
}

std::span<const Point> points(const float* first, size_t count) {
  static_assert(sizeof(Point) == 3 * sizeof(float));
  return {reinterpret_cast<const Point*>(first), count};
}

std::span<const Corners> triangles(const CrumpleMesh& mesh) {
  static_assert(sizeof(Corners) == 3 * sizeof(uint32_t));
  return {reinterpret_cast<const Corners*>(mesh.triangle), mesh.triangle_count};
}

// Writes the vertices of a game's own mesh. cross: of the surface's triangles now, if normals or tangents are wanted.
void write_own(const OwnMesh& own, std::span<const Point> displacement, std::span<const Point> cross,
               std::span<const Motion> motion, const CrumpleVertices& out, size_t count) {
  const size_t step = out.stride / sizeof(float);
  const Rows normals_from_car = transposed(own.to_car);  // a matrix turns normals by the transpose of its inverse
  const auto put = [&](float* to, size_t i, const Point& value) { std::copy_n(value.data(), 3, to + step * i); };
  for (size_t i = 0; i < count; ++i) {
    if (out.position || out.displacement) {
      const Point moved = own.from_car * displacement_of(own.mapping, i, displacement);
      const Point& rest = own.position[i];
      if (out.position) put(out.position, i, {rest[0] + moved[0], rest[1] + moved[1], rest[2] + moved[2]});
      if (out.displacement) put(out.displacement, i, moved);
    }
    if (cross.empty()) continue;
    const Turn turn = turn_of(own.mapping, i, cross);
    const Point& normal = own.normal.empty() ? own.mapping.facing[i] : own.normal[i];
    if (out.normal) put(out.normal, i, unit(normals_from_car * turn(normal)));
    if (out.tangent && !own.tangent.empty()) put(out.tangent, i, unit(own.from_car * turn(own.tangent[i])));
  }
  for (const auto& [i, part, at] : own.on_wheel) {
    if (i >= count) break;
    const Point moved = own.from_car * motion[part].displacement(at);
    const Point& rest = own.position[i];
    if (out.position) put(out.position, i, {rest[0] + moved[0], rest[1] + moved[1], rest[2] + moved[2]});
    if (out.displacement) put(out.displacement, i, moved);
    const Point& normal = own.normal.empty() ? own.mapping.facing[i] : own.normal[i];
    if (out.normal) put(out.normal, i, unit(normals_from_car * motion[part].turned(normal)));
    if (out.tangent && !own.tangent.empty()) put(out.tangent, i, unit(own.from_car * motion[part].turned(own.tangent[i])));
  }
}

// The car whose vertices a caller wants, if its surface and its mesh are there.
struct Shape {
  const FollowedCar* car = nullptr;
  ShownCar* shown = nullptr;
  CrumpleMesh mesh{};
  const Asset* asset = nullptr;
};
int find_shape(Crumple* session, const char* id, double time, Shape& out) {
  const auto at = session->following.cars.find(id);
  if (at == session->following.cars.end())
    return fail(CRUMPLE_UNKNOWN, std::string("car ") + id + " is not followed: call crumple_follow");
  out.car = &at->second;
  out.shown = &session->shown[at->first];
  if (!held(*out.car)) return CRUMPLE_PENDING;
  if (std::isnan(time)) return fail(CRUMPLE_BAD_ARGUMENT, "time is not a number");
  const Surface& surface = out.car->surface;
  if (time != 0 && out.shown->past.empty()) remember(surface, *out.shown, session->clock.rate);
  if (const int status = mesh_of(session, surface.asset.c_str(), &out.mesh); status != CRUMPLE_OK) return status;
  out.asset = &session->assets.at(surface.asset);
  if (surface.quanta.size() != size_t{3} * out.asset->skin_nodes)
    return fail(CRUMPLE_NO_ANSWER,
                "the surface of car " + std::string(id) + " and the skin of its asset have different numbers of nodes");
  return CRUMPLE_OK;
}

void write(const std::vector<float>& from, const CrumpleVertices& out, size_t count, float* to) {
  const size_t step = out.stride / sizeof(float);
  for (size_t i = 0; to && i < count; ++i) std::copy_n(&from[3 * i], 3, to + step * i);
}

}  // namespace

void crumple::client::remember(const Surface& surface, ShownCar& shown, double rate) {
  std::deque<Past>& past = shown.past;
  if (!past.empty() && (surface.tick <= past.back().tick || surface.quanta.size() != past.back().quanta.size())) past.clear();
  past.push_back({surface.tick, surface.quantum, surface.quanta});
  // One older surface stays, because it was the surface until the next one.
  while (past.size() > 2 && static_cast<double>(surface.tick - past[1].tick) > past_kept * rate) past.pop_front();
}

int crumple_copy(Crumple* handle, const char* id, CrumpleVertices* out) {
  return with(handle, {{"car", id}, {"out", out}}, [&](Crumple* session) -> int {
    if (out->stride < 12 || out->stride % 4 != 0 || out->stride > stride_limit)
      return fail(CRUMPLE_BAD_ARGUMENT, "stride is not a multiple of 4 from 12 to 4096");
    if (out->mapping > session->own.size()) return fail(CRUMPLE_BAD_ARGUMENT, "mapping is none that crumple_map gave");
    Shape shape;
    if (const int status = find_shape(session, id, out->time, shape); status != CRUMPLE_OK) return status;
    const FollowedCar& car = *shape.car;
    const Surface& surface = car.surface;
    ShownCar& shown = *shape.shown;
    const CrumpleMesh& mesh = shape.mesh;
    const Asset& asset = *shape.asset;

    const OwnMesh* own = out->mapping ? &session->own[out->mapping - 1] : nullptr;
    if (own && own->asset != surface.asset)
      return fail(CRUMPLE_BAD_ARGUMENT, "the mapping is for asset " + own->asset + ", and car " + id + " has " + surface.asset);
    const size_t count = std::min(out->capacity, own ? own->position.size() : asset.skin.size());
    std::vector<float>&displacement = session->displacement, &position = session->position;
    const float quantum = nodes_at(car, shown.past, out->time * session->clock.rate, session->node);
    move_wheels(asset, session->node, quantum, session->motion);
    displace(asset, session->node, quantum, session->motion, displacement);
    position.resize(displacement.size());
    std::transform(displacement.begin(), displacement.end(), mesh.vertex, position.begin(), std::plus<>());
    const size_t vertices = asset.skin.size();
    if (own) {
      session->cross.clear();
      if (out->normal || out->tangent) find_crosses(points(position.data(), vertices), triangles(mesh), session->cross);
      write_own(*own, points(displacement.data(), vertices), session->cross, session->motion, *out, count);
    } else {
      if (out->normal) find_normals(mesh, position, session->normal);
      write(position, *out, count, out->position);
      write(displacement, *out, count, out->displacement);
      write(session->normal, *out, count, out->normal);
    }

    ShownCar::Copied& copied = shown.copied[out->mapping];
    if (copied.asset != surface.asset || copied.quantum != quantum) copied.node.clear();
    mark(asset, session->node, copied.node, session->moved);
    if (own) {
      std::vector<uint8_t> moved(own->position.size());
      for (size_t i = 0; i < moved.size(); ++i)
        for (size_t k = 0; k < 3; ++k)
          if (own->mapping.weight[i][k] != 0) moved[i] |= session->moved[own->mapping.corner[i][k]];
      session->moved.swap(moved);
    }
    const auto begin = session->moved.begin(), end = begin + static_cast<ptrdiff_t>(count);
    const auto is_moved = [](uint8_t how) { return how != 0; };
    const auto first = std::find_if(begin, end, is_moved);
    const auto last = std::find_if(std::make_reverse_iterator(end), std::make_reverse_iterator(first), is_moved).base();
    out->first = first == end ? 0 : static_cast<uint32_t>(first - begin);
    out->count = static_cast<uint32_t>(last - first);
    copied.asset = surface.asset;
    copied.quantum = quantum;
    copied.node.swap(session->node);
    const bool newest = out->time <= 0 || out->time * session->clock.rate >= static_cast<double>(surface.tick);
    shown.dirty &= !newest;
    return CRUMPLE_OK;
  });
}

int crumple_part_pose(Crumple* handle, const char* id, uint32_t part, double time, CrumplePose* out) {
  return with(handle, {{"car", id}, {"out", out}}, [&](Crumple* session) -> int {
    Shape shape;
    if (const int status = find_shape(session, id, time, shape); status != CRUMPLE_OK) return status;
    const Asset& asset = *shape.asset;
    if (part >= asset.parts.part.size())
      return fail(CRUMPLE_BAD_ARGUMENT,
                  "the car has " + std::to_string(asset.parts.part.size()) + " parts: crumple_parts lists them");
    const float quantum = nodes_at(*shape.car, shape.shown->past, time * session->clock.rate, session->node);
    const Place place = place_of(asset.parts.part[part], motion_of(asset.around[part], asset.rest, session->node, quantum));
    std::ranges::copy(place.position, out->position);
    std::ranges::transform(place.orientation, out->orientation, [](double x) { return static_cast<float>(x); });
    return CRUMPLE_OK;
  });
}

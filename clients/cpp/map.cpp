// Maps a mesh that the game draws itself to the surface of a baked car.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>

#include "cpp/session.h"
#include "schema/car_generated.h"

using namespace crumple::client;

namespace {

using Matrix = std::array<double, 12>;  // the rows of a 3 x 4 matrix

// Returns the matrix to the car's frame that the caller or the car gives.
std::optional<Matrix> matrix_of(const CrumpleOwnMesh& mesh, const Asset& asset) {
  Matrix out;
  if (mesh.to_car) {
    std::copy_n(mesh.to_car, 12, out.begin());
  } else {
    const auto* stored = crumple::schema::GetCar(asset.baked.bytes().data())->source_to_car();
    if (!stored || stored->size() != 12) return {};
    std::memcpy(out.data(), stored->Data(), sizeof out);  // a hostile car may not have it aligned
  }
  return out;
}

double determinant(const Matrix& m) {
  return m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) + m[2] * (m[4] * m[9] - m[5] * m[8]);
}

void set_linear(const Matrix& m, OwnMesh& own) {
  const double size = determinant(m);
  for (size_t row = 0; row < 3; ++row)
    for (size_t k = 0; k < 3; ++k) {
      own.to_car[row][k] = static_cast<float>(m[4 * row + k]);
      const size_t a = (k + 1) % 3, b = (k + 2) % 3, c = (row + 1) % 3, d = (row + 2) % 3;
      own.from_car[row][k] = static_cast<float>((m[4 * a + c] * m[4 * b + d] - m[4 * a + d] * m[4 * b + c]) / size);
    }
}

// Reads vertex i of a strided list.
Point at(const float* first, size_t stride, size_t i) {
  Point out;
  std::memcpy(out.data(), reinterpret_cast<const char*>(first) + stride * i, sizeof out);
  return out;
}

bool finite(const Point& p) { return std::isfinite(p[0]) && std::isfinite(p[1]) && std::isfinite(p[2]); }

// Adds the direction of vertex i in the car's frame. False: it has none.
bool turned(const float* first, size_t stride, size_t i, const Rows& to_car, std::vector<Point>& out) {
  const Point given = to_car * at(first, stride, i);
  out.push_back(unit(given));
  return finite(given) && finite(out.back()) && given != Point{};
}

// Returns why the mesh cannot be mapped, or an empty text.
std::string read(const CrumpleOwnMesh& mesh, const Matrix& to_car, OwnMesh& own, std::vector<Point>& placed) {
  set_linear(to_car, own);
  const Rows normals_to_car = transposed(own.from_car);  // a matrix turns normals by the transpose of its inverse
  for (size_t i = 0; i < mesh.count; ++i) {
    const Point p = own.position.emplace_back(at(mesh.position, mesh.stride, i));
    Point& out = placed.emplace_back();
    for (size_t row = 0; row < 3; ++row) {
      const double* m = &to_car[4 * row];
      out[row] = static_cast<float>(m[0] * double(p[0]) + m[1] * double(p[1]) + m[2] * double(p[2]) + m[3]);
    }
    if (!finite(out)) return "vertex " + std::to_string(i) + " is not a finite number in the car's frame";
    if (mesh.normal && !turned(mesh.normal, mesh.stride, i, normals_to_car, own.normal))
      return "the normal of vertex " + std::to_string(i) + " has no direction";
    if (mesh.tangent && !turned(mesh.tangent, mesh.stride, i, own.to_car, own.tangent))
      return "the tangent of vertex " + std::to_string(i) + " has no direction";
  }
  return {};
}

}  // namespace

int crumple_map(Crumple* handle, const char* hash, CrumpleOwnMesh* mesh, uint32_t* mapping) {
  return with(handle, {{"asset", hash}, {"mesh", mesh}, {"mapping", mapping}}, [&](Crumple* session) -> int {
    if (!mesh->position) return fail(CRUMPLE_BAD_ARGUMENT, "position is NULL");
    if (mesh->stride < 12 || mesh->stride % 4 != 0 || mesh->stride > stride_limit)
      return fail(CRUMPLE_BAD_ARGUMENT, "stride is not a multiple of 4 from 12 to 4096");
    if (mesh->count == 0 || mesh->count > mapped_limit)
      return fail(CRUMPLE_BAD_ARGUMENT, "count is not from 1 to 4 million vertices");
    if (session->own.size() >= mapping_limit)
      return fail(CRUMPLE_BAD_ARGUMENT, "the session has 1024 mappings already: map each mesh once, not once per car");
    CrumpleMesh surface;
    if (const int status = mesh_of(session, hash, &surface); status != CRUMPLE_OK) return status;
    const Asset& asset = session->assets.find(std::string_view(hash))->second;
    const auto to_car = matrix_of(*mesh, asset);
    if (!to_car)
      return fail(CRUMPLE_BAD_ARGUMENT, "asset " + std::string(hash) +
                                            " does not say where its source's coordinates are: give to_car, or bake it again");
    const double size = determinant(*to_car);
    if (!std::isfinite(size) || std::abs(size) < 1e-12)
      return fail(CRUMPLE_BAD_ARGUMENT, "to_car has no inverse, or holds a number that is not finite");
    OwnMesh own;
    own.asset = hash;
    std::vector<Point> placed;
    if (const std::string why = read(*mesh, *to_car, own, placed); !why.empty()) return fail(CRUMPLE_BAD_ARGUMENT, why);
    const auto* vertex = reinterpret_cast<const Point*>(surface.vertex);
    const auto* triangle = reinterpret_cast<const Corners*>(surface.triangle);
    own.mapping = map_vertices({vertex, surface.vertex_count}, {triangle, surface.triangle_count}, placed, own.normal);
    for (size_t i = 0; i < placed.size() && !asset.parts.part.empty(); ++i) {
      const uint8_t part = asset.parts.of_vertex[own.mapping.corner[i][0]];
      if (asset.parts.part[part].kind == crumple::schema::PartKind::wheel) own.on_wheel.push_back({i, part, placed[i]});
    }
    mesh->on_vertices = own.mapping.on_vertices;
    mesh->farthest = *std::max_element(own.mapping.distance.begin(), own.mapping.distance.end());
    session->own.push_back(std::move(own));
    *mapping = static_cast<uint32_t>(session->own.size());
    return CRUMPLE_OK;
  });
}

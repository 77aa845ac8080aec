#include "bake/fill_surface.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace crumple {
namespace {

// Voxels along the longest side. With the margin no grid has more than 210^3 = 9.3 million, 30 bytes each while it is filled.
constexpr double voxels_along = 170;
constexpr double sealing_radius = 0.08;      // of the longest side: 0.36 m on a car of 4.5 m
constexpr double sealing_given_back = 0.42;  // of the radius: the fillets of the ball, sqrt(2) - 1 of it in a right corner
constexpr double leaks = 2;                  // voxels: a gap of twice this lets nothing in
constexpr int most_sky = 2;                  // directions
constexpr double sky_given_back = 3;         // voxels
constexpr double holds_water = 0.95;
constexpr double sample_spacing = 0.6;  // voxels: no ray slips between two samples' voxels and their neighbours
// A car has a million. More is the same sheet many times over, and would take minutes.
constexpr double most_samples = 2e8;

// ---- triangles into voxels ---------------------------------------------------------------------------------------------

struct Rows {  // of points parallel to the longest edge, from it to the opposite corner
  Eigen::Vector3d a, b, c;
  double length;
  int count;
};

Rows rows_of(std::span<const Vec3> vertices, const Triangle& triangle, double spacing) {
  Eigen::Vector3d corner[3];
  for (int k = 0; k < 3; ++k) corner[k] = vertices[triangle[k]].cast<double>();
  int longest = 0;
  double squared[3];
  for (int k = 0; k < 3; ++k) {
    squared[k] = (corner[(k + 1) % 3] - corner[k]).squaredNorm();
    if (squared[k] > squared[longest]) longest = k;
  }
  Rows out{corner[longest], corner[(longest + 1) % 3], corner[(longest + 2) % 3], std::sqrt(squared[longest]), 0};
  // The other edges are at most `spacing` long from row to row.
  out.count = static_cast<int>(std::sqrt(std::max(squared[(longest + 1) % 3], squared[(longest + 2) % 3])) / spacing) + 1;
  return out;
}

double count_samples(const Rows& rows, double spacing) { return (rows.length / spacing / 2 + 2) * (rows.count + 1); }

template <class Take>
void sample_triangle(const Rows& rows, double spacing, const Take& take) {
  for (int j = 0; j <= rows.count; ++j) {
    const double t = double(j) / rows.count;
    const Eigen::Vector3d from = rows.a + t * (rows.c - rows.a), to = rows.b + t * (rows.c - rows.b);
    const int steps = static_cast<int>((1 - t) * rows.length / spacing) + 1;
    for (int i = 0; i <= steps; ++i) take(from + double(i) / steps * (to - from));
  }
}

// One point in each half voxel that the triangles cross: the first that comes.
std::vector<Eigen::Vector3d> sample_surface(std::span<const Vec3> vertices, std::span<const Triangle> triangles,
                                            const Voxels& voxels, const std::string& name) {
  const double spacing = sample_spacing * voxels.size;
  double count = 0;
  for (const Triangle& triangle : triangles) count += count_samples(rows_of(vertices, triangle, spacing), spacing);
  if (count > most_samples)
    throw std::runtime_error(name + ": its " + std::to_string(triangles.size()) +
                             " triangles cover the car many hundred times over; keep one copy of each part.");
  const Eigen::Vector3d corner = voxels.origin.array() - voxels.size / 2;
  const size_t nx = 2 * size_t(voxels.count[0]), ny = 2 * size_t(voxels.count[1]);
  std::vector<uint64_t> taken((8 * voxels.total() + 63) / 64, 0);  // a bit for each half voxel
  std::vector<Eigen::Vector3d> out;
  for (const Triangle& triangle : triangles)
    sample_triangle(rows_of(vertices, triangle, spacing), spacing, [&](const Eigen::Vector3d& point) {
      const Eigen::Vector3d g = (point - corner) * (2 / voxels.size);
      const size_t at = (size_t(g.z()) * ny + size_t(g.y())) * nx + size_t(g.x());
      uint64_t& word = taken[at / 64];
      const uint64_t bit = uint64_t{1} << at % 64;
      if (word & bit) return;
      word |= bit;
      out.push_back(point);
    });
  return out;
}

Mask occupied(const Voxels& voxels, const std::vector<Eigen::Vector3d>& points) {
  Mask out(voxels.total(), 0);
  for (const Eigen::Vector3d& point : points) {
    const Eigen::Vector3d g = (point - voxels.origin) / voxels.size;
    out[voxels.index(int(g.x() + 0.5), int(g.y() + 0.5), int(g.z() + 0.5))] = 1;
  }
  return out;
}

// ---- what is solid -----------------------------------------------------------------------------------------------------

// The free voxels that hang together with the first one, by faces.
Mask flood(const Voxels& voxels, const Mask& free) {
  Mask out(voxels.total(), 0);
  std::vector<uint32_t> front = {0};
  out[0] = 1;
  const auto reach = [&](uint32_t v) {
    if (!free[v] || out[v]) return;
    out[v] = 1;
    front.push_back(v);
  };
  const auto nx = uint32_t(voxels.count[0]), ny = uint32_t(voxels.count[1]), nz = uint32_t(voxels.count[2]);
  while (!front.empty()) {
    const uint32_t v = front.back(), x = v % nx, y = v / nx % ny, z = v / (nx * ny);
    front.pop_back();
    if (x > 0) reach(v - 1);
    if (x + 1 < nx) reach(v + 1);
    if (y > 0) reach(v - nx);
    if (y + 1 < ny) reach(v + nx);
    if (z > 0) reach(v - nx * ny);
    if (z + 1 < nz) reach(v + nx * ny);
  }
  return out;
}

// The voxels within (or, with `beyond`, beyond) a distance from those of the mask. radius: voxels.
Mask near_to(const Voxels& voxels, const Mask& mask, double radius, bool beyond = false) {
  const std::vector<int32_t> squared = squared_distances(voxels, mask, true);
  Mask out(squared.size());
  for (size_t v = 0; v < out.size(); ++v) out[v] = (squared[v] > radius * radius) == beyond;
  return out;
}

// What no ball of this radius, in voxels, can reach that rolls in from outside.
Mask unreached(const Voxels& voxels, const Mask& solid, double radius) {
  Mask reached = near_to(voxels, flood(voxels, near_to(voxels, solid, radius, true)), radius);
  for (uint8_t& v : reached) v = !v;
  return reached;
}

// Voxels that lie deeper than this in the mask. depth: voxels.
Mask eroded(const Voxels& voxels, Mask mask, double depth) {
  for (uint8_t& v : mask) v = !v;
  return near_to(voxels, mask, depth, true);
}

// Of a voxel's sky, the directions that are free; not downward. Sheets are made thicker first, or a slanted ray slips through.
Mask count_sky(const Voxels& voxels, const Mask& solid) {
  const Mask thick = near_to(voxels, solid, 1.75);  // the 26 around each, the square of whose distance is 3 at most
  Mask out(voxels.total(), 0), blocked(voxels.total());
  const auto [nx, ny, nz] = voxels.count;
  for (int dz = 0; dz <= 1; ++dz)
    for (int dy = -1; dy <= 1; ++dy)
      for (int dx = -1; dx <= 1; ++dx) {
        if (!dx && !dy && !dz) continue;
        // Each voxel after the one that it looks to.
        for (int k = 0; k < nz; ++k)
          for (int j = 0; j < ny; ++j)
            for (int i = 0; i < nx; ++i) {
              const int x = dx > 0 ? nx - 1 - i : i, y = dy > 0 ? ny - 1 - j : j, z = dz > 0 ? nz - 1 - k : k;
              const int u = x + dx, v = y + dy, w = z + dz;
              const bool within = u >= 0 && u < nx && v >= 0 && v < ny && w < nz;
              const size_t own = voxels.index(x, y, z), next = within ? voxels.index(u, v, w) : 0;
              blocked[own] = within && (thick[next] || blocked[next]);
              out[own] = static_cast<uint8_t>(out[own] + !blocked[own]);
            }
      }
  return out;
}

size_t count_set(const Mask& mask) { return size_t(std::count(mask.begin(), mask.end(), uint8_t{1})); }

void join(Mask& mask, const Mask& other) {
  for (size_t v = 0; v < mask.size(); ++v) mask[v] |= other[v];
}

// What is sealed in any case: deep inside the great ball's hull, or deep under a roof.
Mask sealed_core(const Voxels& voxels, const Mask& surface, double radius) {
  Mask core = eroded(voxels, unreached(voxels, surface, radius), sealing_given_back * radius + 1);
  Mask roofed = count_sky(voxels, surface);
  for (uint8_t& v : roofed) v = v <= most_sky;
  join(core, eroded(voxels, std::move(roofed), sky_given_back));
  return core;
}

std::vector<float> depths(const Voxels& voxels, const Mask& inside) {
  std::vector<float> out(voxels.total());
  const auto length = [&](int32_t squared) { return std::sqrt(double(squared)); };
  {
    const std::vector<int32_t> to_outside = squared_distances(voxels, inside, false);
    // A voxel of the surface has its centre on it, give or take half a voxel.
    for (size_t v = 0; v < out.size(); ++v)
      if (inside[v]) out[v] = float((length(to_outside[v]) - 1) * voxels.size);
  }
  const std::vector<int32_t> to_inside = squared_distances(voxels, inside, true);
  for (size_t v = 0; v < out.size(); ++v)
    if (!inside[v]) out[v] = float(-length(to_inside[v]) * voxels.size);
  return out;
}

}  // namespace

FilledSurface fill_surface(std::span<const Vec3> vertices, std::span<const Triangle> triangles, const std::string& name) {
  Eigen::AlignedBox3d box;
  for (const Triangle& triangle : triangles)
    for (uint32_t vertex : triangle) box.extend(vertices[vertex].cast<double>());
  FilledSurface out;
  const double longest = box.sizes().maxCoeff(), radius = sealing_radius * voxels_along;
  const int margin = static_cast<int>(radius) + 4;  // the ball goes round the car
  out.voxels.size = longest / voxels_along;
  out.voxels.origin = box.min().array() - margin * out.voxels.size;
  for (int k = 0; k < 3; ++k) out.voxels.count[k] = static_cast<int>(box.sizes()[k] / out.voxels.size) + 2 * margin + 2;
  out.sample = sample_surface(vertices, triangles, out.voxels, name);

  Mask solid = occupied(out.voxels, out.sample);
  const Mask closed = unreached(out.voxels, solid, 0);
  join(solid, sealed_core(out.voxels, solid, radius));
  out.inside = unreached(out.voxels, solid, leaks);
  out.closed_share = double(count_set(closed)) / double(count_set(out.inside));
  out.sealed = out.closed_share <= holds_water;
  if (!out.sealed) out.inside = closed;
  out.volume = double(count_set(out.inside)) * out.voxels.size * out.voxels.size * out.voxels.size;
  out.depth = depths(out.voxels, out.inside);
  return out;
}

}  // namespace crumple

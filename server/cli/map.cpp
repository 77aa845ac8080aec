#include "cli/map.h"

#include <algorithm>
#include <cstdio>
#include <numeric>
#include <stdexcept>

#include "bake/import_surface.h"
#include "bake/load_car.h"
#include "viewer/mapping.h"

namespace crumple {
namespace {

constexpr float far_off = 0.05f;      // m: beyond it a vertex belongs to no part of the baked car
constexpr double most_far_off = 0.5;  // share of the vertices: wheels and seats have fewer

std::vector<viewer::Point> placed(const std::vector<Eigen::Vector3d>& vertices, std::span<const double> source_to_car,
                                  const std::string& file) {
  const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> to_car(source_to_car.data());
  std::vector<viewer::Point> out;
  for (const Eigen::Vector3d& vertex : vertices) {
    const Eigen::Vector3f at = (to_car * vertex.homogeneous()).cast<float>();
    if (!at.allFinite())
      throw std::runtime_error(file + ": a vertex is not a finite number; export the mesh again without it.");
    out.push_back({at.x(), at.y(), at.z()});
  }
  return out;
}

}  // namespace

int map_mesh(const std::string& car_file, const std::string& mesh_file) {
  const auto car = load_car(car_file);
  const std::vector<Eigen::Vector3d> vertices = read_vertices(mesh_file);
  if (vertices.empty()) throw std::runtime_error(mesh_file + ": it has no vertices; export the mesh again.");
  if (car->source_to_car.empty())
    throw std::runtime_error(car_file + ": it does not say where its source's coordinates are; bake it again from its source.");

  const Model& model = car->model;
  static_assert(sizeof(viewer::Point) == sizeof(Vec3) && sizeof(viewer::Corners) == 3 * sizeof(uint32_t));
  const viewer::Mapping mapping =
      viewer::map_vertices({reinterpret_cast<const viewer::Point*>(model.vertex.data()), model.vertex.size()},
                           {reinterpret_cast<const viewer::Corners*>(model.triangle.data()), model.triangle.size() / 3},
                           placed(vertices, car->source_to_car, mesh_file), {});
  const auto far = std::count_if(mapping.distance.begin(), mapping.distance.end(), [](float d) { return d > far_off; });
  const double sum = std::accumulate(mapping.distance.begin(), mapping.distance.end(), 0.0);
  std::printf("%s: %zu vertices; %u lie on a vertex of %s\n", mesh_file.c_str(), vertices.size(), mapping.on_vertices,
              car->name.c_str());
  std::printf("  distance to its surface: mean %.1f mm, at most %.1f mm; %td vertices are farther than %.0f mm\n",
              1000 * sum / double(vertices.size()),
              1000 * double(*std::max_element(mapping.distance.begin(), mapping.distance.end())), far, 1000 * double(far_off));
  if (far == 0) return 0;
  if (double(far) > most_far_off * double(vertices.size())) {
    std::fprintf(
        stderr,
        "crumple map: %s: most of it is not where the car is: it is another car, or in other coordinates than the file "
        "from which the car was baked; export it from the same scene.\n",
        mesh_file.c_str());
    return 1;
  }
  std::printf("  these belong to parts that the baked car does not have, such as wheels: leave them out of crumple_map\n");
  return 0;
}

}  // namespace crumple

#include "fit/scale_car.h"

#include <algorithm>
#include <stdexcept>

#include "car/balance.h"

namespace crumple {
namespace {

// The arrays of a model that depend on its measures.
struct Scaled {
  std::shared_ptr<const Car> from;  // keeps all other arrays alive
  std::vector<Vec3> node, vertex;
  std::vector<float> node_mass, tet_rest, edge_rest;
  std::vector<Gradients> gradients;
};

double extent(std::span<const Vec3> points, int axis) {
  float low = points[0][axis], high = low;
  for (const Vec3& point : points) low = std::min(low, point[axis]), high = std::max(high, point[axis]);
  return double(high) - double(low);
}

}  // namespace

Measures measures_of(const Car& car) {
  return {extent(car.model.vertex, 0), extent(car.model.vertex, 1), double(car.model.mass)};
}

std::shared_ptr<const Car> scale_car(const std::shared_ptr<const Car>& car, const Measures& wanted) {
  const Measures own = measures_of(*car);
  const Vec3 by(wanted.length > 0 ? float(wanted.length / own.length) : 1,
                wanted.width > 0 ? float(wanted.width / own.width) : 1, 1);
  const float mass = wanted.mass > 0 ? float(wanted.mass) : car->model.mass;
  const auto stretched = [&](std::span<const Vec3> points) {
    std::vector<Vec3> out;
    out.reserve(points.size());
    for (const Vec3& point : points) {
      out.push_back(point.cwiseProduct(by));
      if (!(out.back().cwiseAbs().maxCoeff() <= max_extent))
        throw std::runtime_error(car->name +
                                 ": with the length and width of the test it reaches beyond 50 m; check their unit.");
    }
    return out;
  };
  const Model& model = car->model;
  const auto scaled = std::make_shared<Scaled>();
  scaled->from = car;
  scaled->node = stretched(model.node);
  scaled->vertex = stretched(model.vertex);
  for (const float each : model.node_mass) scaled->node_mass.push_back(each * (mass / model.mass));
  for (const float each : model.tet_rest) scaled->tet_rest.push_back(each * by.prod());
  for (const Edge& edge : model.edge)
    scaled->edge_rest.push_back((scaled->node[edge.node[1]] - scaled->node[edge.node[0]]).norm());
  for (Gradients each : model.gradients) {
    for (Vec3& corner : each.corner) corner = corner.cwiseQuotient(by);
    scaled->gradients.push_back(each);
  }
  const Balance balanced = balance(scaled->node, scaled->node_mass);

  auto out = std::make_shared<Car>(*car);
  out->model.node = scaled->node;
  out->model.vertex = scaled->vertex;
  out->model.node_mass = scaled->node_mass;
  out->model.tet_rest = scaled->tet_rest;
  out->model.edge_rest = scaled->edge_rest;
  out->model.gradients = scaled->gradients;
  out->model.mass = mass;
  out->model.center_of_mass = balanced.center.cast<float>();
  out->model.inertia = balanced.inertia.cast<float>();
  out->model.order = &out->order;
  out->model.boundary = &out->boundary;
  out->parts = {};
  out->bytes = {};
  out->hash.clear();
  out->owner = scaled;
  return out;
}

}  // namespace crumple

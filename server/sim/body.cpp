#include "sim/body.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <cmath>

namespace crumple {
namespace {

constexpr float farthest_node = 10;  // m from rest: no dent is as deep, and int16 quanta of 0.5 mm end at 16 m

template <class T>
uint64_t chain(const std::vector<T>& values, uint64_t seed) {
  return XXH64(values.data(), values.size() * sizeof(T), seed);
}

}  // namespace

Body make_body(const Model& model) {
  Body body;
  body.node.assign(model.node.begin(), model.node.end());
  body.step.assign(model.node.size(), Vec3::Zero());
  body.gradients.assign(model.gradients.begin(), model.gradients.end());
  body.hardening.assign(model.tet.size(), 0.0f);
  body.edge_rest.assign(model.edge_rest.begin(), model.edge_rest.end());
  body.tet_rest.assign(model.tet_rest.begin(), model.tet_rest.end());
  measure_reach(model, body);
  return body;
}

void repair(const Model& model, float amount, Body& body) {
  if (amount >= 1) {
    const double absorbed = body.absorbed;
    body = make_body(model);
    body.absorbed = absorbed;
    return;
  }
  const auto towards = [amount](auto& value, const auto& rest) { value = value + amount * (rest - value); };
  for (size_t i = 0; i < body.node.size(); ++i) towards(body.node[i], model.node[i]);
  for (size_t t = 0; t < body.gradients.size(); ++t) {
    for (int k = 0; k < 3; ++k) towards(body.gradients[t].corner[k], model.gradients[t].corner[k]);
    towards(body.hardening[t], 0.0f);
    towards(body.tet_rest[t], model.tet_rest[t]);
  }
  for (size_t e = 0; e < body.edge_rest.size(); ++e) towards(body.edge_rest[e], model.edge_rest[e]);
  for (Vec3& step : body.step) step.setZero();
  body.history = {};
  measure_reach(model, body);
  body.settled = false;
}

void measure_reach(const Model& model, Body& body) {
  float most = 0;
  body.low = body.high = body.node[0];
  for (const Vec3& node : body.node) {
    most = std::max(most, (node - model.center_of_mass).squaredNorm());
    body.low = body.low.cwiseMin(node);
    body.high = body.high.cwiseMax(node);
  }
  body.reach = std::sqrt(most);
}

std::optional<std::string> refuse_state(const Model& model, const Body& body) {
  const auto size_of = [](const char* name, size_t is, size_t should) {
    return "the state has " + std::to_string(is) + " " + name + " and the car " + std::to_string(should) +
           ": it is of another car";
  };
  if (body.node.size() != model.node.size()) return size_of("nodes", body.node.size(), model.node.size());
  if (body.gradients.size() != model.tet.size()) return size_of("tets", body.gradients.size(), model.tet.size());
  if (body.hardening.size() != model.tet.size()) return size_of("hardening values", body.hardening.size(), model.tet.size());
  if (body.edge_rest.size() != model.edge.size()) return size_of("edges", body.edge_rest.size(), model.edge.size());
  if (body.tet_rest.size() != model.tet.size()) return size_of("tet volumes", body.tet_rest.size(), model.tet.size());
  for (size_t i = 0; i < body.node.size(); ++i) {
    if (!((body.node[i] - model.node[i]).norm() <= farthest_node)) {
      return "node " + std::to_string(i) + " of the state is farther than 10 m from rest or not finite";
    }
  }
  for (size_t t = 0; t < body.gradients.size(); ++t) {
    bool finite = std::isfinite(body.hardening[t]) && body.hardening[t] >= 0 && std::isfinite(body.tet_rest[t]);
    for (const Vec3& corner : body.gradients[t].corner) finite = finite && corner.allFinite();
    if (!finite) return "tet " + std::to_string(t) + " of the state has a value that is not finite, or negative hardening";
  }
  for (float rest : body.edge_rest) {
    if (!(std::isfinite(rest) && rest >= 0)) return std::string("the state has an edge length that is negative or not finite");
  }
  return std::nullopt;
}

uint64_t hash(const Body& body) {
  uint64_t sum = chain(body.node, 0);
  sum = chain(body.step, sum);
  sum = chain(body.gradients, sum);
  sum = chain(body.hardening, sum);
  sum = chain(body.edge_rest, sum);
  sum = chain(body.tet_rest, sum);
  // The changes themselves are known by their products; reach, low and high by the nodes.
  sum = XXH64(body.history.products.data(), sizeof body.history.products, sum);
  const double numbers[] = {body.absorbed,
                            body.stored,
                            body.owed,
                            double(body.touching),
                            double(body.settled),
                            double(body.lost),
                            double(body.drift),
                            double(body.step_seconds),
                            double(body.history.count),
                            double(body.history.next),
                            body.force.x(),
                            body.force.y(),
                            body.force.z(),
                            body.moment.x(),
                            body.moment.y(),
                            body.moment.z()};
  return XXH64(numbers, sizeof numbers, sum);
}

}  // namespace crumple

// Reads a baked car: FlatBuffers verifies its structure, then this checks every size, index and number once. The checks are
// branch-free loops that return only a verdict, because the user cannot use the number of the wrong element.

#include "car/car.h"

#include <Eigen/Dense>
#include <bit>
#include <cmath>
#include <cstring>
#include <numeric>
#include <stdexcept>
#include <utility>

#include "car/balance.h"
#include "car/make_boundary.h"
#include "car/make_sweep_order.h"
#include "protocol/asset.h"
#include "schema/car_generated.h"

namespace crumple {
namespace {

constexpr uint32_t current_version = 1;
constexpr uint32_t region_name_limit = 256;  // bytes: a forged car may name one long name again and again
static_assert(std::endian::native == std::endian::little, "the file is read in place, and it is little endian");
static_assert(sizeof(schema::Vec3) == sizeof(Vec3) && sizeof(schema::Tet) == sizeof(Tet) &&
              sizeof(schema::Edge) == sizeof(Edge) && sizeof(schema::Gradients) == sizeof(Gradients) &&
              sizeof(schema::Skin) == sizeof(Skin));

[[noreturn]] void refuse(const std::string& name, const std::string& fact) {
  throw std::runtime_error(name + ": " + fact + "; bake the car again with `crumple bake`.");
}

template <class Ours, class Theirs>
std::span<const Ours> view(const flatbuffers::Vector<Theirs>* list) {
  return {reinterpret_cast<const Ours*>(list->Data()), list->size()};
}

// All numbers are finite and above zero. As bits: 1 .. 0x7f7fffff.
bool positive(std::span<const float> list) {
  uint32_t bad = 0;
  for (float value : list) bad |= std::bit_cast<uint32_t>(value) - 1u >= 0x7f7fffffu;
  return !bad;
}

template <class T>
bool below(std::span<const T> list, uint32_t limit) {
  uint32_t bad = 0;
  for (T value : list) bad |= value >= limit;
  return !bad;
}

bool tets_are_sound(const Model& model) {
  const auto n = static_cast<uint32_t>(model.node.size());
  uint32_t bad = 0;
  for (const Tet& tet : model.tet) {
    const auto [a, b, c, d] = tet.node;
    bad |= (a >= n) | (b >= n) | (c >= n) | (d >= n) | (a == b) | (a == c) | (a == d) | (b == c) | (b == d) | (c == d);
  }
  return !bad;
}

bool edges_are_sound(const Model& model) {
  const auto n = static_cast<uint32_t>(model.node.size());
  uint32_t bad = 0;
  for (const Edge& edge : model.edge) bad |= (edge.node[0] >= edge.node[1]) | (edge.node[1] >= n);
  return !bad;
}

// Every node lists exactly its own corners. Bounds are checked first, before anything is looked up.
bool corners_are_sound(const Model& model) {
  const size_t n = model.node.size(), count = 4 * model.tet.size();
  if (model.node_first.front() != 0 || model.node_first.back() != count) return false;
  uint32_t bad = 0;
  for (size_t i = 0; i < n; ++i) bad |= model.node_first[i] >= model.node_first[i + 1];
  for (uint32_t corner : model.corner) bad |= corner >= count;
  if (bad) return false;
  for (size_t i = 0; i < n; ++i) {
    uint32_t before = 0;  // corners ascend, so none is listed twice
    for (uint32_t k = model.node_first[i]; k < model.node_first[i + 1]; ++k) {
      const uint32_t corner = model.corner[k];
      bad |= (model.tet[corner / 4].node[corner % 4] != i) | (k > model.node_first[i] && corner <= before);
      before = corner;
    }
  }
  return !bad;
}

bool skin_is_sound(const Model& model) {
  const auto n = static_cast<uint32_t>(model.node.size());
  uint32_t bad = 0;
  for (const Skin& skin : model.skin) {
    float sum = 0;
    for (int k = 0; k < 4; ++k) {
      bad |= skin.node[k] >= n;
      bad |= !(skin.weight[k] >= 0);  // catches NaN too
      sum += skin.weight[k];
    }
    bad |= !(std::abs(sum - 1) <= 1e-5f);
  }
  return !bad;
}

void check_sizes(const Model& m, size_t regions, const std::string& name) {
  const auto limit = [&](size_t size, size_t most, const char* what) {
    if (size == 0) refuse(name, std::string("it has no ") + what);
    if (size > most)
      refuse(name, "it has " + std::to_string(size) + " " + what + ", more than the " + std::to_string(most) + " allowed");
  };
  limit(m.node.size(), max_nodes, "nodes");
  limit(m.tet.size(), max_tets, "tets");
  limit(m.vertex.size(), max_vertices, "surface vertices");
  limit(m.triangle.size() / 3, 2 * max_vertices, "triangles");
  limit(regions, max_regions, "regions");
  const size_t n = m.node.size(), t = m.tet.size();
  const bool fits = m.node_mass.size() == n && m.node_region.size() == n && m.node_anchored.size() == n &&
                    m.node_first.size() == n + 1 && m.gradients.size() == t && m.tet_rest.size() == t &&
                    m.tet_region.size() == t && m.corner.size() == 4 * t && !m.edge.empty() && m.edge.size() <= 6 * t &&
                    m.edge_rest.size() == m.edge.size() && m.skin.size() == m.vertex.size() && m.triangle.size() % 3 == 0;
  if (!fits) refuse(name, "its lists do not have matching lengths");
}

bool within(std::span<const Vec3> list, float extent) {
  uint32_t bad = 0;
  for (const Vec3& point : list) bad |= !(point.cwiseAbs().array() <= extent).all();  // catches NaN too
  return !bad;
}

// Numbers derived from the nodes must agree with them. Rounding to a float changes them by 5e-7 at most. If a gradient and an
// edge nearly cancel, as in a sliver, the error is that share of the product of their lengths.
constexpr double agreement = 1e-5;

bool rest_shapes_agree(const Model& model) {
  uint32_t bad = 0;
  for (size_t t = 0; t < model.tet.size(); ++t) {
    const uint32_t* node = model.tet[t].node;
    Eigen::Matrix3d edges, gradients;
    for (int k = 0; k < 3; ++k) {
      edges.col(k) = model.node[node[k + 1]].cast<double>() - model.node[node[0]].cast<double>();
      gradients.row(k) = model.gradients[t].corner[k].cast<double>();
    }
    const double rest = model.tet_rest[t], volume = edges.determinant() / 6;
    bad |= !(rest >= smallest_volume) | !(std::abs(volume - rest) <= agreement * edges.colwise().norm().prod() / 6);
    const Eigen::Matrix3d lengths = gradients.rowwise().norm() * edges.colwise().norm();
    const Eigen::Matrix3d error = gradients * edges - Eigen::Matrix3d::Identity();
    bad |= !lengths.allFinite() | !(error.cwiseAbs().array() <= agreement * (1 + lengths.array())).all();
  }
  return !bad;
}

bool edge_lengths_agree(const Model& model) {
  uint32_t bad = 0;
  for (size_t e = 0; e < model.edge.size(); ++e) {
    const auto [a, b] = model.edge[e].node;
    const double rest = model.edge_rest[e], length = (model.node[b].cast<double>() - model.node[a].cast<double>()).norm();
    bad |= !(rest > 0) | !(std::abs(length - rest) <= agreement * length);
  }
  return !bad;
}

bool masses_agree(const Model& model) {
  const Balance all = balance(model.node, model.node_mass);
  const auto agree = [](const Vec3& theirs, const Eigen::Vector3d& ours, double scale) {
    return ((theirs.cast<double>() - ours).cwiseAbs().array() <= agreement * scale).all();
  };
  return std::abs(double(model.mass) - all.mass) <= agreement * all.mass &&
         agree(model.center_of_mass, all.center, double(max_extent)) &&
         agree(model.inertia, all.inertia, all.inertia.maxCoeff());
}

void check(const Model& m, size_t regions, const std::string& name) {
  check_sizes(m, regions, name);
  const auto demand = [&](bool good, const char* fact) {
    if (!good) refuse(name, fact);
  };
  const auto region_count = static_cast<uint32_t>(regions);
  demand(within(m.node, max_extent) && within(m.vertex, max_extent), "a position is not within 50 m of its origin");
  demand(positive(m.node_mass), "a node's mass is not above zero");
  demand(below(m.node_region, region_count) && below(m.tet_region, region_count), "it names a region that it does not have");
  demand(below(m.node_anchored, 2), "an anchor flag is neither 0 nor 1");
  demand(tets_are_sound(m), "a tet names a node that does not exist or names one twice");
  demand(rest_shapes_agree(m), "a tet's rest volume or gradients do not agree with its nodes");
  demand(edges_are_sound(m), "an edge names a node that does not exist or its nodes are out of order");
  demand(edge_lengths_agree(m), "an edge's rest length is not above zero or does not agree with its nodes");
  demand(corners_are_sound(m), "the list of the tets around each node does not agree with the tets");
  demand(below(m.triangle, static_cast<uint32_t>(m.vertex.size())), "a triangle names a vertex that does not exist");
  demand(skin_is_sound(m), "a vertex follows a node that does not exist, or its weights are negative or do not sum to 1");
  demand(m.mass >= least_mass && m.mass <= most_mass, "its mass is not from 10 kg to 100 t");
  demand(masses_agree(m), "its mass, inertia or centre of mass does not agree with its nodes");
}

std::vector<uint32_t> skin_nodes(const Model& model) {
  std::vector<uint8_t> used(model.node.size());
  for (const Skin& skin : model.skin) {
    for (int k = 0; k < 4; ++k) used[skin.node[k]] |= skin.weight[k] > 0;
  }
  std::vector<uint32_t> out;
  for (uint32_t i = 0; i < used.size(); ++i) {
    if (used[i]) out.push_back(i);
  }
  return out;
}

std::shared_ptr<const Car> read(std::span<const std::byte> bytes, const std::string& name, std::shared_ptr<const void> owner) {
  const auto* data = reinterpret_cast<const uint8_t*>(bytes.data());
  if (bytes.size() < 8 || !schema::CarBufferHasIdentifier(data)) refuse(name, "this is not a baked car");
  if (bytes.size() > asset_limit) refuse(name, "it is larger than 256 MiB");
  flatbuffers::Verifier verifier(data, bytes.size());
  if (!schema::VerifyCarBuffer(verifier)) refuse(name, "the file is cut off or damaged");
  const schema::Car& file = *schema::GetCar(data);
  if (file.version() != current_version)
    refuse(name, "it has version " + std::to_string(file.version()) + ", this program reads version " +
                     std::to_string(current_version));
  if (!file.center_of_mass() || !file.inertia()) refuse(name, "its centre of mass or inertia is missing");

  auto car = std::make_shared<Car>();
  car->bytes = bytes;
  car->owner = std::move(owner);
  car->name = file.name()->str();
  car->attribution = file.attribution()->str();
  if (file.source_to_car()) car->source_to_car = view<double>(file.source_to_car());
  const auto& matrix = car->source_to_car;
  if (!matrix.empty() && reinterpret_cast<uintptr_t>(matrix.data()) % alignof(double) != 0)
    refuse(name, "its matrix from the source is not aligned");
  if (!matrix.empty() &&
      (matrix.size() != 12 || !std::all_of(matrix.begin(), matrix.end(), [](double x) { return std::isfinite(x); })))
    refuse(name, "its matrix from the source to the car has not 12 finite numbers");
  car->model = {
      .node = view<Vec3>(file.node()),
      .node_mass = view<float>(file.node_mass()),
      .node_region = view<uint8_t>(file.node_region()),
      .node_anchored = view<uint8_t>(file.node_anchored()),
      .tet = view<Tet>(file.tet()),
      .gradients = view<Gradients>(file.tet_gradients()),
      .tet_rest = view<float>(file.tet_rest()),
      .tet_region = view<uint8_t>(file.tet_region()),
      .edge = view<Edge>(file.edge()),
      .edge_rest = view<float>(file.edge_rest()),
      .node_first = view<uint32_t>(file.node_first()),
      .corner = view<uint32_t>(file.corner()),
      .vertex = view<Vec3>(file.vertex()),
      .triangle = view<uint32_t>(file.triangle()),
      .skin = view<Skin>(file.skin()),
      .mass = file.mass(),
      .center_of_mass = {file.center_of_mass()->x(), file.center_of_mass()->y(), file.center_of_mass()->z()},
      .inertia = {file.inertia()->x(), file.inertia()->y(), file.inertia()->z()},
  };
  check(car->model, file.region()->size(), name);
  for (const auto* region : *file.region()) {
    if (region->size() > region_name_limit)
      refuse(name, "the name of a region is longer than " + std::to_string(region_name_limit) + " bytes");
    car->regions.push_back(region->str());
  }
  if (const char* why = read_parts(file, car->parts)) refuse(name, why);
  if (const char* why = read_looks(file, car->looks)) refuse(name, why);
  car->order = make_sweep_order(car->model);
  car->boundary = make_boundary(car->model);
  car->skin_node = skin_nodes(car->model);
  const auto edges = car->model.edge_rest;
  car->mean_edge = float(std::accumulate(edges.begin(), edges.end(), 0.0) / double(edges.size()));
  if (car->order.colour.empty()) refuse(name, "a node has hundreds of neighbours that are all neighbours of each other");
  car->model.order = &car->order;
  car->model.boundary = &car->boundary;
  car->hash = hash_of(bytes.data(), bytes.size());
  return car;
}

}  // namespace

std::shared_ptr<const Car> read_car(std::string bytes, const std::string& name) {
  if (bytes.empty()) refuse(name, "the file is empty");
  const auto owner = std::make_shared<const std::string>(std::move(bytes));
  return read(std::as_bytes(std::span(*owner)), name, owner);
}

std::shared_ptr<const Car> read_car(std::span<const std::byte> bytes, const std::string& name) {
  // Lists in the file are aligned to its start; `new` aligns the copy to 16.
  auto copy = std::make_shared<std::vector<std::byte>>(bytes.begin(), bytes.end());
  return read(*copy, name, copy);
}

}  // namespace crumple

// A car as baked: built once, never written, shared by all instances. The spans point into the baked file.
// Frame: X forward, Y left, Z up, metres. The tick uses only arrays indexed by node, tet, edge or vertex.
#pragma once

#include <cstdint>
#include <span>

#include "sim/boundary.h"
#include "sim/math.h"
#include "sim/sweep_order.h"

namespace crumple {

struct Tet {
  uint32_t node[4];
};
struct Edge {
  uint32_t node[2];
};
// Rest gradients of the shape functions of corners 1..3, 1/m. The gradient of corner 0 is minus their sum.
struct Gradients {
  Vec3 corner[3];
};
// vertex = its rest + sum weight[i] (node[i] - its rest); the weights are in [0, 1] and sum to 1.
struct Skin {
  uint32_t node[4];
  float weight[4];
};

struct Model {
  std::span<const Vec3> node;              // n rest positions, m
  std::span<const float> node_mass;        // n, kg
  std::span<const uint8_t> node_region;    // n
  std::span<const uint8_t> node_anchored;  // n, 0 or 1
  std::span<const Tet> tet;                // t
  std::span<const Gradients> gradients;    // t
  std::span<const float> tet_rest;         // t rest volumes, m^3
  std::span<const uint8_t> tet_region;     // t
  std::span<const Edge> edge;              // e, unique
  std::span<const float> edge_rest;        // e rest lengths, m
  std::span<const uint32_t> node_first;    // n + 1: corners of node i are corner[node_first[i] .. node_first[i + 1])
  std::span<const uint32_t> corner;        // 4 t entries: 4 * tet + which of its corners
  std::span<const Vec3> vertex;            // v rest positions, m
  std::span<const uint32_t> triangle;      // 3 f
  std::span<const Skin> skin;              // v
  const SweepOrder* order = nullptr;       // made from the arrays above
  const Boundary* boundary = nullptr;      // made from the arrays above
  float mass = 0;                          // kg
  Vec3 center_of_mass = Vec3::Zero();      // m
  Vec3 inertia = Vec3::Zero();             // principal, about the centre of mass along the car's axes, kg m^2
};

static_assert(sizeof(Vec3) == 12 && sizeof(Tet) == 16 && sizeof(Edge) == 8 && sizeof(Gradients) == 36 && sizeof(Skin) == 32);

}  // namespace crumple

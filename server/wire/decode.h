// Decodes bytes from a host to plain structs, or refuses them. It verifies every offset, then checks every field against its
// range and limit, and takes a message whole or not at all. The result needs no further checks except against the world (does
// the car live, is the asset known). Orientations are normalised.
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "protocol/limits.h"
#include "protocol/message.h"
#include "sim/body.h"
#include "sim/material.h"
#include "sim/motion.h"
#include "sim/obstacle.h"
#include "wire/refusal.h"

namespace crumple {

struct Intent {
  std::string car;
  Motion motion;
  uint64_t seen = 0;  // tick of the last reaction that motion includes; 0: none, a scripted car
  float importance = 1;
};
struct Intents {
  uint64_t sequence = 0;
  double time = 0;  // s, the host's clock
  std::vector<Intent> cars;
};

struct ObstacleList {
  uint64_t sequence = 0;
  std::vector<Obstacle> obstacles;  // in ascending order of id
};

struct SpawnOrder {
  std::string asset, host;
  Pose pose;
  double mass = 0;                                         // kg; 0: mass, inertia and centre of the baked car
  std::optional<Eigen::Vector3d> inertia, center_of_mass;  // kg m^2, m; absent: the baked car's
  bool planar = true;
};
struct DespawnOrder {};
struct RepairOrder {
  float amount = 1;
};
struct ParametersOrder {
  std::optional<Solver> solver;
  std::optional<uint16_t> iterations;
  std::optional<float> tolerance;
  std::optional<uint16_t> substeps;
  int region = -1;  // -1: all
  std::vector<std::pair<float Material::*, float>> changes;
};
struct SaveOrder {};
struct LoadOrder {
  std::string asset;
  DeformableState state;  // all but step, reach and impulses; sizes are checked later
};
struct ReplaceOrder {
  std::string asset;
};
using Order = std::variant<SpawnOrder, DespawnOrder, RepairOrder, ParametersOrder, SaveOrder, LoadOrder, ReplaceOrder>;

struct Budget {
  uint64_t work = 0;  // tet visits a tick; 0: no limit
};

// A baked car, not checked yet; points into the message.
struct UploadedAsset {
  std::span<const std::byte> car;
};

// The bytes must be aligned to 8. After a refusal the output is meaningless.
[[nodiscard]] std::optional<Refusal> decode(std::span<const std::byte>, const Limits&, Intents&);
[[nodiscard]] std::optional<Refusal> decode(std::span<const std::byte>, const Limits&, ObstacleList&);
[[nodiscard]] std::optional<Refusal> decode(std::span<const std::byte>, const Limits&, Order&);
[[nodiscard]] std::optional<Refusal> decode(std::span<const std::byte>, const Limits&, Budget&);
[[nodiscard]] std::optional<Refusal> decode(std::span<const std::byte>, const Limits&, UploadedAsset&);

// Only in recordings.
struct TickEnd {
  uint64_t tick = 0, hash = 0, lost_inputs = 0, lost_outputs = 0, inputs = 0;
};
[[nodiscard]] std::optional<Refusal> decode(std::span<const std::byte>, TickEnd&);

// Makes the changes; out_of_range() checks the ranges.
void apply(const ParametersOrder&, Parameters&);

}  // namespace crumple

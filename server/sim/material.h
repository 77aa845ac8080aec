// Parameters that a host may tune while the simulation runs, per car and per region of the car. Every field states its unit,
// its range and the reason for its default. A value out of range is refused with a sentence, never clamped.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

namespace crumple {

inline constexpr int region_limit = 16;  // same as max_regions in car.h

enum class Solver : uint8_t { nodal, classic };

struct Material {
  // Young's modulus of the body as a homogeneous crushable foam, Pa, [1e4, 1e10]. A car is mostly air. All stresses below are
  // shares of it, so this one number scales every force of the car.
  float young_modulus = 25e6f;
  // Elastic Poisson ratio, [0, 0.45]. A crushed shell does not bulge; 0 also makes plastic flow parallel to strain.
  float poisson_ratio = 0.0f;
  // The yield stress over the accumulated plastic strain k, as a share of young_modulus (flow.h has the whole formula):
  //   yield_strain + hardening k / (1 + k / hardening_strain) + densification max(0, k - densification_strain)^2
  // Elastic strain at which flow begins, [0, 1].
  float yield_strain = 0.0012f;
  // Slope of the yield stress where k is 0, [0, 1].
  float hardening = 0.32f;
  // Plastic strain at which half of the hardening is done, [0.001, 1000]: the yield stress rises by hardening times this, and
  // then stays on a plateau, while the structure folds. 1000: it rises without end.
  float hardening_strain = 0.064f;
  // What is crushed flat is solid: the yield stress rises again, [0, 100], ...
  float densification = 0.23f;
  // ... from this plastic strain on, [0, 3]. 1.1: crushed to a third of its length.
  float densification_strain = 1.1f;
  // Norm of the plastic logarithmic strain that no tet exceeds, [0, 3]. 3: crushed to 5 % of its length. Densification stops
  // a crash before.
  float plastic_limit = 3.0f;
  // Drag on a node against the car's frame, per volume that the node stands for, N s/m^4, [0, 1e9]. Drag takes energy, so the
  // default is the smallest with which the solver still converges.
  float drag = 5e3f;
  // Coulomb friction on other cars, [0, 2]. Two materials that touch rub with the geometric mean of theirs. 0.6: dry
  // steel on steel. An obstacle has its own friction.
  float friction = 0.6f;
  // Used by `classic` only (thesis 3.6.3, 3.8), [0, 1]: stiffness of both constraints; share of a rest value kept per tick.
  float distance_stiffness = 1.0f;
  float volume_stiffness = 1.0f;
  float plasticity = 0.9f;

  friend bool operator==(const Material&, const Material&) = default;
};

struct Parameters {
  Solver solver = Solver::nodal;
  // `nodal`: most sweeps per sub-step; `classic`: iterations per tick. [1, 1000].
  uint16_t iterations = 40;
  // A sub-step of `nodal` ends when its last two sweeps moved the awake nodes by no more than this (rms), m, [0, 0.1]. It is an
  // absolute length, because a share of the nodes' way would spend sweeps where nothing moves and save them where the dent is
  // made. 0: do all iterations, and on all nodes instead of those near which something moves (active_set.h).
  float tolerance = 8e-5f;
  // Sub-steps of `nodal` in 1/60 s, before any halving (substeps.h), [1, 64]. Fewer sub-steps follow the path less accurately;
  // more take longer.
  uint16_t substeps = 4;
  std::array<Material, region_limit> region;

  friend bool operator==(const Parameters&, const Parameters&) = default;
};

// The allowed range of each field above, except `solver`.
struct Range {
  const char* name;
  float low, high;
  const char* unit;
  bool of_region;  // true: one value per region; false: one per car
  bool whole;      // whole numbers only
  float (*value)(const Parameters&, int region);
};
std::span<const Range> parameter_ranges();

// A sentence that names the first field out of its range, its value and the range; nothing if all are in range.
[[nodiscard]] std::optional<std::string> out_of_range(const Parameters&);

}  // namespace crumple

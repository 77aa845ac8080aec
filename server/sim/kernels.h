// The inner loops of `nodal` on plain arrays, 16 nodes or 16 tets at once. They are compiled for several instruction sets; the
// processor decides once which one runs; all give the same bits. Symbols: V rest volume, D determinant of a tet's gradients
// (1 / D: six times its volume without load), N area vector of the face opposite a node (twice its area), kappa accumulated
// plastic strain.
#pragma once

#include "sim/anderson_kernels.h"
#include "sim/blocks.h"
#include "sim/vector.h"

namespace crumple {

// J_p of a tet (flow.h) is taken to be within these: the uniaxial crush and stretch at the largest plastic_limit.
inline constexpr float least_volume_ratio = 0.05f, most_volume_ratio = 20;
// Newton's steps to the growth of kappa in a sub-step.
inline constexpr int growth_steps = 3;

// A material's constants, Pa; see flow.h.
struct Law {
  float mu, l, gamma;                                  // elastic
  float shear, bulk;                                   // 2 mu, 3 K
  float start, slope, fold, dense, dense_from, limit;  // of the yield stress
  float room;                                          // limit of kappa now: 0 while flow is suspended

  friend bool operator==(const Law&, const Law&) = default;
};

// Per-tick data of 16 tets.
struct TetLanes {
  float gradient[9][lanes];  // rows: corners 1..3; 1/m
  float volume[lanes];       // rest volume, m^3
  float kappa[lanes];
  float yield[lanes];  // yield stress at kappa, Pa
};

// Stiffness of a tet as a Float4: x = mu V, N m; y = l V D^2, N/m^5; z = gamma / D, m^3; w unused.

struct NodeView {
  Float4* node;             // n + 1 positions
  const Float4* before;     // n + 1 positions at the start of the sub-step; w: drag, N/m
  const Float4* rest;       // n + 1 positions; w: anchor spring, N/m
  const Float4* stiffness;  // t + 1
  const uint32_t* index;    // Blocks::node
  const uint32_t* row;      // Blocks::row
  const uint8_t* anchored;  // Blocks::anchored
  const Row* rows;          // Blocks::rows
  const Weights* weights;   // Blocks::weights
  const uint16_t* still;    // per block: lanes that the sweep must not move
  const uint16_t* touched;  // per block: lanes that an obstacle may hold; `resolve` moves them
  float relaxation;
  bool measure;  // move nothing, but call `resolve` as usual
  // gradient N; hessian N/m: xx yy zz xy xz yz
  void (*resolve)(void* context, uint32_t node, const float gradient[3], const float hessian[6]);
  void* context;
};

struct TetView {
  const Float4* node;  // n + 1
  const TetGroup* group;
  const TetLanes* tet;
  const uint8_t* region;   // t, padded to whole groups
  const Law* law;          // per region
  const uint8_t* stirred;  // per group; groups that are not stirred are skipped
};

struct Kernels {
  const char* name;
  // Minimises the energy node by node, blocks [first, last).
  void (*relax_nodes)(const NodeView&, uint32_t first, uint32_t last);
  // Secant moduli (flow.h) of the groups [first, last). flowing: per group, lanes whose tet is beyond yield. If none was
  // before and none is now, the moduli stay unchanged. Returns how many tets have lost their shape: they are inverted, nearly
  // flat, or stretched more than in any crash.
  uint32_t (*update_secant_moduli)(const TetView&, uint32_t first, uint32_t last, Float4* stiffness, uint16_t* flowing);
  // Adds the derivative of the elastic energy along `direction`, sum derivative[k] a^k, over the groups [first, last).
  void (*line_derivative)(const TetView&, uint32_t first, uint32_t last, const Float4* stiffness, const Float4* direction,
                          double derivative[6]);
  // Plastic flow (flow.h) of the lanes in `flowing` that are beyond yield and not inverted. Changes gradients and kappa;
  // returns the plastic work, J.
  double (*flow)(const TetView&, TetLanes*, uint32_t first, uint32_t last, const uint16_t* flowing);
  // Elastic energy of the groups [first, last) at their full moduli, J.
  double (*energy)(const TetView&, uint32_t first, uint32_t last);
  AndersonKernels anderson;
};

// The widest instruction set that this processor has. By name (portable, avx2, avx512), for tests: nullptr if it lacks it.
const Kernels& kernels();
const Kernels* kernels(const char* name);

}  // namespace crumple

// The solver `classic`: the scheme of Ille 2020 as the thesis states it. Constraints on unique edges (3.6.1) and tet volumes
// (3.6.2), corrections scaled by a stiffness (3.6.3), iterated Gauss-Seidel over all edges, then all volumes (algorithms 1 and
// 9). Before that, obstacles project nodes once per tick (algorithm 8). Plasticity (3.8): a rest value becomes rest p +
// (1 - p) now. The thesis does not say when; here it happens once a tick, when the first iteration meets the constraint. The
// volume correction is kept as printed, d (V - V0) / sum |d|^2 with d = 6 grad V, which is a sixth of the step that would meet
// the constraint. The thesis has no force feedback: `classic` gives no reaction, and contacts do not change the car's path.
#pragma once

#include <span>

#include "sim/body.h"
#include "sim/contacts.h"

namespace crumple {

// Solves one tick. The contacts are those of the whole tick. Anchored nodes do not move.
void solve_classic(const Model&, const Parameters&, std::span<const Contact>, DeformableState&);

// The two constraints as pure functions. They return corrections to add to the positions, before scaling by the stiffness.
// |b - a| = rest: each node takes half of the difference.
struct EdgeCorrection {
  Vec3 a, b;
};
EdgeCorrection distance_correction(const Vec3& a, const Vec3& b, float rest);
// (b - a) x (c - a) . (d - a) / 6 = rest, m^3.
struct TetCorrection {
  Vec3 node[4];
};
float signed_volume(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d);
TetCorrection volume_correction(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, float rest);

}  // namespace crumple

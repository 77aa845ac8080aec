// The solver `classic`: the scheme of Ille 2020 as it is stated. Constraints on unique edges (3.6.1) and tet volumes (3.6.2),
// corrections scaled by a stiffness (3.6.3), Gauss-Seidel over all edges, then all volumes, iterated (algorithms 1 and 9);
// obstacles project nodes once per tick before that (algorithm 8). Plasticity (3.8): a rest value moves to rest p + (1 - p)
// now; the thesis leaves open when: here once a tick, as the first iteration meets the constraint. The volume correction is
// kept as printed, d (V - V0) / sum |d|^2 with d = 6 grad V: a sixth of the step that would meet the constraint. The thesis has
// no force feedback: `classic` gives no reaction and its path is law.
#pragma once

#include <span>

#include "sim/body.h"
#include "sim/contacts.h"

namespace crumple {

// Contacts of the whole tick, already found. Anchored nodes do not move.
void solve_classic(const Model&, const Parameters&, std::span<const Contact>, DeformableState&);

// The two constraints as pure functions. Corrections to add to the positions, before stiffness.
// |b - a| = rest: half of the difference each.
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

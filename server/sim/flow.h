// Plasticity of a crushable foam (Deshpande and Fleck 2000) with plastic Poisson ratio 0. Its yield surface is then the
// Frobenius norm of the stress, |tau| = Y, with tau the Kirchhoff stress of the stable neo-Hookean energy. A car body is mostly
// air: it compacts under pressure, where an incompressible solid (J2) would bulge.
//   flow rule   d(strain) = d(kappa) tau / |tau|      (associated; strain logarithmic)
//   hardening   Y = J_p E (yield_strain + hardening kappa / (1 + kappa / hardening_strain)
//                          + densification max(0, kappa - densification_strain)^2)
// with kappa the accumulated plastic strain, at most plastic_limit, and J_p the tet's volume without load over that at rest.
// The factor J_p makes the bracket a stress per area that the material has now: crushed material holds no more force than its
// section did. So the force on a bar of it never falls, in compression nor in tension, as long as the bracket does not.
// Within a sub-step J_p is the one at its start. Then the sub-step minimises a potential (server/sim/README.md).
#pragma once

#include "sim/body.h"
#include "sim/kernels.h"

namespace crumple {

// A material's elastic constants as the solver uses them, Pa. Energy density mu/2 |F|^2 + l/2 (J - gamma)^2, with
// l = lambda + mu and gamma = 1 + mu/l (stable neo-Hookean; Smith, de Goes, Kim 2018, without the logarithmic barrier).
struct Elastic {
  float mu, l, gamma;
};
Elastic elastic(const Material&);

struct YieldLaw {
  float shear;       // 2 mu, Pa
  float bulk;        // 3 K = 3 lambda + 2 mu, Pa
  float start;       // yield stress at kappa = 0, Pa
  float slope;       // Pa per kappa, at kappa = 0
  float fold;        // 1 / hardening_strain
  float dense;       // Pa per kappa^2
  float dense_from;  // kappa
  float limit;       // largest kappa
};
YieldLaw yield_law(const Material&);
// The law of a tet whose volume without load has become `volume_ratio` (J_p) of that at rest.
YieldLaw crushed(const YieldLaw&, float volume_ratio);

// Volume of a tet without load over that at rest. rest: volume at rest, m^3.
float volume_ratio(float rest, const Gradients&);

// F = sum over corners (x_k - x_0) gradient_k^T.
inline Mat3 deformation(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d, const Gradients& gradients) {
  const Vec3 ab = b - a, ac = c - a, ad = d - a;
  Mat3 f;
  for (int k = 0; k < 3; ++k)
    f.col(k) = ab * gradients.corner[0][k] + ac * gradients.corner[1][k] + ad * gradients.corner[2][k];
  return f;
}

// The functions from here to `flow` treat one tet, in plain code and partly in double. The kernels (kernels.h) do the same for
// 16 tets; tests compare the two.

// Y, Pa. It is at least that of a strain of 1e-5: without any yield stress a tet would be a fluid.
float yield_stress(const YieldLaw&, float kappa);

// The plastic multiplier D per stress, 1/Pa. The flowed stress is deviator / (1 + shear D) + mean / (1 + bulk D). 0: elastic.
// deviator: norm of the deviatoric stress, Pa; mean: sqrt(3) |p|, Pa.
float plastic_multiplier(const YieldLaw&, float deviator, float mean, float kappa);

// The laws given to the functions from here on are those of the tet as it is crushed at the start of the sub-step: crushed().
// Secant moduli: at this F they give the stress that remains after flow from the last state. The sweeps see the tet with them.
// Minimising with secant moduli and updating them in turn is the iteratively reweighted form of the incremental plastic
// problem. Each sweep lowers its potential, so the solution contains the flow instead of preceding it.
Elastic secant(const Elastic&, const YieldLaw&, const Mat3& f, float kappa);

// Flows one tet for good: changes its gradients and kappa. Returns the plastic work per volume, J/m^3; 0 if it stayed elastic.
// Inverted or nearly inverted tets (J <= 0.02) do not flow, because their logarithmic strain is meaningless.
float flow(const Elastic&, const YieldLaw&, const Mat3& f, Gradients& gradients, float& kappa);

// Energy density relative to rest, J/m^3.
float energy_density(const Elastic&, const Mat3& f);

}  // namespace crumple

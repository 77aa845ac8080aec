// A bar pulled by a fifth of its length and let go: what it keeps is known in closed form.
// Flow has the direction of the stress, and the stress of a bar one axis. So kappa is the axial logarithmic plastic strain, and
//   log(stretch) = log(r) + kappa,   tau(r) = E (yield + hardening kappa),   set = exp(kappa) - 1,
// with r the elastic stretch and tau(r) its Kirchhoff stress. Logarithmic elasticity, tau = E log(r), gives
//   kappa = (log(stretch) - yield) / (1 + hardening);
// the stable neo-Hookean energy with free sides, at no Poisson's ratio, tau = E/2 (r^2 - (2r - 1) / r^2): at an elastic strain
// of 2.6 % 4 % more stress, and 0.7 % more set. It must harden: a bar whose slope of Y is below Y necks (Considere), and
// without hardening this one is found to keep 0.180 to 0.185 m in a neck where a bar that stays uniform keeps 0.177.
#pragma once

#include "reference/held_mesh.h"

namespace crumple {

inline constexpr double bar_pull = 0.2;                        // of its length
inline constexpr int pull_substeps = 480, hold_substeps = 96;  // a second and a fifth of one at the default

struct PulledBar {
  double set;    // residual elongation over length
  double force;  // when it is held, N
  DeformableState body;
};

// tets: from x = 0 to `length`, m. Both ends are held, then the far one is let go and the bar comes to rest. (Ends that are
// held cannot thin; with no Poisson's ratio they would by half the square of the elastic strain.)
PulledBar pull_bar(const TetMesh& tets, double length, const Parameters&);

// The closed form of its set; Poisson's ratio 0.
double closed_form_set(const Material&);

}  // namespace crumple

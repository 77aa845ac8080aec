// A bar is pulled by a fifth of its length and released. What it keeps is known in closed form.
// Flow has the direction of the stress, and a bar's stress has one axis. So kappa is the axial logarithmic plastic strain, and
//   log(stretch) = log(r) + kappa,   tau(r) = E (yield + hardening kappa),   set = exp(kappa) - 1,
// with r the elastic stretch and tau(r) its Kirchhoff stress. Logarithmic elasticity, tau = E log(r), gives
//   kappa = (log(stretch) - yield) / (1 + hardening);
// For the stable neo-Hookean energy with free sides and Poisson ratio 0, tau = E/2 (r^2 - (2r - 1) / r^2): at an elastic strain
// of 2.6 % this is 4 % more stress and 0.7 % more set. The bar must harden: if the slope of Y is below Y, it necks (Considere).
// Without hardening this bar was found to keep 0.180 to 0.185 m in a neck, where a uniform bar keeps 0.177.
#pragma once

#include "reference/held_mesh.h"

namespace crumple {

inline constexpr double bar_pull = 0.2;                        // share of its length
inline constexpr int pull_substeps = 480, hold_substeps = 96;  // one second, and a fifth of a second, at the default

struct PulledBar {
  double set;    // residual elongation over length
  double force;  // while it is held, N
  DeformableState body;
};

// tets: a bar from x = 0 to `length`, m. Both ends are held, then the far end is released and the bar comes to rest. (Held ends
// cannot thin; with Poisson ratio 0 they would by half the square of the elastic strain.)
PulledBar pull_bar(const TetMesh& tets, double length, const Parameters&);

// The set in closed form, for Poisson ratio 0.
double closed_form_set(const Material&);

}  // namespace crumple

// A bar is pulled by a fifth of its length and released. What it keeps is known in closed form.
// Flow has the direction of the stress, and a bar's stress has one axis. So kappa is the axial logarithmic plastic strain, and
//   log(stretch) = log(r) + kappa,   tau(r) = J_p Y(kappa),   J_p = exp(kappa),   set = exp(kappa) - 1,
// with r the elastic stretch, tau(r) its Kirchhoff stress and Y as in flow.h. Logarithmic elasticity is tau = E log(r). For the
// stable neo-Hookean energy with free sides and Poisson ratio 0, tau = E/2 (r^2 - (2r - 1) / r^2): at an elastic strain of 2.6
// % this is 4 % more stress and 0.7 % more set. The force is Y(kappa) times the section, so a bar that hardens never necks.
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

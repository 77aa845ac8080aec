// The law of one tet in double precision. It is written from the formulas at the top of flow.h alone and shares no code with
// flow.cpp. In: logarithmic principal strains of the trial Fe (this sub-step's F on the last plastic state) and kappa.
// Out: the result of one implicit step of the flow rule.
//   mapped   minimises psi(strain) + integral of Y d(kappa) over the elastic strain: exact return mapping, associated, with the
//            neo-Hookean stress at the remaining strain. It has a potential: stress = d(energy) / d(trial).
//   secant   the sweeps' shortcut (secant() and flow()): the neo-Hookean stress at the *trial* strain, scaled back. It has no
//            potential in general. Kept to distinguish an unconverged solver from a different law.
#pragma once

#include <Eigen/Dense>

#include "sim/material.h"

namespace crumple {

enum class FlowLaw : uint8_t { mapped, secant };

struct ReferenceMaterial {
  double mu, l, gamma;                           // neo-Hookean: mu/2 |F|^2 + l/2 (J - gamma)^2, Pa
  double shear, bulk;                            // 2 mu and 3 K, Pa
  double start, slope, fold, dense, dense_from;  // Y = start + slope k / (1 + fold k) + dense max(0, k - dense_from)^2, Pa
  double limit;                                  // largest kappa
  double yield(double kappa) const;
  double rise(double kappa) const;                    // dY / d(kappa)
  double plastic(double kappa, double growth) const;  // integral of Y d(kappa) while kappa grows, J/m^3
};
// volume_ratio: J_p of the tet at the start of the sub-step.
ReferenceMaterial reference_material(const Material&, double volume_ratio = 1);

// Trial strains with a smaller volume ratio do not flow, as in flow().
inline constexpr double smallest_flowing_ratio = 0.02;

struct Mapped {
  double energy = 0;                                  // elastic + plastic work of the step, J/m^3; `mapped` only
  Eigen::Vector3d stress = Eigen::Vector3d::Zero();   // Kirchhoff, principal, Pa
  Eigen::Matrix3d tangent = Eigen::Matrix3d::Zero();  // d(stress) / d(trial), Pa; `mapped` only
  Eigen::Vector3d strain = Eigen::Vector3d::Zero();   // remaining elastic logarithmic strain
  double growth = 0;                                  // growth of kappa
  double work = 0;                                    // plastic work, J/m^3
};

// Exact return mapping of principal logarithmic strains.
Mapped map_strain(const ReferenceMaterial&, const Eigen::Vector3d& trial, double kappa);

// What flow() does to the same strains, with its root found to the last bit: `stress` is at the remaining strain.
Mapped flow_strain(const ReferenceMaterial&, const Eigen::Vector3d& trial, double kappa);

// One tet at F = trial Fe.
struct TetLaw {
  double energy = 0;                    // J/m^3; `mapped` only
  Eigen::Matrix3d stress;               // first Piola-Kirchhoff, Pa
  Eigen::Matrix<double, 9, 9> tangent;  // d(stress) / d(F), columns of F stacked; symmetric part
};
// project: sets the tangent's negative eigenvalues to zero.
TetLaw tet_law(FlowLaw, const ReferenceMaterial&, const Eigen::Matrix3d& f, double kappa, bool want_tangent, bool project);

// The result of flow at this F: Fe = f * factor. growth and work as above.
struct Flowed {
  Eigen::Matrix3d factor = Eigen::Matrix3d::Identity();
  double growth = 0, work = 0;
};
Flowed flow_reference(FlowLaw, const ReferenceMaterial&, const Eigen::Matrix3d& f, double kappa);

}  // namespace crumple

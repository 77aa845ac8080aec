// Letters (more in law.h): s principal stretches of F (negative where it mirrors), P principal first Piola-Kirchhoff stresses,
// A = d(P)/d(s), q plastic strain of the step, n its direction.
#include "reference/law.h"

#include <algorithm>
#include <cmath>

namespace crumple {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// The elastic response alone, in logarithmic strains.
Mapped elastic_point(const ReferenceMaterial& m, const Vector3d& strain) {
  Mapped out;
  const Vector3d squared = (2 * strain).array().exp();
  const double j = std::exp(strain.sum()), spread = j - m.gamma, rest = 1 - m.gamma;
  out.energy = 0.5 * (m.mu * (squared.sum() - 3) + m.l * (spread * spread - rest * rest));
  out.stress = (m.mu * squared).array() + m.l * spread * j;
  out.tangent = Matrix3d::Constant(m.l * (j + spread) * j);
  out.tangent.diagonal() += 2 * m.mu * squared;
  out.strain = strain;
  return out;
}

// Flow with the multiplier D (1/Pa): strain + D stress(strain) = trial.
// For a given D it minimises psi + |trial - strain|^2 / (2 D).
Vector3d flowed_by(const ReferenceMaterial& m, const Vector3d& trial, double d) {
  Vector3d strain = trial / (1 + m.shear * d);
  const auto sum = [&](const Vector3d& e) { return d * elastic_point(m, e).energy + 0.5 * (trial - e).squaredNorm(); };
  for (int pass = 0; pass < 30; ++pass) {
    const Mapped here = elastic_point(m, strain);
    const Vector3d residual = strain + d * here.stress - trial;
    if (residual.norm() <= 1e-15) break;
    const Vector3d move = -(Matrix3d::Identity() + d * here.tangent).ldlt().solve(residual);
    double share = 1;
    while (share > 1e-3 && sum(strain + share * move) > sum(strain) + 1e-15) share *= 0.5;
    strain += share * move;
  }
  return strain;
}

// The elastic strain at the end of the step. As D grows, the stress falls and kappa = D |stress| grows, until the stress meets
// the yield surface or kappa its limit. Newton's method on strain and D together; if that fails, bisection on D.
Vector3d flowed_strain(const ReferenceMaterial& m, const Vector3d& trial, double kappa) {
  const double room = m.limit - kappa;
  const auto excess = [&](double norm, double d) {
    return std::min(norm - m.yield(kappa + d * norm), (room - d * norm) * m.shear);
  };
  Vector3d strain;
  double d = 0;
  const auto newton = [&](bool full) {
    for (int pass = 0; pass < 20; ++pass) {
      const Mapped here = elastic_point(m, strain);
      const double norm = here.stress.norm();
      const double grown = std::max(0.0, d * norm), rise = m.rise(kappa + grown);
      Eigen::Vector4d right;
      right << trial - strain - d * here.stress, full ? (room - d * norm) : (m.yield(kappa + grown) - norm) / m.shear;
      const double left = right.norm();
      if (left <= 1e-15 || (pass > 8 && left <= 1e-14)) return d >= 0;
      const Vector3d steeper = here.tangent * here.stress / norm;
      Eigen::Matrix4d matrix;
      matrix.topLeftCorner<3, 3>() = Matrix3d::Identity() + d * here.tangent;
      matrix.topRightCorner<3, 1>() = here.stress / m.shear;
      matrix.bottomLeftCorner<1, 3>() =
          full ? Eigen::RowVector3d(d * steeper) : Eigen::RowVector3d((1 - rise * d) / m.shear * steeper);
      matrix(3, 3) = full ? norm / m.shear : -rise * norm / m.shear / m.shear;
      const Eigen::Vector4d move = matrix.partialPivLu().solve(right);
      if (!move.allFinite() || move.norm() > 10) return false;
      strain += move.head<3>();
      d += move[3] / m.shear;
    }
    return false;
  };
  // Starts from the solution of the logarithmic law.
  const auto begin = [&](bool full) {
    const double size = trial.norm();
    double grown = full ? room : 0;
    for (int k = 0; k < 5 && !full; ++k) {
      const double over = m.shear * (size - grown) - m.yield(kappa + grown);
      grown = std::max(0.0, grown + over / (m.shear + m.rise(kappa + grown)));
    }
    const double share = std::clamp(1 - grown / size, 1e-3, 1.0);
    strain = share * trial;
    d = (1 / share - 1) / m.shear;
  };
  const auto lies = [&](bool full) {
    const double norm = elastic_point(m, strain).stress.norm();
    return full ? norm >= m.yield(m.limit) : d * norm <= room;
  };
  begin(false);
  if (newton(false) && lies(false)) return strain;
  begin(true);
  if (newton(true) && lies(true)) return strain;
  double low = 0, high = 1 / m.shear;
  while (excess(elastic_point(m, flowed_by(m, trial, high)).stress.norm(), high) > 0 && high * m.shear < 1e9) high *= 2;
  for (int pass = 0; pass < 60 && high - low > 1e-15 * high; ++pass) {
    d = 0.5 * (low + high);
    strain = flowed_by(m, trial, d);
    (excess(elastic_point(m, strain).stress.norm(), d) > 0 ? low : high) = d;
  }
  return strain;
}

// Principal P and A for the signed stretches s.
struct Principal {
  double energy = 0;
  Vector3d p;
  Matrix3d a;
  bool elastic = true;
};

Principal elastic_principal(const ReferenceMaterial& m, const Vector3d& s) {
  Principal out;
  const double j = s.prod(), spread = j - m.gamma, rest = 1 - m.gamma;
  const Vector3d cofactor(s[1] * s[2], s[2] * s[0], s[0] * s[1]);
  out.energy = 0.5 * (m.mu * (s.squaredNorm() - 3) + m.l * (spread * spread - rest * rest));
  out.p = m.mu * s + m.l * spread * cofactor;
  out.a = m.l * cofactor * cofactor.transpose();
  for (int i = 0; i < 3; ++i) {
    out.a(i, i) += m.mu;
    for (int k = 0; k < 3; ++k) {
      if (k != i) out.a(i, k) += m.l * spread * s[3 - i - k];
    }
  }
  return out;
}

Principal mapped_principal(const ReferenceMaterial& m, const Vector3d& s, double kappa) {
  if (s.prod() <= smallest_flowing_ratio) return elastic_principal(m, s);
  const Mapped mapped = map_strain(m, s.array().log(), kappa);
  if (mapped.growth == 0) return elastic_principal(m, s);
  Principal out;
  out.elastic = false;
  out.energy = mapped.energy;
  out.p = mapped.stress.cwiseQuotient(s);
  out.a = mapped.tangent;
  out.a.diagonal() -= mapped.stress;
  out.a.array() /= (s * s.transpose()).array();
  return out;
}

// Like secant(): deviator / (1 + shear D) and mean / (1 + bulk D), where D is such that the yield surface, grown by D |stress|,
// is met.
Vector3d secant_stress(const ReferenceMaterial& m, const Vector3d& s, double kappa, bool& elastic) {
  const double j = s.prod();
  const Vector3d tau = (m.mu * s.cwiseAbs2()).array() + m.l * (j - m.gamma) * j;
  const double room = m.limit - kappa;
  const double mean = std::sqrt(3.0) * tau.mean(), deviator = (tau.array() - tau.mean()).matrix().norm();
  elastic = tau.norm() <= m.yield(kappa) || room <= 0;
  if (elastic) return elastic_principal(m, s).p;
  const auto norm = [&](double d) { return std::hypot(deviator / (1 + m.shear * d), mean / (1 + m.bulk * d)); };
  const auto excess = [&](double d) { return std::min(norm(d) - m.yield(kappa + d * norm(d)), room - d * norm(d)); };
  double low = 0, high = 1 / m.shear;
  while (excess(high) > 0 && high * m.shear < 1e9) high *= 2;
  for (int pass = 0; pass < 200 && high - low > 1e-16 * high; ++pass) {
    const double middle = 0.5 * (low + high);
    (excess(middle) > 0 ? low : high) = middle;
  }
  const double mu = m.mu / (1 + m.shear * low), l = (m.bulk / (1 + m.bulk * low) + mu) / 3;
  return elastic_principal({mu, l, 1 + mu / l, 0, 0, 0, 0, 0, 0, 0, 0}, s).p;
}

Principal secant_principal(const ReferenceMaterial& m, const Vector3d& s, double kappa) {
  bool elastic;
  const Vector3d p = secant_stress(m, s, kappa, elastic);
  if (elastic) return elastic_principal(m, s);
  Principal out;
  out.elastic = false;
  out.p = p;
  constexpr double step = 1e-6;
  for (int k = 0; k < 3; ++k) {
    bool unused;
    const Vector3d d = step * Vector3d::Unit(k);
    out.a.col(k) = (secant_stress(m, s + d, kappa, unused) - secant_stress(m, s - d, kappa, unused)) / (2 * step);
  }
  return out;
}

// F = u diag(s) v^T with u and v rotations.
struct Polar {
  Matrix3d u, v;
  Vector3d s;
};
Polar polar(const Matrix3d& f) {
  const Eigen::JacobiSVD<Matrix3d> svd(f, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Polar out{svd.matrixU(), svd.matrixV(), svd.singularValues()};
  if (out.u.determinant() < 0) {
    out.u.col(2) *= -1;
    out.s[2] *= -1;
  }
  if (out.v.determinant() < 0) {
    out.v.col(2) *= -1;
    out.s[2] *= -1;
  }
  return out;
}

}  // namespace

double ReferenceMaterial::yield(double kappa) const {
  const double beyond = std::max(0.0, kappa - dense_from);
  return start + slope * kappa / (1 + fold * kappa) + dense * beyond * beyond;
}

double ReferenceMaterial::rise(double kappa) const {
  return slope / ((1 + fold * kappa) * (1 + fold * kappa)) + 2 * dense * std::max(0.0, kappa - dense_from);
}

double ReferenceMaterial::plastic(double kappa, double growth) const {
  const auto cube = [&](double k) { return std::pow(std::max(0.0, k - dense_from), 3); };
  const double folds = growth - std::log1p(fold * growth / (1 + fold * kappa)) / fold;
  return start * growth + slope / fold * folds + dense / 3 * (cube(kappa + growth) - cube(kappa));
}

ReferenceMaterial reference_material(const Material& material, double volume_ratio) {
  const double e = material.young_modulus, nu = material.poisson_ratio;
  const double mu = e / (2 * (1 + nu)), lambda = e * nu / ((1 + nu) * (1 - 2 * nu));
  return {mu,
          lambda + mu,
          1 + mu / (lambda + mu),
          2 * mu,
          3 * lambda + 2 * mu,
          e * double(material.yield_strain) * volume_ratio,
          e * double(material.hardening) * volume_ratio,
          1 / double(material.hardening_strain),
          e * double(material.densification) * volume_ratio,
          double(material.densification_strain),
          double(material.plastic_limit)};
}

Mapped map_strain(const ReferenceMaterial& m, const Vector3d& trial, double kappa) {
  Mapped out = elastic_point(m, trial);
  const double room = m.limit - kappa;
  if (out.stress.norm() <= m.yield(kappa) || room <= 0) return out;
  const Vector3d strain = flowed_strain(m, trial, kappa), q = trial - strain;
  const double size = q.norm();
  const bool full = size > room * (1 - 1e-9);
  const Vector3d n = q / size;
  out = elastic_point(m, strain);
  out.growth = size;
  out.work = m.plastic(kappa, size);
  out.energy += out.work;
  // tangent = (H^-1 + S^-1)^-1 with H the Hessian of psi and S the Hessian of the plastic work. Across n the stiffness of the
  // plastic work is |stress| / |q|.
  const Matrix3d along = n * n.transpose();
  const double softest = 1e-9 * m.shear;
  const Matrix3d give = (full ? 0 : 1 / std::max(m.rise(kappa + size), softest)) * along +
                        size / std::max(out.stress.norm(), softest) * (Matrix3d::Identity() - along);
  out.tangent = (out.tangent.inverse() + give).inverse();
  return out;
}

Mapped flow_strain(const ReferenceMaterial& m, const Vector3d& trial, double kappa) {
  Mapped out = elastic_point(m, trial);
  const double room = m.limit - kappa;
  if (out.stress.norm() <= m.yield(kappa) || room <= 0) return out;
  const double mean = trial.mean();
  const Vector3d deviator = trial.array() - mean;
  const auto left = [&](double s) -> Vector3d { return (s * deviator).array() + mean * s / (s + m.bulk / m.shear * (1 - s)); };
  double low = 0, high = 1;
  for (int pass = 0; pass < 200 && high - low > 1e-17; ++pass) {
    const double s = 0.5 * (low + high), growth = (trial - left(s)).norm();
    const double norm = elastic_point(m, left(s)).stress.norm();
    (norm > m.yield(kappa + growth) && growth < room ? high : low) = s;
  }
  out = elastic_point(m, left(high));
  out.growth = (trial - out.strain).norm();
  out.work = m.plastic(kappa, out.growth);
  return out;
}

TetLaw tet_law(FlowLaw law, const ReferenceMaterial& m, const Matrix3d& f, double kappa, bool want_tangent, bool project) {
  const auto [u, v, s] = polar(f);
  Principal point;
  if (law == FlowLaw::mapped) {
    point = mapped_principal(m, s, kappa);
  } else if (want_tangent) {
    point = secant_principal(m, s, kappa);
  } else {
    bool unused;
    point.p = secant_stress(m, s, kappa, unused);
  }
  TetLaw out;
  out.energy = point.energy;
  out.stress = u * point.p.asDiagonal() * v.transpose();
  if (!want_tangent) return out;

  // Stretching along the axes: A. For each pair of axes: shear, (P_i - P_k) / (s_i - s_k), and rotation,
  // (P_i + P_k) / (s_i + s_k).
  Matrix3d a = 0.5 * (point.a + point.a.transpose());
  if (project) {
    const Eigen::SelfAdjointEigenSolver<Matrix3d> axes(a);
    a = axes.eigenvectors() * axes.eigenvalues().cwiseMax(0).asDiagonal() * axes.eigenvectors().transpose();
  }
  using Vector9d = Eigen::Matrix<double, 9, 1>;
  const auto stacked = [&u = u, &v = v](int i, int k) -> Vector9d {  // clang 14 captures no bindings by [&]
    const Matrix3d outer = u.col(i) * v.col(k).transpose();
    return Eigen::Map<const Vector9d>(outer.data());
  };
  out.tangent.setZero();
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) out.tangent += a(i, k) * stacked(i, i) * stacked(k, k).transpose();
  }
  for (int i = 0; i < 3; ++i) {
    const int k = (i + 1) % 3;
    double shear, turn;
    if (point.elastic) {
      const double bend = m.l * (s.prod() - m.gamma) * s[3 - i - k];
      shear = m.mu - bend;
      turn = m.mu + bend;
    } else {
      shear = std::fabs(s[i] - s[k]) > 1e-6 ? (point.p[i] - point.p[k]) / (s[i] - s[k])
                                            : 0.5 * (point.a(i, i) + point.a(k, k) - point.a(i, k) - point.a(k, i));
      turn = (point.p[i] + point.p[k]) / (s[i] + s[k]);
    }
    if (project) shear = std::max(0.0, shear), turn = std::max(0.0, turn);
    const Vector9d ik = stacked(i, k), ki = stacked(k, i);
    out.tangent += 0.5 * shear * (ik + ki) * (ik + ki).transpose() + 0.5 * turn * (ik - ki) * (ik - ki).transpose();
  }
  return out;
}

Flowed flow_reference(FlowLaw law, const ReferenceMaterial& m, const Matrix3d& f, double kappa) {
  const auto [u, v, s] = polar(f);
  Flowed out;
  if (s.prod() <= smallest_flowing_ratio) return out;
  const Vector3d trial = s.array().log();
  const Mapped left = law == FlowLaw::mapped ? map_strain(m, trial, kappa) : flow_strain(m, trial, kappa);
  out.growth = left.growth;
  out.work = left.work;
  out.factor = v * Vector3d((left.strain - trial).array().exp()).asDiagonal() * v.transpose();
  return out;
}

}  // namespace crumple

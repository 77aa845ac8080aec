#include "reference/bar.h"

#include <algorithm>
#include <cmath>

#include "sim/flow.h"

namespace crumple {
namespace {

// Elastic force along x on the nodes that `pulled` marks, N.
double force_on(const std::vector<uint8_t>& pulled, const Model& model, const Material& material, const DeformableState& body) {
  const Elastic e = elastic(material);
  double force = 0;
  for (size_t t = 0; t < model.tet.size(); ++t) {
    const uint32_t* n = model.tet[t].node;
    const Mat3 f = deformation(body.node[n[0]], body.node[n[1]], body.node[n[2]], body.node[n[3]], body.gradients[t]);
    const float j = f.determinant();
    const Mat3 stress = e.mu * f + e.l * (j - e.gamma) * j * f.inverse().transpose();
    const auto& g = body.gradients[t].corner;
    for (int corner = 0; corner < 4; ++corner) {
      if (!pulled[n[corner]]) continue;
      const Vec3 gradient = corner > 0 ? g[corner - 1] : Vec3(-g[0] - g[1] - g[2]);
      force += double(model.tet_rest[t] * (stress * gradient).x());
    }
  }
  return force;
}

}  // namespace

PulledBar pull_bar(const TetMesh& tets, double length, const Parameters& parameters) {
  std::vector<uint8_t> fixed, pulled, both;
  for (const Vec3& x : tets.node) {
    fixed.push_back(x.x() < 1e-5f * float(length));
    pulled.push_back(x.x() > (1 - 1e-5f) * float(length));
    both.push_back(fixed.back() | pulled.back());
  }
  HeldMesh held(tets, both, 100);
  const HeldMesh free(tets, fixed, 100);
  const ScratchHandle scratch = make_scratch();
  PulledBar out{0, 0, make_body(held.model())};
  for (int k = 1; k <= pull_substeps + hold_substeps; ++k) {
    const double stretch = 1 + bar_pull * std::min(k, pull_substeps) / pull_substeps;
    for (size_t i = 0; i < tets.node.size(); ++i) {
      if (pulled[i]) held.place[i].x() = float(stretch) * tets.node[i].x();
    }
    hold(held, parameters, {}, *scratch, out.body);
  }
  out.force = force_on(pulled, held.model(), parameters.region[0], out.body);
  come_to_rest(free, parameters, *scratch, out.body);
  int count = 0;
  for (size_t i = 0; i < tets.node.size(); ++i) {
    if (!pulled[i]) continue;
    out.set += double(out.body.node[i].x()) / length - 1;
    ++count;
  }
  out.set /= count;
  return out;
}

double closed_form_set(const Material& material) {
  const auto plastic = [&](double r) { return std::log((1 + bar_pull) / r); };
  const auto yield = [&](double kappa) {
    const double beyond = std::max(0.0, kappa - double(material.densification_strain));
    return double(material.yield_strain) +
           double(material.hardening) * kappa / (1 + kappa / double(material.hardening_strain)) +
           double(material.densification) * beyond * beyond;
  };
  double low = 1, high = 1 + bar_pull;  // of the elastic stretch
  for (int k = 0; k < 60; ++k) {
    const double r = 0.5 * (low + high);
    const double stress = 0.5 * (r * r - (2 * r - 1) / (r * r));
    (stress < std::exp(plastic(r)) * yield(plastic(r)) ? low : high) = r;
  }
  return std::expm1(plastic(low));
}

}  // namespace crumple

// The loops behind kernels.h for N lanes at a time. One source per instruction set includes this file. It must share no inline
// function with the rest of the program: the linker might keep the copy that was compiled for a newer processor.
#pragma once

#include <bit>
#include <initializer_list>

#include "sim/anderson_kernels_of.h"
#include "sim/kernels.h"

namespace crumple {
namespace {

template <int N>
struct Block {
  Vec3s<N> gradient;
  Floats<N> xx, yy, zz, xy, xz, yz;
};

// With w_o the dot product of the node's gradient and corner o's, and e_o the edge to that corner: F gradient = sum w_o e_o,
// |gradient|^2 = - sum w_o, J = D e_0 . N, dJ = - D N.
template <int N>
CRUMPLE_INLINE Block<N> gather_block(const NodeView& v, uint32_t block, int lane, const Vec3s<N>& position,
                                     const Float4s<N>& before) {
  const Floats<N> drag = before.w;
  Block<N> out{(position - before.xyz()) * drag, drag, drag, drag, {}, {}, {}};
  if (v.anchored[block]) {
    const Float4s<N> rest = gather<N>(v.rest, &v.index[lanes * block + lane]);
    out.gradient = out.gradient + (position - rest.xyz()) * rest.w;
    out.xx += rest.w;
    out.yy += rest.w;
    out.zz += rest.w;
  }
  Floats<N> diagonal{};
  for (uint32_t r = v.row[block]; r < v.row[block + 1]; ++r) {
    const Row& row = v.rows[r];
    const Weights& weights = v.weights[r];
    const Float4s<N> s = gather<N>(v.stiffness, row.tet + lane);
    const Vec3s<N> a = gather<N>(v.node, row.other[0] + lane).xyz() - position;
    const Vec3s<N> b = gather<N>(v.node, row.other[1] + lane).xyz() - position;
    const Vec3s<N> c = gather<N>(v.node, row.other[2] + lane).xyz() - position;
    const Floats<N> wa = s.x * load<N>(weights.other[0] + lane);
    const Floats<N> wb = s.x * load<N>(weights.other[1] + lane);
    const Floats<N> wc = s.x * load<N>(weights.other[2] + lane);
    const Vec3s<N> normal = cross(b - a, c - a);
    const Floats<N> pull = s.y * (dot(a, normal) - s.z);
    out.gradient = out.gradient + (a * wa + b * wb + c * wc - normal * pull);
    diagonal -= wa + wb + wc;
    const Vec3s<N> q = normal * s.y;
    out.xx += q.x * normal.x;
    out.yy += q.y * normal.y;
    out.zz += q.z * normal.z;
    out.xy += q.x * normal.y;
    out.xz += q.x * normal.z;
    out.yz += q.y * normal.z;
  }
  out.xx += diagonal;
  out.yy += diagonal;
  out.zz += diagonal;
  return out;
}

// hessian^-1 gradient. Both are scaled by a power of two first, because the determinant of a stiff and far stretched block is
// beyond single precision. The scaling changes no bit of the result.
template <int N>
CRUMPLE_INLINE Vec3s<N> solve(const Block<N>& block) {
  const Floats<N> trace = block.xx + block.yy + block.zz;
  const Floats<N> down = 1.0f / larger((Floats<N>)((Ints<N>)trace & 0x7f800000), broadcast<N>(1e-30f));
  Block<N> b = block;
  for (Floats<N>* each : {&b.xx, &b.yy, &b.zz, &b.xy, &b.xz, &b.yz}) *each *= down;
  const Floats<N> xx = b.yy * b.zz - b.yz * b.yz, xy = b.xz * b.yz - b.xy * b.zz, xz = b.xy * b.yz - b.xz * b.yy;
  const Floats<N> yy = b.xx * b.zz - b.xz * b.xz, yz = b.xy * b.xz - b.xx * b.yz, zz = b.xx * b.yy - b.xy * b.xy;
  const Floats<N> scale = 1.0f / (b.xx * xx + b.xy * xy + b.xz * xz);
  const Vec3s<N> g = b.gradient * down;
  return {(xx * g.x + xy * g.y + xz * g.z) * scale, (xy * g.x + yy * g.y + yz * g.z) * scale,
          (xz * g.x + yz * g.y + zz * g.z) * scale};
}

template <int N>
void relax_nodes(const NodeView& v, uint32_t first, uint32_t last) {
  for (uint32_t block = first; block < last; ++block) {
    const unsigned still = v.still[block], touched = v.touched[block];
    if ((v.measure || still == 0xffff) && touched == 0) continue;
    for (int lane = 0; lane < lanes; lane += N) {
      const uint32_t* index = &v.index[lanes * block + lane];
      const Float4s<N> position = gather<N>(v.node, index), before = gather<N>(v.before, index);
      const Block<N> b = gather_block<N>(v, block, lane, position.xyz(), before);
      if (!v.measure) {
        const Vec3s<N> target = position.xyz() - solve<N>(b) * broadcast<N>(v.relaxation);
        scatter<N>(target, v.node, index, still >> lane);
      }
      if (touched >> lane == 0) continue;
      for (int k = 0; k < N; ++k) {
        if (!(touched >> (lane + k) & 1)) continue;
        const float gradient[3] = {b.gradient.x[k], b.gradient.y[k], b.gradient.z[k]};
        const float hessian[6] = {b.xx[k], b.yy[k], b.zz[k], b.xy[k], b.xz[k], b.yz[k]};
        v.resolve(v.context, index[k], gradient, hessian);
      }
    }
  }
}

template <int N>
struct LawLanes {
  Floats<N> mu, l, gamma, shear, bulk, start, slope, fold, dense, dense_from, limit;
  bool isotropic;  // shear equals bulk everywhere, so there is nothing to iterate
};

template <int N>
CRUMPLE_INLINE LawLanes<N> laws(const TetView& v, const uint8_t* region) {
  bool uniform = true;
  for (int k = 1; k < N; ++k) uniform &= region[k] == region[0];
  LawLanes<N> out;
  const Law& law = v.law[region[0]];
  out.isotropic = law.shear == law.bulk;
  out.mu = broadcast<N>(law.mu);
  out.l = broadcast<N>(law.l);
  out.gamma = broadcast<N>(law.gamma);
  out.shear = broadcast<N>(law.shear);
  out.bulk = broadcast<N>(law.bulk);
  out.start = broadcast<N>(law.start);
  out.slope = broadcast<N>(law.slope);
  out.fold = broadcast<N>(law.fold);
  out.dense = broadcast<N>(law.dense);
  out.dense_from = broadcast<N>(law.dense_from);
  out.limit = broadcast<N>(law.room);
  if (uniform) return out;
  for (int k = 1; k < N; ++k) {
    const Law& other = v.law[region[k]];
    out.isotropic &= other.shear == other.bulk;
    out.mu[k] = other.mu;
    out.l[k] = other.l;
    out.gamma[k] = other.gamma;
    out.shear[k] = other.shear;
    out.bulk[k] = other.bulk;
    out.start[k] = other.start;
    out.slope[k] = other.slope;
    out.fold[k] = other.fold;
    out.dense[k] = other.dense;
    out.dense_from[k] = other.dense_from;
    out.limit[k] = other.room;
  }
  return out;
}

template <int N>
struct Matrices {
  Vec3s<N> col[3];
};

template <int N>
CRUMPLE_INLINE Vec3s<N> gradient_row(const TetLanes& tet, int lane, int corner) {
  return {load<N>(tet.gradient[3 * corner] + lane), load<N>(tet.gradient[3 * corner + 1] + lane),
          load<N>(tet.gradient[3 * corner + 2] + lane)};
}

template <int N>
struct Edges {
  Vec3s<N> a, b, c;
};
template <int N>
CRUMPLE_INLINE Edges<N> edges_of(const Float4* node, const TetGroup& group, int lane) {
  const Vec3s<N> origin = gather<N>(node, group.node[0] + lane).xyz();
  return {gather<N>(node, group.node[1] + lane).xyz() - origin, gather<N>(node, group.node[2] + lane).xyz() - origin,
          gather<N>(node, group.node[3] + lane).xyz() - origin};
}

template <int N>
CRUMPLE_INLINE Matrices<N> deformation_of(const Edges<N>& e, const Vec3s<N>& ga, const Vec3s<N>& gb, const Vec3s<N>& gc) {
  return {{e.a * ga.x + e.b * gb.x + e.c * gc.x, e.a * ga.y + e.b * gb.y + e.c * gc.y, e.a * ga.z + e.b * gb.z + e.c * gc.z}};
}

// The yield stress is at least that of a strain of 1e-5: without any yield stress a tet would be a fluid.
template <int N>
CRUMPLE_INLINE Floats<N> yield_of(const LawLanes<N>& law, const Floats<N>& kappa) {
  const Floats<N> left = 1.0f / (1.0f + kappa * law.fold), beyond = larger(kappa - law.dense_from, Floats<N>{});
  return larger(law.start + law.slope * kappa * left + law.dense * beyond * beyond, 1e-5f * larger(law.shear, law.bulk));
}
template <int N>
CRUMPLE_INLINE Floats<N> slope_of(const LawLanes<N>& law, const Floats<N>& kappa) {
  const Floats<N> left = 1.0f / (1.0f + kappa * law.fold);
  return law.slope * left * left + 2.0f * law.dense * larger(kappa - law.dense_from, Floats<N>{});
}

// volume_ratio() and crushed() of flow.h. D: determinant of the gradients, 1/m^3.
template <int N>
CRUMPLE_INLINE void crush(const Floats<N>& volume, const Floats<N>& D, LawLanes<N>& law) {
  Floats<N> ratio = 1.0f / (6.0f * volume * D);
  const Floats<N> bounded = smaller(larger(ratio, broadcast<N>(least_volume_ratio)), broadcast<N>(most_volume_ratio));
  ratio = ratio > 0.0f ? bounded : broadcast<N>(1);
  law.start *= ratio;
  law.slope *= ratio;
  law.dense *= ratio;
}

// plastic_multiplier() of flow.h; 0 where the tet stays elastic.
template <int N>
CRUMPLE_INLINE Floats<N> multiplier(const LawLanes<N>& law, const Floats<N>& deviator2, const Floats<N>& mean,
                                    const Floats<N>& kappa) {
  const Floats<N> norm = root<N>(deviator2 + 3.0f * mean * mean);
  const Floats<N> stiffest = larger(law.shear, law.bulk);
  const Floats<N> yield = yield_of<N>(law, kappa);
  const Floats<N> room = law.limit - kappa;
  const Floats<N> none{}, most = larger(room, none);
  Floats<N> grown{};
  for (int i = 0; i < growth_steps; ++i) {
    const Floats<N> value = norm - stiffest * grown - yield_of<N>(law, kappa + grown);
    grown = smaller(larger(grown + value / (stiffest + slope_of<N>(law, kappa + grown)), none), most);
  }
  Floats<N> d = grown / (norm - stiffest * grown);
  if (!law.isotropic) {
    const Floats<N> deviator = root<N>(deviator2);
    const Floats<N> pressure = 1.7320508f * (mean < 0.0f ? -mean : mean);
    for (int i = 0; i < 5; ++i) {
      const Floats<N> da = 1.0f + law.shear * d, db = 1.0f + law.bulk * d;
      const Floats<N> a = deviator / da, b = pressure / db;
      const Floats<N> left = larger(root<N>(a * a + b * b), broadcast<N>(1e-20f));
      const Floats<N> fall = (a * a * law.shear / da + b * b * law.bulk / db) / left;
      const Floats<N> now = kappa + smaller(d * left, most), slope = slope_of<N>(law, now);
      const Floats<N> step = (left - yield_of<N>(law, now)) / (fall + slope * larger(left - d * fall, none));
      d = law.shear != law.bulk ? larger(d + step, none) : d;
    }
    const Floats<N> flowed = norm / (1.0f + stiffest * d), gap = norm - stiffest * room;
    d = (d * flowed > room) & (gap > 0.0f) ? room / gap : d;
  }
  return (norm > yield) & (room > 0.0f) ? d : Floats<N>{};
}

constexpr float lost_volume = 0.02f;  // share of a tet's volume left
constexpr float lost_stretch = 6;     // mean squared stretch: four times as long in one direction, or 2.5 times in all

template <int N>
uint32_t update_secant_moduli(const TetView& v, uint32_t first, uint32_t last, Float4* stiffness, uint16_t* flowing) {
  uint32_t lost = 0;
  for (uint32_t g = first; g < last; ++g) {
    if (!v.stirred[g]) continue;
    const bool changes = flowing[g] != 0;  // some lane was beyond yield in the last update
    unsigned beyond = 0;
    for (int lane = 0; lane < lanes; lane += N) {
      const TetLanes& tet = v.tet[g];
      LawLanes<N> law = laws<N>(v, v.region + lanes * g + lane);
      const Vec3s<N> ga = gradient_row<N>(tet, lane, 0), gb = gradient_row<N>(tet, lane, 1), gc = gradient_row<N>(tet, lane, 2);
      const Matrices<N> f = deformation_of<N>(edges_of<N>(v.node, v.group[g], lane), ga, gb, gc);
      const Floats<N> j = dot(f.col[0], cross(f.col[1], f.col[2]));
      // tau = mu F F^T + l (J - gamma) J I
      const auto entry = [&](const Floats<N> Vec3s<N>::*r, const Floats<N> Vec3s<N>::*c) {
        return f.col[0].*r * (f.col[0].*c) + f.col[1].*r * (f.col[1].*c) + f.col[2].*r * (f.col[2].*c);
      };
      const auto X = &Vec3s<N>::x, Y = &Vec3s<N>::y, Z = &Vec3s<N>::z;
      const Floats<N> xx = entry(X, X), yy = entry(Y, Y), zz = entry(Z, Z), xy = entry(X, Y), xz = entry(X, Z),
                      yz = entry(Y, Z);
      const Floats<N> third = (xx + yy + zz) * (1.0f / 3);
      const Floats<N> dx = xx - third, dy = yy - third, dz = zz - third;
      const Floats<N> deviator2 = law.mu * law.mu * (dx * dx + dy * dy + dz * dz + 2.0f * (xy * xy + xz * xz + yz * yz));
      const Floats<N> mean = law.mu * third + law.l * (j - law.gamma) * j;
      const Floats<N> volume = load<N>(tet.volume + lane);
      lost += uint32_t(std::popcount(bits<N>(((j <= lost_volume) | (third > lost_stretch)) & (volume > 0.0f))));
      const Floats<N> yield = load<N>(tet.yield + lane);
      if (!changes && !any<N>(deviator2 + 3.0f * mean * mean > yield * yield)) continue;
      const Floats<N> D = dot(ga, cross(gb, gc));
      crush<N>(volume, D, law);
      const Floats<N> d = multiplier<N>(law, deviator2, mean, load<N>(tet.kappa + lane));
      const Floats<N> mu = law.mu / (1.0f + law.shear * d);
      const Floats<N> l = (law.bulk / (1.0f + law.bulk * d) + mu) * (1.0f / 3);  // lambda + mu, from 3 K = 3 lambda + 2 mu
      const Floats<N> x = volume * mu, y = volume * l * D * D;
      const Floats<N> z = D > 0.0f ? (1.0f + mu / l) / D : Floats<N>{};
      uint32_t index[N];
      for (int k = 0; k < N; ++k) index[k] = lanes * g + lane + k;
      scatter<N>({x, y, z}, stiffness, index, 0);
      beyond |= bits<N>(d > 0.0f) << lane;
    }
    flowing[g] = uint16_t(beyond);
  }
  return lost;
}

template <int N>
void line_derivative(const TetView& v, uint32_t first, uint32_t last, const Float4* stiffness, const Float4* direction,
                     double derivative[6]) {
  constexpr uint32_t together = 16;  // this many groups are summed in single precision, then in double
  for (uint32_t begin = first; begin < last; begin += together) {
    Floats<N> sum[lanes / N][6] = {};
    for (uint32_t g = begin; g < last && g < begin + together; ++g) {
      if (!v.stirred[g]) continue;
      for (int part = 0; part < lanes / N; ++part) {
        const int lane = part * N;
        const Edges<N> f = edges_of<N>(direction, v.group[g], lane);
        const Floats<N> moved = dot(f.a, f.a) + dot(f.b, f.b) + dot(f.c, f.c);
        bool any = false;
        for (int k = 0; k < N; ++k) any |= moved[k] > 0;
        if (!any) continue;
        const TetLanes& tet = v.tet[g];
        const Vec3s<N> ga = gradient_row<N>(tet, lane, 0), gb = gradient_row<N>(tet, lane, 1),
                       gc = gradient_row<N>(tet, lane, 2);
        const Edges<N> e = edges_of<N>(v.node, v.group[g], lane);
        const Matrices<N> f0 = deformation_of<N>(e, ga, gb, gc), f1 = deformation_of<N>(f, ga, gb, gc);
        uint32_t index[N];
        for (int k = 0; k < N; ++k) index[k] = lanes * g + lane + k;
        const Float4s<N> s = gather<N>(stiffness, index);
        // Six times the volume along the line, j0 + j1 a + j2 a^2 + j3 a^3, minus its preferred value.
        const Vec3s<N> ebc = cross(e.b, e.c), fbc = cross(f.b, f.c), mixed = cross(f.b, e.c) + cross(e.b, f.c);
        const Floats<N> j0 = dot(e.a, ebc) - s.z, j1 = dot(f.a, ebc) + dot(e.a, mixed), j2 = dot(f.a, mixed) + dot(e.a, fbc),
                        j3 = dot(f.a, fbc);
        Floats<N>* d = sum[part];
        d[0] += s.x * (dot(f0.col[0], f1.col[0]) + dot(f0.col[1], f1.col[1]) + dot(f0.col[2], f1.col[2])) + s.y * j0 * j1;
        d[1] += s.x * (dot(f1.col[0], f1.col[0]) + dot(f1.col[1], f1.col[1]) + dot(f1.col[2], f1.col[2])) +
                s.y * (j1 * j1 + 2.0f * j0 * j2);
        d[2] += s.y * (3.0f * (j1 * j2 + j0 * j3));
        d[3] += s.y * (2.0f * j2 * j2 + 4.0f * j1 * j3);
        d[4] += s.y * (5.0f * j2 * j3);
        d[5] += s.y * (3.0f * j3 * j3);
      }
    }
    for (int k = 0; k < 6; ++k) {
      for (int part = 0; part < lanes / N; ++part) {
        for (int lane = 0; lane < N; ++lane) derivative[k] += double(sum[part][k][lane]);
      }
    }
  }
}

// One Jacobi rotation, which makes a_pq zero. r is the third row and column; the axes rotate too.
template <int N>
CRUMPLE_INLINE void rotate(Floats<N>& app, Floats<N>& aqq, Floats<N>& apq, Floats<N>& arp, Floats<N>& arq, Vec3s<N>& p,
                           Vec3s<N>& q) {
  const Floats<N> theta = (aqq - app) / (2.0f * apq);
  const Floats<N> size = 1.0f / (magnitude<N>(theta) + root<N>(theta * theta + 1.0f));
  const Ints<N> done = magnitude<N>(apq) < 1e-30f;
  const Floats<N> t = done ? Floats<N>{} : theta < 0.0f ? -size : size;
  const Floats<N> c = 1.0f / root<N>(t * t + 1.0f), s = t * c;
  app -= t * apq;
  aqq += t * apq;
  apq = Floats<N>{};
  const Floats<N> rp = c * arp - s * arq;
  arq = s * arp + c * arq;
  arp = rp;
  const Vec3s<N> new_p = p * c - q * s;
  q = p * s + q * c;
  p = new_p;
}

// The trial state: the input of the root search below.
template <int N>
struct Trial {
  LawLanes<N> law;
  Vec3s<N> deviator;
  Floats<N> mean, kappa, room;
};
template <int N>
struct Flowed {
  Vec3s<N> change;  // of the elastic principal strains
  Floats<N> norm, grown, excess;
};

// The state with the deviator at s of the trial's and the mean at 1 / (1 + (bulk / shear) (1/s - 1)) of the trial's; see
// flow.h.
template <int N>
CRUMPLE_INLINE Flowed<N> flowed_at(const Trial<N>& t, const Floats<N>& s) {
  const LawLanes<N>& law = t.law;
  const Floats<N> part = s / (s + law.bulk / law.shear * (1.0f - s));
  const Floats<N> m = t.mean * part;
  const Vec3s<N> stretch = {exp_of<N>(s * t.deviator.x + m), exp_of<N>(s * t.deviator.y + m), exp_of<N>(s * t.deviator.z + m)};
  const Floats<N> j = stretch.x * stretch.y * stretch.z;
  const Floats<N> pressure = law.l * (j - law.gamma) * j;
  const Vec3s<N> tau = {law.mu * stretch.x * stretch.x + pressure, law.mu * stretch.y * stretch.y + pressure,
                        law.mu * stretch.z * stretch.z + pressure};
  const Floats<N> fall = (part - 1.0f) * t.mean;
  Flowed<N> out;
  out.change = {(s - 1.0f) * t.deviator.x + fall, (s - 1.0f) * t.deviator.y + fall, (s - 1.0f) * t.deviator.z + fall};
  out.norm = root<N>(dot(tau, tau));
  out.grown = root<N>(dot(out.change, out.change));
  out.excess = smaller((out.norm - yield_of<N>(law, t.kappa + out.grown)) / law.shear, t.room - out.grown);
  return out;
}

// The root search stops at this excess of stress over shear modulus: a ten-thousandth of the yield strain.
constexpr float root_tolerance = 1e-6f;

template <int N>
double flow(const TetView& v, TetLanes* tets, uint32_t first, uint32_t last, const uint16_t* flowing) {
  double work = 0;
  for (uint32_t g = first; g < last; ++g) {
    const unsigned all = v.stirred[g] ? flowing[g] : 0;
    if (all == 0) continue;
    for (int lane = 0; lane < lanes; lane += N) {
      const unsigned part = all >> lane & ((1u << N) - 1);
      if (part == 0) continue;
      TetLanes& tet = tets[g];
      Vec3s<N> gradient[3];
      for (int k = 0; k < 3; ++k) gradient[k] = gradient_row<N>(tet, lane, k);
      const Matrices<N> f = deformation_of<N>(edges_of<N>(v.node, v.group[g], lane), gradient[0], gradient[1], gradient[2]);
      const Floats<N> j = dot(f.col[0], cross(f.col[1], f.col[2]));
      // F^T F = sum lambda_i axis_i axis_i^T
      Floats<N> xx = dot(f.col[0], f.col[0]), yy = dot(f.col[1], f.col[1]), zz = dot(f.col[2], f.col[2]);
      Floats<N> xy = dot(f.col[0], f.col[1]), xz = dot(f.col[0], f.col[2]), yz = dot(f.col[1], f.col[2]);
      const Floats<N> one = broadcast<N>(1), none{};
      Vec3s<N> ax = {one, none, none}, ay = {none, one, none}, az = {none, none, one};
      for (int round = 0; round < 4; ++round) {
        rotate<N>(xx, yy, xy, xz, yz, ax, ay);
        rotate<N>(xx, zz, xz, xy, yz, ax, az);
        rotate<N>(yy, zz, yz, xy, xz, ay, az);
      }
      const Floats<N> least = broadcast<N>(1e-6f);
      const Vec3s<N> strain = {0.5f * log_of<N>(larger(xx, least)), 0.5f * log_of<N>(larger(yy, least)),
                               0.5f * log_of<N>(larger(zz, least))};
      Trial<N> trial;
      trial.law = laws<N>(v, v.region + lanes * g + lane);
      const Floats<N> volume = load<N>(tet.volume + lane);
      crush<N>(volume, dot(gradient[0], cross(gradient[1], gradient[2])), trial.law);
      trial.mean = (strain.x + strain.y + strain.z) * (1.0f / 3);
      trial.deviator = {strain.x - trial.mean, strain.y - trial.mean, strain.z - trial.mean};
      trial.kappa = load<N>(tet.kappa + lane);
      trial.room = larger(trial.law.limit - trial.kappa, none);
      Floats<N> low = none, high = one, below = flowed_at<N>(trial, low).excess, above = flowed_at<N>(trial, high).excess;
      const Ints<N> flows = (above > 0.0f) & (below <= 0.0f) & (j > lost_volume);
      Floats<N> share = none;
      Ints<N> open = flows;  // each lane stops by itself, independent of its neighbours
      for (int round = 0; round < 12 && any<N>(open); ++round) {
        const Floats<N> s = (low * above - high * below) / (above - below);
        share = open ? s : share;
        const Floats<N> excess = flowed_at<N>(trial, s).excess;
        const Ints<N> too_much = excess > 0.0f;
        high = too_much ? s : high;
        low = too_much ? low : s;
        const Floats<N> next_above = too_much ? excess : 0.5f * above;
        below = too_much ? 0.5f * below : excess;
        above = next_above;
        open &= magnitude<N>(excess) > root_tolerance;
      }
      const Flowed<N> now = flowed_at<N>(trial, share);
      // The factor axes diag(exp(change)) axes^T is applied to the gradients.
      const Vec3s<N> grow = {exp_of<N>(now.change.x) - 1.0f, exp_of<N>(now.change.y) - 1.0f, exp_of<N>(now.change.z) - 1.0f};
      const auto yield_at = [&](float of) { return yield_of<N>(trial.law, trial.kappa + of * now.grown); };
      const Floats<N> energy =
          (5.0f * yield_at(0.11270167f) + 8.0f * yield_at(0.5f) + 5.0f * yield_at(0.88729833f)) * (1.0f / 18) * now.grown;
      const Floats<N> kappa = smaller(trial.law.limit, trial.kappa + now.grown);
      Vec3s<N> changed[3];
      for (int k = 0; k < 3; ++k) {
        const Vec3s<N>& g0 = gradient[k];
        changed[k] = g0 + ax * (grow.x * dot(ax, g0)) + ay * (grow.y * dot(ay, g0)) + az * (grow.z * dot(az, g0));
      }
      LawLanes<N> next = laws<N>(v, v.region + lanes * g + lane);
      crush<N>(volume, dot(changed[0], cross(changed[1], changed[2])), next);
      const Floats<N> yield = yield_of<N>(next, kappa);
      for (int k = 0; k < N; ++k) {
        if (!(part >> k & 1) || !flows[k]) continue;
        work += double(volume[k]) * double(energy[k] > 0 ? energy[k] : 0.0f);
        tet.kappa[lane + k] = kappa[k];
        tet.yield[lane + k] = yield[k];
        for (int corner = 0; corner < 3; ++corner) {
          tet.gradient[3 * corner][lane + k] = changed[corner].x[k];
          tet.gradient[3 * corner + 1][lane + k] = changed[corner].y[k];
          tet.gradient[3 * corner + 2][lane + k] = changed[corner].z[k];
        }
      }
    }
  }
  return work;
}

template <int N>
double energy(const TetView& v, uint32_t first, uint32_t last) {
  double sum = 0;
  for (uint32_t g = first; g < last; ++g) {
    for (int lane = 0; lane < lanes; lane += N) {
      const TetLanes& tet = v.tet[g];
      const LawLanes<N> law = laws<N>(v, v.region + lanes * g + lane);
      const Matrices<N> f = deformation_of<N>(edges_of<N>(v.node, v.group[g], lane), gradient_row<N>(tet, lane, 0),
                                              gradient_row<N>(tet, lane, 1), gradient_row<N>(tet, lane, 2));
      // As in energy_density(), by F - I.
      const Vec3s<N> a = {f.col[0].x - 1.0f, f.col[0].y, f.col[0].z}, b = {f.col[1].x, f.col[1].y - 1.0f, f.col[1].z},
                     c = {f.col[2].x, f.col[2].y, f.col[2].z - 1.0f};
      const Floats<N> second = a.x * b.y - a.y * b.x + a.x * c.z - a.z * c.x + b.y * c.z - b.z * c.y + dot(a, cross(b, c));
      const Floats<N> growth = a.x + b.y + c.z + second;
      const Floats<N> square = dot(a, a) + dot(b, b) + dot(c, c);
      const Floats<N> density = 0.5f * (law.mu * (square - 2.0f * second) + law.l * (growth * growth));
      const Floats<N> all = load<N>(tet.volume + lane) * density;
      for (int k = 0; k < N; ++k) sum += double(all[k]);
    }
  }
  return sum;
}

template <int N>
constexpr Kernels kernels_of(const char* name) {
  return {name, relax_nodes<N>, update_secant_moduli<N>, line_derivative<N>, flow<N>, energy<N>, anderson_kernels_of<N>()};
}

}  // namespace
}  // namespace crumple

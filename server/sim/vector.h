// N floats at once, in the compiler's own vectors. The same source serves 4, 8 and 16 lanes and gives the same bits, because
// every operation is IEEE's + - * / or square root, lane by lane, in one order.
#pragma once

#include <cstdint>

namespace crumple {

// A node in the layout of the kernels: a position, m, and one number that belongs to it.
struct alignas(16) Float4 {
  float x, y, z, w;
};

// All functions here must be inlined: the same template is compiled for several instruction sets.
#define CRUMPLE_INLINE [[gnu::always_inline]] inline

template <int N>
struct Lanes {
  typedef float Floats __attribute__((vector_size(4 * N)));
  typedef int32_t Ints __attribute__((vector_size(4 * N)));
  typedef float Unaligned __attribute__((vector_size(4 * N), aligned(4), may_alias));
};
template <int N>
using Floats = typename Lanes<N>::Floats;
template <int N>
using Ints = typename Lanes<N>::Ints;

template <int N>
CRUMPLE_INLINE Floats<N> load(const float* from) {
  return *reinterpret_cast<const typename Lanes<N>::Unaligned*>(from);
}
template <int N>
CRUMPLE_INLINE void store(const Floats<N>& v, float* to) {
  *reinterpret_cast<typename Lanes<N>::Unaligned*>(to) = v;
}
template <int N>
CRUMPLE_INLINE Floats<N> broadcast(float x) {
  return Floats<N>{} + x;
}
template <class V>
CRUMPLE_INLINE V larger(const V& a, const V& b) {
  return a > b ? a : b;
}
template <class V>
CRUMPLE_INLINE V smaller(const V& a, const V& b) {
  return a < b ? a : b;
}
template <int N>
CRUMPLE_INLINE Floats<N> root(const Floats<N>& v) {
  Floats<N> out;
  for (int k = 0; k < N; ++k) out[k] = __builtin_sqrtf(v[k]);
  return out;
}

template <int N>
CRUMPLE_INLINE Floats<N> magnitude(const Floats<N>& v) {
  return v < 0.0f ? -v : v;
}

template <int N>
CRUMPLE_INLINE unsigned bits(const Ints<N>& mask) {
#ifdef __AVX__  // one instruction; the compiler would extract lane by lane
  if constexpr (N == 8) return unsigned(__builtin_ia32_movmskps256((Floats<8>)mask));
#endif
  unsigned out = 0;
  for (int k = 0; k < N; ++k) out |= unsigned(mask[k] & 1) << k;
  return out;
}
template <int N>
CRUMPLE_INLINE bool any(const Ints<N>& mask) {
  return bits<N>(mask) != 0;
}

// Natural logarithm of a positive, normal number; absolute error below 1e-7 where it is below 1.
template <int N>
CRUMPLE_INLINE Floats<N> log_of(const Floats<N>& x) {
  const Ints<N> bits = (Ints<N>)x;
  Ints<N> exponent = (bits >> 23) - 127;
  Floats<N> m = (Floats<N>)((bits & 0x007fffff) | 0x3f800000);  // [1, 2)
  const Ints<N> high = m > 1.41421356f;
  m = high ? m * 0.5f : m;
  exponent -= high;  // a true lane is -1
  const Floats<N> s = (m - 1.0f) / (m + 1.0f), s2 = s * s;
  const Floats<N> series = ((s2 * (1.0f / 9) + 1.0f / 7) * s2 + 1.0f / 5) * s2 + 1.0f / 3;
  return 2.0f * s * (series * s2 + 1.0f) + __builtin_convertvector(exponent, Floats<N>) * 0.69314718f;
}

// Exponential of a number in [-80, 80]; relative error below 3e-7.
template <int N>
CRUMPLE_INLINE Floats<N> exp_of(const Floats<N>& x) {
  const Floats<N> shifted = x * 1.44269504f + 12582912.0f;  // adding 1.5 * 2^23 rounds to the nearest whole number
  const Floats<N> k = shifted - 12582912.0f;
  const Floats<N> r = (x - k * 0.693145752f) - k * 1.42860677e-6f;
  const Floats<N> series =
      (((((r * (1.0f / 720) + 1.0f / 120) * r + 1.0f / 24) * r + 1.0f / 6) * r + 0.5f) * r + 1.0f) * r + 1.0f;
  const Ints<N> scale = (__builtin_convertvector(k, Ints<N>) + 127) << 23;
  return series * (Floats<N>)scale;
}

template <int N>
struct Vec3s {
  Floats<N> x, y, z;
  CRUMPLE_INLINE Vec3s operator+(const Vec3s& o) const { return {x + o.x, y + o.y, z + o.z}; }
  CRUMPLE_INLINE Vec3s operator-(const Vec3s& o) const { return {x - o.x, y - o.y, z - o.z}; }
  CRUMPLE_INLINE Vec3s operator*(const Floats<N>& s) const { return {x * s, y * s, z * s}; }
};
template <int N>
CRUMPLE_INLINE Floats<N> dot(const Vec3s<N>& a, const Vec3s<N>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <int N>
CRUMPLE_INLINE Vec3s<N> cross(const Vec3s<N>& a, const Vec3s<N>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

template <int N>
struct Float4s {
  Floats<N> x, y, z, w;
  CRUMPLE_INLINE Vec3s<N> xyz() const { return {x, y, z}; }
};

// N records from any places, transposed. Whole 16-byte loads are faster than gathers of single floats.
template <int N>
CRUMPLE_INLINE Float4s<N> gather(const Float4* from, const uint32_t* index) {
  Floats<N> row[4];  // row[r] holds records r, 4 + r, 8 + r, ...
  for (int r = 0; r < 4; ++r) {
    if constexpr (N == 4) {
      row[r] = load<4>(&from[index[r]].x);
    } else if constexpr (N == 8) {
      row[r] = __builtin_shufflevector(load<4>(&from[index[r]].x), load<4>(&from[index[4 + r]].x), 0, 1, 2, 3, 4, 5, 6, 7);
    } else {
      const Floats<8> low =
          __builtin_shufflevector(load<4>(&from[index[r]].x), load<4>(&from[index[4 + r]].x), 0, 1, 2, 3, 4, 5, 6, 7);
      const Floats<8> high =
          __builtin_shufflevector(load<4>(&from[index[8 + r]].x), load<4>(&from[index[12 + r]].x), 0, 1, 2, 3, 4, 5, 6, 7);
      row[r] = __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    }
  }
  if constexpr (N == 4) {
    const auto a = __builtin_shufflevector(row[0], row[1], 0, 4, 1, 5), b = __builtin_shufflevector(row[2], row[3], 0, 4, 1, 5);
    const auto c = __builtin_shufflevector(row[0], row[1], 2, 6, 3, 7), d = __builtin_shufflevector(row[2], row[3], 2, 6, 3, 7);
    return {__builtin_shufflevector(a, b, 0, 1, 4, 5), __builtin_shufflevector(a, b, 2, 3, 6, 7),
            __builtin_shufflevector(c, d, 0, 1, 4, 5), __builtin_shufflevector(c, d, 2, 3, 6, 7)};
  } else if constexpr (N == 8) {
    const auto a = __builtin_shufflevector(row[0], row[1], 0, 8, 1, 9, 4, 12, 5, 13);
    const auto b = __builtin_shufflevector(row[2], row[3], 0, 8, 1, 9, 4, 12, 5, 13);
    const auto c = __builtin_shufflevector(row[0], row[1], 2, 10, 3, 11, 6, 14, 7, 15);
    const auto d = __builtin_shufflevector(row[2], row[3], 2, 10, 3, 11, 6, 14, 7, 15);
    return {__builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13), __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15),
            __builtin_shufflevector(c, d, 0, 1, 8, 9, 4, 5, 12, 13), __builtin_shufflevector(c, d, 2, 3, 10, 11, 6, 7, 14, 15)};
  } else {
    const auto a = __builtin_shufflevector(row[0], row[1], 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
    const auto b = __builtin_shufflevector(row[2], row[3], 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
    const auto c = __builtin_shufflevector(row[0], row[1], 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
    const auto d = __builtin_shufflevector(row[2], row[3], 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
    return {__builtin_shufflevector(a, b, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29),
            __builtin_shufflevector(a, b, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31),
            __builtin_shufflevector(c, d, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29),
            __builtin_shufflevector(c, d, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31)};
  }
}

// Writes N records of three numbers and a zero back to their places. Lanes whose bit is set in `skip` are not written.
template <int N>
CRUMPLE_INLINE void scatter(const Vec3s<N>& v, Float4* to, const uint32_t* index, unsigned skip) {
  Floats<N> row[4];
  const Floats<N> w{};
  if constexpr (N == 4) {
    const auto a = __builtin_shufflevector(v.x, v.y, 0, 4, 1, 5), b = __builtin_shufflevector(v.z, w, 0, 4, 1, 5);
    const auto c = __builtin_shufflevector(v.x, v.y, 2, 6, 3, 7), d = __builtin_shufflevector(v.z, w, 2, 6, 3, 7);
    row[0] = __builtin_shufflevector(a, b, 0, 1, 4, 5);
    row[1] = __builtin_shufflevector(a, b, 2, 3, 6, 7);
    row[2] = __builtin_shufflevector(c, d, 0, 1, 4, 5);
    row[3] = __builtin_shufflevector(c, d, 2, 3, 6, 7);
  } else if constexpr (N == 8) {
    const auto a = __builtin_shufflevector(v.x, v.y, 0, 8, 1, 9, 4, 12, 5, 13);
    const auto b = __builtin_shufflevector(v.z, w, 0, 8, 1, 9, 4, 12, 5, 13);
    const auto c = __builtin_shufflevector(v.x, v.y, 2, 10, 3, 11, 6, 14, 7, 15);
    const auto d = __builtin_shufflevector(v.z, w, 2, 10, 3, 11, 6, 14, 7, 15);
    row[0] = __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13);
    row[1] = __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15);
    row[2] = __builtin_shufflevector(c, d, 0, 1, 8, 9, 4, 5, 12, 13);
    row[3] = __builtin_shufflevector(c, d, 2, 3, 10, 11, 6, 7, 14, 15);
  } else {
    const auto a = __builtin_shufflevector(v.x, v.y, 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
    const auto b = __builtin_shufflevector(v.z, w, 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
    const auto c = __builtin_shufflevector(v.x, v.y, 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
    const auto d = __builtin_shufflevector(v.z, w, 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
    row[0] = __builtin_shufflevector(a, b, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29);
    row[1] = __builtin_shufflevector(a, b, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31);
    row[2] = __builtin_shufflevector(c, d, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29);
    row[3] = __builtin_shufflevector(c, d, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31);
  }
  for (int r = 0; r < 4; ++r) {
    const float* quads = reinterpret_cast<const float*>(&row[r]);
    for (int k = 0; k < N / 4; ++k) {
      const int lane = 4 * k + r;
      if (!(skip >> lane & 1)) store<4>(load<4>(quads + 4 * k), &to[index[lane]].x);
    }
  }
}

}  // namespace crumple

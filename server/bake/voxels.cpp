#include "bake/voxels.h"

#include <algorithm>
#include <cmath>

namespace crumple {
namespace {

// One line along an axis: `value` holds the squared distances so far and gets min over u of (x - u)^2 + value[u]. Parabola u
// is the lowest from start[q] on, for u = lowest[q].
class Line {
 public:
  explicit Line(int longest) : value(longest), lowest_(longest), start_(longest), out_(longest) {}

  std::vector<int32_t> value;

  void transform(int count) {
    int q = -1;
    for (int u = 0; u < count; ++u) {
      if (value[u] >= nowhere) continue;
      while (q >= 0 && at(start_[q], lowest_[q]) > at(start_[q], u)) --q;
      if (q < 0) {
        q = 0, lowest_[0] = u, start_[0] = 0;
        continue;
      }
      const int s = lowest_[q];  // the parabolas cross at or after start_[q], so nothing here is negative
      const int cross = (u * u - s * s + value[u] - value[s]) / (2 * (u - s)) + 1;
      if (cross < count) ++q, lowest_[q] = u, start_[q] = cross;
    }
    if (q < 0) return;
    for (int x = count - 1; x >= 0; --x) {
      out_[x] = at(x, lowest_[q]);
      if (x == start_[q]) --q;
    }
    std::copy_n(out_.begin(), count, value.begin());
  }

 private:
  int32_t at(int x, int u) const { return (x - u) * (x - u) + value[u]; }
  std::vector<int> lowest_, start_;
  std::vector<int32_t> out_;
};

}  // namespace

std::vector<int32_t> squared_distances(const Voxels& voxels, const Mask& mask, bool goal) {
  std::vector<int32_t> out(voxels.total());
  for (size_t v = 0; v < out.size(); ++v) out[v] = (mask[v] != 0) == goal ? 0 : nowhere;
  Line line(*std::max_element(voxels.count.begin(), voxels.count.end()));
  for (int axis = 0; axis < 3; ++axis) {
    const int b = axis == 0 ? 1 : 0, c = axis == 2 ? 1 : 2;
    const size_t stride = voxels.stride(axis);
    for (int j = 0; j < voxels.count[c]; ++j)
      for (int i = 0; i < voxels.count[b]; ++i) {
        int32_t* first = &out[size_t(j) * voxels.stride(c) + size_t(i) * voxels.stride(b)];
        for (int x = 0; x < voxels.count[axis]; ++x) line.value[x] = first[size_t(x) * stride];
        line.transform(voxels.count[axis]);
        for (int x = 0; x < voxels.count[axis]; ++x) first[size_t(x) * stride] = line.value[x];
      }
  }
  return out;
}

double interpolate(const Voxels& voxels, const std::vector<float>& value, const Eigen::Vector3d& point) {
  int cell[3];
  double along[3];
  for (int k = 0; k < 3; ++k) {
    const double g = std::clamp((point[k] - voxels.origin[k]) / voxels.size, 0.0, double(voxels.count[k] - 1));
    cell[k] = std::min(int(g), voxels.count[k] - 2);
    along[k] = g - cell[k];
  }
  const float* v = &value[voxels.index(cell[0], cell[1], cell[2])];
  const size_t y = voxels.stride(1), z = voxels.stride(2);
  const auto mix = [](double a, double b, double t) { return a + (b - a) * t; };
  const auto row = [&](size_t at) { return mix(double(v[at]), double(v[at + 1]), along[0]); };
  return mix(mix(row(0), row(y), along[1]), mix(row(z), row(z + y), along[1]), along[2]);
}

}  // namespace crumple

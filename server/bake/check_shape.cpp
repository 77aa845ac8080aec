#include "bake/check_shape.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <regex>
#include <utility>

#include "bake/names.h"
#include "bake/text_of.h"

namespace crumple {
namespace {

constexpr double usual_length = 4.5;                 // m
constexpr double least_length = 1.5;                 // m: a microcar has 2 m
constexpr double most_width = 3.5, most_height = 5;  // m: a bus has 2.6 and 4.4
constexpr size_t samples = 40'000;                   // a few in each cell of a car's surface
constexpr int cells = 80;                            // along the longest side: 6 cm of a car
constexpr double symmetric = 0.85;                   // cars have over 0.9; a car's front and rear agree in 0.5 to 0.8
constexpr double sure = 0.15;                        // share of half the length by which names must lie at one end
constexpr double broad = 0.7;  // the bottom's extent over the top's; that of a car upside down is about a half

// Points spread evenly over the area, the same ones each time.
std::vector<Vec3> sample(const Surface& surface) {
  std::vector<double> area_up_to;
  double area = 0;
  for (const auto& [a, b, c] : surface.triangle) {
    const Vec3 &p = surface.vertex[a], &q = surface.vertex[b], &r = surface.vertex[c];
    area_up_to.push_back(area += double((q - p).cross(r - p).norm()));
  }
  std::vector<Vec3> points;
  for (size_t i = 0; i < samples; ++i) {
    const double at = (double(i) + 0.5) / samples * area;
    const auto which = std::min(size_t(std::lower_bound(area_up_to.begin(), area_up_to.end(), at) - area_up_to.begin()),
                                surface.triangle.size() - 1);
    const auto& [a, b, c] = surface.triangle[which];
    double u = std::fmod(0.7548776662 * double(i), 1), v = std::fmod(0.5698402910 * double(i), 1);
    if (u + v > 1) u = 1 - u, v = 1 - v;
    const Vec3 &p = surface.vertex[a], &q = surface.vertex[b], &r = surface.vertex[c];
    points.push_back(p + float(u) * (q - p) + float(v) * (r - p));
  }
  return points;
}

struct Cells {
  Vec3 low;
  float size = 1;
  std::array<int, 3> count{};
  std::vector<uint8_t> taken;

  int index(const std::array<int, 3>& at) const { return (at[2] * count[1] + at[1]) * count[0] + at[0]; }
  std::array<int, 3> cell(const Vec3& point) const {
    std::array<int, 3> at;
    for (int k = 0; k < 3; ++k) at[k] = int(std::floor((point[k] - low[k]) / size));
    return at;
  }
  bool near(const Vec3& point) const {
    const std::array<int, 3> at = cell(point);
    for (int i = 0; i < 27; ++i) {
      const std::array<int, 3> next = {at[0] + i % 3 - 1, at[1] + i / 3 % 3 - 1, at[2] + i / 9 - 1};
      bool inside = true;
      for (int k = 0; k < 3; ++k) inside &= next[k] >= 0 && next[k] < count[k];
      if (inside && taken[index(next)]) return true;
    }
    return false;
  }
};

Cells fill(const std::vector<Vec3>& points, const Eigen::AlignedBox3f& box) {
  Cells out;
  out.low = box.min();
  out.size = box.sizes().maxCoeff() / cells;
  for (int k = 0; k < 3; ++k) out.count[k] = int(box.sizes()[k] / out.size) + 1;
  out.taken.resize(size_t(out.count[0]) * out.count[1] * out.count[2]);
  for (const Vec3& point : points) {
    std::array<int, 3> at = out.cell(point);
    for (int k = 0; k < 3; ++k) at[k] = std::clamp(at[k], 0, out.count[k] - 1);
    out.taken[out.index(at)] = 1;
  }
  return out;
}

// The share of the surface whose mirror image lies on the surface. The mirror stands in the middle of the box or of the area,
// because an aerial moves the one and a seat the other.
double symmetry(const std::vector<Vec3>& points, const Cells& filled, const Eigen::AlignedBox3f& box, int axis) {
  double mean = 0;
  for (const Vec3& point : points) mean += double(point[axis]) / double(points.size());
  double best = 0;
  for (const double middle : {mean, double(box.center()[axis])}) {
    size_t found = 0;
    for (Vec3 point : points) {
      point[axis] = float(2 * middle) - point[axis];
      found += filled.near(point);
    }
    best = std::max(best, double(found) / double(points.size()));
  }
  return best;
}

// The extent of the lowest quarter along an axis over that of the highest.
double breadth(const std::vector<Vec3>& points, const Eigen::AlignedBox3f& box, int axis) {
  Eigen::AlignedBox3f below, above;
  const float quarter = box.sizes()[axis] / 4;
  for (const Vec3& point : points) {
    if (point[axis] < box.min()[axis] + quarter) below.extend(point);
    if (point[axis] > box.max()[axis] - quarter) above.extend(point);
  }
  const auto area = [&](const Eigen::AlignedBox3f& part) {
    return part.isEmpty() ? 0.0 : double(part.sizes()[(axis + 1) % 3]) * double(part.sizes()[(axis + 2) % 3]);
  };
  return area(below) / std::max(area(above), 1e-9);
}

Eigen::Vector3i axis_of(const std::string& name) {
  return (name.starts_with('-') ? -1 : 1) * Eigen::Vector3i::Unit(name.back() - 'x');
}

std::string name_of(const Eigen::Vector3i& axis) {
  for (int k = 0; k < 3; ++k)
    if (axis[k] != 0) return (axis[k] < 0 ? "-" : "") + std::string(1, char('x' + k));
  return "";
}

}  // namespace

std::string likely_scale(double length) {
  constexpr std::pair<double, const char*> units[] = {
      {1e-3, " (millimetres)"}, {1e-2, " (centimetres)"}, {0.0254, " (inches)"}, {0.3048, " (feet)"}, {1, ""}};
  const auto misses = [&](double scale) { return std::abs(std::log(length * scale / usual_length)); };
  const auto* best = std::min_element(std::begin(units), std::end(units),
                                      [&](const auto& a, const auto& b) { return misses(a.first) < misses(b.first); });
  if (misses(best->first) < std::log(3)) return text_of(best->first) + best->second;
  return text_of(std::pow(10, std::round(std::log10(usual_length / std::max(length, 1e-9)))));
}

std::vector<std::string> check_shape(const Surface& surface, const ImportOptions& options) {
  const std::vector<Vec3> points = sample(surface);
  Eigen::AlignedBox3f box;
  for (const Vec3& vertex : surface.vertex) box.extend(vertex);
  const Cells filled = fill(points, box);
  const Eigen::Vector3d size = box.sizes().cast<double>();
  std::array<double, 3> same;
  for (int k = 0; k < 3; ++k) same[k] = symmetry(points, filled, box, k);
  const double bottom = breadth(points, box, 2);
  const auto percent = [](double share) { return text_of(100 * share, "%.0f") + " %"; };
  std::vector<std::string> report = {"shape: " + percent(same[1]) + " the same left and right; its bottom is " +
                                     text_of(bottom, "%.2g") + " times as broad as its top"};
  std::string fact, remedy;
  const auto metres = [](double length) { return text_of(length, "%.3g") + " m"; };
  if (size.y() > size.x())
    fact = "it is wider (" + metres(size.y()) + ") than long (" + metres(size.x()) + ")";
  else if (size.z() > size.x())
    fact = "it is higher (" + metres(size.z()) + ") than long (" + metres(size.x()) + ")";
  else if (same[1] < symmetric)
    fact = "its left and right are the same in " + percent(same[1]) + " only";
  else if (bottom < broad)
    fact = "its top is broader than its bottom, as if it lay on its roof";
  if (!fact.empty()) {  // the longest axis is forward; of the others, the one across is symmetric
    int forward = 0;
    size.maxCoeff(&forward);
    int across = (forward + 1) % 3, up = (forward + 2) % 3;
    const bool keep = std::abs(same[across] - same[up]) < 0.03;  // as told, where the shape does not say
    if (keep ? across == 2 : same[up] > same[across]) std::swap(across, up);
    const Eigen::Vector3i x = axis_of(options.forward), z = axis_of(options.up), file[3] = {x, z.cross(x), z};
    const bool upside_down = breadth(points, box, up) < 1;
    const Eigen::Vector3i ahead = file[forward], above = upside_down ? Eigen::Vector3i(-file[up]) : file[up];
    remedy = ahead == x && above == z ? "check that the file holds one whole car, and its axes with --forward and --up"
                                      : "perhaps --forward " + name_of(ahead) + " --up " + name_of(above) + ", or --forward " +
                                            name_of(-ahead) + " if its front is at the other end";
    if (size[across] > most_width || size[up] > most_height || size[forward] < least_length)
      remedy += "; then perhaps --scale " + likely_scale(size[forward] / options.scale);
  } else if (size.y() > most_width || size.z() > most_height) {
    fact = "it is " + metres(size.y()) + " wide and " + metres(size.z()) + " high, larger than vehicles are";
    remedy = "perhaps --scale " + likely_scale(size.x() / options.scale);
  } else if (size.x() < least_length) {
    fact = "it is " + metres(size.x()) + " long";
    remedy =
        "if a car of the usual length is meant, perhaps --scale " + text_of(options.scale * usual_length / size.x(), "%.2g");
  }
  if (!fact.empty()) report.push_back("warning: this may be no car as it stands: " + fact + "; " + remedy);
  return report;
}

std::string check_front(const ImportedSurface& input, const ImportOptions& options) {
  static const std::regex front("front|head(lights?|lamps?)|headl|hood|bonnet|grilles?|grills?|radiator"),
      rear("rear|tail|(tail|brake|stop)(lights?|lamps?)|taill|trunk|boot|tailgate|exhausts?|muffler|spoiler");
  const auto& triangle = input.surface.triangle;
  const auto x_of = [&](uint32_t vertex) { return double(input.surface.vertex[vertex].x()); };  // centred
  double half = 0, sum = 0, most = 0;
  for (uint32_t v = 0; v < input.surface.vertex.size(); ++v) half = std::max(half, std::abs(x_of(v)));
  size_t told = 0;
  std::string word;  // a name that tells most
  for (size_t i = 0; i < input.named.size(); ++i) {
    const size_t end = i + 1 < input.named.size() ? input.named[i + 1].first : triangle.size();
    const auto& names = input.named[i].names;
    const auto says = [&](const std::regex& words) {
      return std::find_if(names.begin(), names.end(), [&](const std::string& name) {
        std::vector<std::string> found = words_of(name);
        for (size_t k = 1, count = found.size(); k < count; ++k) found.push_back(found[k - 1] + found[k]);  // "HeadLight"
        return has_word(found, words);
      });
    };
    const auto ahead = says(front), behind = says(rear);
    if ((ahead == names.end()) == (behind == names.end()) || input.named[i].first == end) continue;
    double middle = 0;
    for (size_t t = input.named[i].first; t < end; ++t)
      for (uint32_t v : triangle[t]) middle += x_of(v) / (3 * double(end - input.named[i].first) * half);
    const double agrees = ahead != names.end() ? middle : -middle;
    sum += agrees;
    ++told;
    if (std::abs(agrees) > most) most = std::abs(agrees), word = ahead != names.end() ? *ahead : *behind;
  }
  const double mean = sum / std::max<double>(1, double(told));
  const std::string other = name_of(-axis_of(options.forward));
  if (mean > sure) return "front: '" + word + "' and its like lie where they should";
  if (mean < -sure)
    return "warning: the front seems to be at the other end, because of '" + word + "'; perhaps --forward " + other;
  return "front: no name tells which end it is; look at --pictures, and give --forward " + other + " if it is the other end";
}

}  // namespace crumple

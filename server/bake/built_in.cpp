// A parametric saloon car: cross-sections along x, each drawn through a few profile curves (roof line, shoulder line, sill,
// half widths), with wheel arches cut into the sides. Only the left half is built, then mirrored. The surface is closed, has no
// handles (so any vertex count is possible) and is exactly symmetric. The longest edges are split until the count is reached.
// Glass, lights and trim are triangles of it. Wheels and seats are pieces of their own, which get no tets.

#include "bake/built_in.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace crumple {
namespace {

// ---- profile curves ----------------------------------------------------------------------------------------------------

struct Knot {
  double x, value;
};

// Monotone cubic through the knots (Fritsch and Carlson 1980), which does not overshoot between bonnet and windscreen.
double follow(const std::vector<Knot>& knots, double x) {
  const size_t last = knots.size() - 1;
  if (x <= knots[0].x) return knots[0].value;
  if (x >= knots[last].x) return knots[last].value;
  size_t i = 0;
  while (x > knots[i + 1].x) ++i;
  const auto secant = [&](size_t k) { return (knots[k + 1].value - knots[k].value) / (knots[k + 1].x - knots[k].x); };
  const auto slope = [&](size_t k) {
    if (k == 0) return secant(0);
    if (k == last) return secant(last - 1);
    const double before = secant(k - 1), after = secant(k);
    return before * after <= 0 ? 0 : 2 * before * after / (before + after);
  };
  const double width = knots[i + 1].x - knots[i].x, t = (x - knots[i].x) / width;
  return knots[i].value * (1 + 2 * t) * (1 - t) * (1 - t) + slope(i) * width * t * (1 - t) * (1 - t) +
         knots[i + 1].value * t * t * (3 - 2 * t) + slope(i + 1) * width * t * t * (t - 1);
}

// Metres, from the tail to the nose. z = 0 is the lowest point of the sill.
const std::vector<Knot> roof_line = {{-2.25, 0.84},  {-2.18, 0.93},  {-1.75, 0.99},  {-1.62, 1.01}, {-1.50, 1.065},
                                     {-1.10, 1.285}, {-0.95, 1.345}, {-0.60, 1.415}, {-0.20, 1.43}, {0.08, 1.40},
                                     {0.24, 1.34},   {0.38, 1.26},   {0.82, 0.975},  {0.95, 0.91},  {1.10, 0.88},
                                     {1.70, 0.81},   {2.10, 0.72},   {2.25, 0.63}};
const std::vector<Knot> shoulder_line = {{-2.25, 0.72}, {-2.1, 0.84}, {-1.4, 0.88}, {0.0, 0.84},
                                         {1.2, 0.79},   {1.9, 0.70},  {2.25, 0.55}};
const std::vector<Knot> sill_line = {{-2.25, 0.20}, {-2.0, 0.10}, {-1.6, 0.03}, {-0.9, 0.0},
                                     {1.0, 0.0},    {1.8, 0.03},  {2.1, 0.07},  {2.25, 0.14}};
const std::vector<Knot> half_width = {{-2.25, 0.66}, {-2.18, 0.76}, {-1.9, 0.845}, {-1.3, 0.89}, {-0.3, 0.90},
                                      {0.6, 0.90},   {1.4, 0.885},  {1.9, 0.82},   {2.15, 0.72}, {2.25, 0.60}};
// Half width of the roof, and of the flat part of the bonnet and boot lid.
const std::vector<Knot> top_width = {{-2.25, 0.52}, {-2.1, 0.64}, {-1.6, 0.66}, {-1.05, 0.575}, {-0.2, 0.60},
                                     {0.30, 0.58},  {0.95, 0.68}, {1.6, 0.66},  {2.1, 0.58},    {2.25, 0.46}};

constexpr double axles[] = {-1.36, 1.36};
constexpr double arch_radius = 0.36, arch_center = 0.15;  // radius of the hole, and height of its centre over the sill, m
constexpr double well_wall = 0.60;                        // |y| of the inner wall of a wheel well, m
constexpr double nose = 2.25;
constexpr double bulged = 0.01;  // m: how far the middle of nose and tail stands out

// Height of the arch at x; -1 where there is no arch.
double arch_height(double x) {
  for (double axle : axles) {
    const double square = arch_radius * arch_radius - (x - axle) * (x - axle);
    if (square >= -1e-12) return arch_center + std::sqrt(std::max(0.0, square));
  }
  return -1;
}

// ---- one cross-section ---------------------------------------------------------------------------------------------------

// Numbers of segments along the half section, from the middle of the floor over the side to the middle of the roof.
struct Resolution {
  int floor, wall, ceiling, side, glass, roof;
  int arch;    // stations over an arch
  double gap;  // m, between the other stations
};

Resolution resolution(double scale) {
  const auto count = [&](double at_one) { return std::max(1, static_cast<int>(std::lround(at_one * scale))); };
  return {count(3), count(2), count(2), count(5), count(4), count(4), 2 * count(4) + 1, 0.15 / scale};
}

struct Point {
  double y, z;
};

void line(std::vector<Point>& section, Point to, int segments) {
  const Point from = section.back();
  for (int i = 1; i <= segments; ++i) {
    const double t = static_cast<double>(i) / segments;
    section.push_back({from.y + t * (to.y - from.y), from.z + t * (to.z - from.z)});
  }
}

// Distance of the side from the middle at height z: largest at 0.45 m, smaller towards the sill and the shoulder.
double side(double x, double z) {
  const double up = (z - 0.45) / 0.45;
  return follow(half_width, x) * (1 - (up > 0 ? 0.045 : 0.05) * up * up);
}

std::vector<Point> half_section(double x, const Resolution& n) {
  const double sill = follow(sill_line, x), shoulder = follow(shoulder_line, x), arch = arch_height(x);
  const double roof = follow(roof_line, x), roof_width = follow(top_width, x);
  const double low = arch > 0 ? std::max(arch, sill + 0.06) : sill + 0.06;
  std::vector<Point> section = {{0, sill}};
  const double wall = std::min(well_wall, 0.8 * side(x, low));
  line(section, {wall, sill}, n.floor);
  if (arch > 0) {
    line(section, {wall, low}, n.wall);
  } else {
    line(section, {0.5 * (wall + side(x, low)), sill + 0.005}, n.wall);
  }
  line(section, {side(x, low), low}, n.ceiling);
  for (int i = 1; i <= n.side; ++i) {
    const double z = low + (shoulder - low) * i / n.side;
    section.push_back({side(x, z), z});
  }
  // Glass leans in (tumblehome); its first step is the rounded shoulder. On bonnet and boot these are the outer strips.
  const double crown = 0.05 * roof_width + 0.04 * std::max(0.0, roof - shoulder - 0.1);
  const double edge = std::max(shoulder + 0.25 * (roof - shoulder), roof - crown), foot = section.back().y;
  for (int i = 1; i <= n.glass; ++i) {
    const double t = static_cast<double>(i) / n.glass;
    section.push_back(
        {foot + (roof_width - foot) * (t + 0.12 * t * (1 - t)), shoulder + (edge - shoulder) * (t + 0.25 * t * (1 - t))});
  }
  for (int i = 1; i <= n.roof; ++i) {
    const double y = roof_width * (1 - static_cast<double>(i) / n.roof), share = y / roof_width;
    section.push_back({y, edge + (roof - edge) * (1 - share * share)});
  }
  return section;
}

// ---- the half shell --------------------------------------------------------------------------------------------------------

std::vector<double> stations(const Resolution& n) {
  constexpr double lip = 0.012;  // m from the arch's foot to the section beside it
  std::vector<double> out;
  const auto span = [&](double from, double to) {
    const int steps = std::max(1, static_cast<int>(std::lround((to - from) / n.gap)));
    for (int i = 0; i <= steps; ++i) out.push_back(from + (to - from) * i / steps);
  };
  double from = -nose;
  for (double axle : axles) {
    span(from, axle - arch_radius - lip);
    for (int i = 0; i < n.arch; ++i) out.push_back(axle - arch_radius * std::cos(std::numbers::pi * i / (n.arch - 1)));
    from = axle + arch_radius + lip;
  }
  span(from, nose);
  return out;
}

// Shapes both ends: nose and tail lean back above the bumpers, and the bumpers stand out.
Vec3 shaped(double x, const Point& p) {
  const double end = std::clamp((std::abs(x) - 1.75) / (nose - 1.75), 0.0, 1.0), above = std::max(0.0, p.z - 0.40);
  const double lean = end * end * (0.40 * above * above + 0.02 * std::max(0.0, 0.30 - p.z));
  const double bumper = end * 0.02 * std::exp(-std::pow((p.z - 0.33) / 0.10, 2));
  const double moved = x + (bumper - lean) * (x < 0 ? -1 : 1);
  return Eigen::Vector3d(moved, p.y, p.z).cast<float>();
}

// Paint is what the program that shows the car chooses.
enum Finish : uint8_t { paint, trim, glass, headlight, taillight, tyre, rim, seat, finish_count };

struct Half {
  std::vector<Vec3> vertex;
  std::vector<Triangle> triangle;
  std::vector<Finish> finish;  // of each triangle
  size_t mirrored_count() const {
    size_t count = 0;
    for (const Vec3& v : vertex) count += v.y() == 0 ? 1 : 2;
    return count;
  }
};

float length(const Half& half, uint32_t a, uint32_t b) { return (half.vertex[a] - half.vertex[b]).squaredNorm(); }

// The finish of what lies between sections i and i + 1 of the profile, around this point of the half.
Finish finish_at(const Resolution& n, int i, const Vec3& point) {
  const int side = n.floor + n.wall + n.ceiling, pane = side + n.side, roof = pane + n.glass;
  const float x = point.x(), y = point.y(), z = point.z();
  if (i < side) return trim;
  if (i < pane) {
    const bool low = i == side && std::abs(x)<0.98f, band = std::abs(x)> 2 && z > 0.26f && z < 0.38f;  // sill; bumper
    return low || band ? trim : x > 1.95f && z > 0.47f ? headlight : x < -2.05f && z > 0.56f ? taillight : paint;
  }
  if (i < roof) {
    const bool framed = i == pane || (n.glass > 2 && i == roof - 1), pillar = std::abs(x + 0.2f) < 0.075f;
    return !framed && !pillar && x > -1.3f && x < 0.62f ? glass : paint;
  }
  const bool wind = x > 0.31f && x<0.9f, rear = x> - 1.55f && x < -1.05f;
  return (wind || rear) && (i > roof || n.roof < 3) && y < 0.62f ? glass : paint;
}

Finish finish_at_end(const Vec3& point) {
  const float x = point.x(), y = point.y(), z = point.z();
  if (z > 0.26f && z < 0.38f) return trim;
  if (x > 0) return y > 0.34f && z > 0.4f ? headlight : y < 0.34f && z > 0.4f && z < 0.52f ? trim : paint;
  return y > 0.36f && z > 0.5f ? taillight : paint;
}

// Corners in order. Cuts the quad along the shorter diagonal.
void add_quad(Half& half, Finish finish, uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
  half.finish.insert(half.finish.end(), 2, finish);
  if (length(half, a, c) <= length(half, b, d)) {
    half.triangle.insert(half.triangle.end(), {{a, b, c}, {a, c, d}});
  } else {
    half.triangle.insert(half.triangle.end(), {{a, b, d}, {b, c, d}});
  }
}

// Closes an end with smaller copies of its section inside it; the last one shrinks to the line y = 0.
void add_cap(Half& half, double x, const std::vector<Point>& section, uint32_t first, int rings) {
  const auto count = static_cast<uint32_t>(section.size());
  const double middle = 0.5 * (section.front().z + section.back().z);
  uint32_t outer = first;
  for (int ring = 1; ring <= rings; ++ring) {
    const double shrink = 1 - static_cast<double>(ring) / (rings + 0.6), bulge = bulged * (1 - shrink * shrink);
    const auto inner = static_cast<uint32_t>(half.vertex.size());
    for (const Point& p : section) {
      Vec3 vertex = shaped(x, {p.y * shrink, middle + (p.z - middle) * shrink});
      vertex.x() += static_cast<float>(std::copysign(bulge, x));
      half.vertex.push_back(vertex);
    }
    for (uint32_t i = 0; i + 1 < count; ++i) {
      const auto& at = half.vertex;
      const Finish finish = finish_at_end((at[outer + i] + at[outer + i + 1] + at[inner + i] + at[inner + i + 1]) / 4);
      if (x > 0)
        add_quad(half, finish, outer + i, outer + i + 1, inner + i + 1, inner + i);
      else
        add_quad(half, finish, outer + i + 1, outer + i, inner + i, inner + i + 1);
    }
    outer = inner;
  }
  // A fan around the middle of the symmetry line closes the last ring.
  const auto center = static_cast<uint32_t>(half.vertex.size());
  Vec3 vertex = shaped(x, {0, middle});
  vertex.x() += static_cast<float>(std::copysign(bulged, x));
  half.vertex.push_back(vertex);
  for (uint32_t i = 0; i + 1 < count; ++i) {
    half.finish.push_back(finish_at_end((half.vertex[outer + i] + half.vertex[outer + i + 1] + vertex) / 3));
    if (x > 0)
      half.triangle.push_back({outer + i, outer + i + 1, center});
    else
      half.triangle.push_back({outer + i + 1, outer + i, center});
  }
}

Half build_half(double scale) {
  const Resolution n = resolution(scale);
  const std::vector<double> xs = stations(n);
  const int rings = std::max(1, static_cast<int>(std::lround(2 * scale)));
  Half half;
  uint32_t count = 0;
  for (double x : xs) {
    const std::vector<Point> section = half_section(x, n);
    count = static_cast<uint32_t>(section.size());
    for (const Point& p : section) half.vertex.push_back(shaped(x, p));
  }
  for (uint32_t k = 0; k + 1 < xs.size(); ++k)
    for (uint32_t i = 0; i + 1 < count; ++i) {
      const uint32_t a = k * count + i, b = a + count;
      const Vec3 middle = (half.vertex[a] + half.vertex[a + 1] + half.vertex[b] + half.vertex[b + 1]) / 4;
      add_quad(half, finish_at(n, static_cast<int>(i), middle), a, a + 1, b + 1, b);
    }
  add_cap(half, -nose, half_section(-nose, n), 0, rings);
  add_cap(half, nose, half_section(nose, n), static_cast<uint32_t>(xs.size() - 1) * count, rings);
  return half;
}

// Splits the longest edge, or the longest edge on the symmetry line, in its middle.
void split_longest(Half& half, bool on_symmetry_line) {
  uint32_t from = 0, to = 0;
  float longest = 0;
  for (const Triangle& t : half.triangle)
    for (int k = 0; k < 3; ++k) {
      const uint32_t a = std::min(t[k], t[(k + 1) % 3]), b = std::max(t[k], t[(k + 1) % 3]);
      const bool on_line = half.vertex[a].y() == 0 && half.vertex[b].y() == 0;
      if (on_line == on_symmetry_line && length(half, a, b) > longest) from = a, to = b, longest = length(half, a, b);
    }
  const auto middle = static_cast<uint32_t>(half.vertex.size());
  half.vertex.push_back(0.5f * (half.vertex[from] + half.vertex[to]));
  const size_t before = half.triangle.size();
  for (size_t i = 0; i < before; ++i) {
    const Triangle t = half.triangle[i];
    for (int k = 0; k < 3; ++k) {
      const uint32_t a = t[k], b = t[(k + 1) % 3];
      if (std::min(a, b) != from || std::max(a, b) != to) continue;
      half.triangle[i] = {a, middle, t[(k + 2) % 3]};
      half.triangle.push_back({middle, b, t[(k + 2) % 3]});
      half.finish.push_back(Finish(half.finish[i]));
      break;
    }
  }
}

Surface mirror(const Half& half) {
  Surface out;
  out.vertex = half.vertex;
  out.triangle = half.triangle;
  std::vector<uint32_t> twin(half.vertex.size());
  for (uint32_t i = 0; i < twin.size(); ++i) {
    const Vec3& v = half.vertex[i];
    twin[i] = v.y() == 0 ? i : static_cast<uint32_t>(out.vertex.size());
    if (v.y() != 0) out.vertex.push_back({v.x(), -v.y(), v.z()});
  }
  for (const Triangle& t : half.triangle) out.triangle.push_back({twin[t[0]], twin[t[2]], twin[t[1]]});
  return out;
}

// ---- wheels and seats
// --------------------------------------------------------------------------------------------------------

constexpr int wheel_segments = 24;
constexpr double wheel_radius = 0.3, wheel_side = 0.75;  // m; |y| of the hub, whose height is that of the arch's centre

// A closed body of revolution about y: the tyre, and a rim with six spokes, the same on both sides.
void add_wheel(Half& car, const Vec3& hub) {
  struct Ring {
    float y, radius;
  };
  constexpr std::array<Ring, 10> profile = {{{0.06f, 0.05f},
                                             {0.075f, 0.06f},
                                             {0.085f, 0.17f},
                                             {0.1f, 0.19f},
                                             {0.105f, 0.285f},
                                             {-0.105f, 0.285f},
                                             {-0.1f, 0.19f},
                                             {-0.085f, 0.17f},
                                             {-0.075f, 0.06f},
                                             {-0.06f, 0.05f}}};
  const auto first = static_cast<uint32_t>(car.vertex.size());
  const auto last = static_cast<uint32_t>(profile.size()) - 1;
  for (const Ring& ring : profile)
    for (int k = 0; k < wheel_segments; ++k) {
      const double turn = 2 * std::numbers::pi * k / wheel_segments;
      const double radius = ring.radius == 0.285f ? wheel_radius : double(ring.radius);
      car.vertex.push_back(hub +
                           Eigen::Vector3d(radius * std::cos(turn), double(ring.y), radius * std::sin(turn)).cast<float>());
    }
  const auto at = [&](uint32_t ring, int k) {
    return first + ring * wheel_segments + static_cast<uint32_t>(k % wheel_segments);
  };
  for (uint32_t ring = 0; ring < last; ++ring)
    for (int k = 0; k < wheel_segments; ++k) {
      const bool spokes = ring == 1 || ring == last - 2, face = ring < 3 || ring > last - 4;
      const Finish finish = !face || (spokes && k % 4 > 1) ? tyre : rim;
      add_quad(car, finish, at(ring, k), at(ring, k + 1), at(ring + 1, k + 1), at(ring + 1, k));
    }
  for (const uint32_t ring : {0u, last}) {
    const auto center = static_cast<uint32_t>(car.vertex.size());
    car.vertex.push_back(hub + Vec3(0, profile[ring].y, 0));
    for (int k = 0; k < wheel_segments; ++k) {
      const uint32_t a = at(ring, k), b = at(ring, k + 1);
      car.triangle.push_back(ring == 0 ? Triangle{center, b, a} : Triangle{center, a, b});
      car.finish.push_back(rim);
    }
  }
}

// A box whose top lies `lean` behind its bottom, m.
void add_box(Half& car, const Vec3& low, const Vec3& high, float lean) {
  const auto first = static_cast<uint32_t>(car.vertex.size());
  for (int k = 0; k < 8; ++k)
    car.vertex.push_back({(k & 1 ? high : low).x() - (k & 4 ? lean : 0), (k & 2 ? high : low).y(), (k & 4 ? high : low).z()});
  constexpr uint32_t faces[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  for (const auto& [a, b, c, d] : faces) add_quad(car, seat, first + a, first + b, first + c, first + d);
}

void add_interior(Half& car) {
  for (const float side : {-0.36f, 0.36f}) {
    add_box(car, {-0.45f, side - 0.24f, 0.3f}, {0.1f, side + 0.24f, 0.5f}, 0);
    add_box(car, {-0.55f, side - 0.22f, 0.48f}, {-0.42f, side + 0.22f, 1.05f}, 0.12f);
    add_box(car, {-0.64f, side - 0.12f, 1.06f}, {-0.56f, side + 0.12f, 1.2f}, 0.03f);
  }
  add_box(car, {-1.2f, -0.6f, 0.3f}, {-0.75f, 0.6f, 0.52f}, 0);
  add_box(car, {-1.3f, -0.58f, 0.5f}, {-1.17f, 0.58f, 1}, 0.1f);
  add_box(car, {0.5f, -0.62f, 0.55f}, {0.72f, 0.62f, 0.82f}, -0.08f);  // the dashboard
}

// ---- the car
// -----------------------------------------------------------------------------------------------------------------

struct Appearance {
  const char* name;  // of the node; the bake takes the kinds of parts from it
  std::optional<Look> look;
};

const std::array<Appearance, finish_count>& appearances() {
  static const std::array<Appearance, finish_count> all = {{
      {"body", {}},
      {"trim", Look{"trim", {0.014f, 0.014f, 0.016f, 1}, 0, 0.6f}},
      {"glass", {}},
      {"headlight", Look{"headlight", {0.82f, 0.82f, 0.76f, 1}, 0.1f, 0.12f}},
      {"taillight", Look{"taillight", {0.33f, 0.008f, 0.008f, 1}, 0.1f, 0.2f}},
      {"tyre", Look{"tyre", {0.012f, 0.012f, 0.013f, 1}, 0, 0.85f}},
      {"rim", Look{"rim", {0.5f, 0.5f, 0.52f, 1}, 0.7f, 0.35f}},
      {"seats", Look{"seats", {0.035f, 0.032f, 0.03f, 1}, 0, 0.9f}},
  }};
  return all;
}

Half build_body(size_t vertices) {
  double scale = 1.1 * std::sqrt(static_cast<double>(vertices) / 1259);
  Half half = build_half(scale);
  while (half.mirrored_count() > vertices) half = build_half(scale *= 0.99);
  for (size_t count = half.mirrored_count(); count < vertices;) {
    const bool one_left = vertices - count == 1;
    split_longest(half, one_left);
    count += one_left ? 1 : 2;
  }
  return half;
}

}  // namespace

Surface build_car_body(size_t vertices) { return mirror(build_body(vertices)); }

ImportedSurface build_car(size_t vertices) {
  Half whole = build_body(vertices);
  const Surface body = mirror(whole);
  whole.vertex = body.vertex, whole.triangle = body.triangle;
  const std::vector<Finish> left = whole.finish;
  whole.finish.insert(whole.finish.end(), left.begin(), left.end());
  for (double axle : axles)
    for (double side : {wheel_side, -wheel_side}) add_wheel(whole, Eigen::Vector3d(axle, side, arch_center).cast<float>());
  add_interior(whole);
  std::vector<Eigen::Vector3d> positions;
  for (const Vec3& vertex : whole.vertex) positions.push_back(vertex.cast<double>());
  std::vector<Triangle> triangles;
  std::vector<size_t> first;  // of each finish
  for (int finish = 0; finish < finish_count; ++finish) {
    first.push_back(triangles.size());
    for (size_t t = 0; t < whole.triangle.size(); ++t)
      if (whole.finish[t] == finish) triangles.push_back(whole.triangle[t]);
  }
  ImportedSurface out = place_surface(positions, {}, triangles, {}, "built-in");
  for (size_t finish = 0; finish < finish_count; ++finish) {
    const auto& [name, look] = appearances()[finish];
    const auto at = std::lower_bound(out.kept.begin(), out.kept.end(), first[finish]) - out.kept.begin();
    out.named.push_back({.name = name, .first = static_cast<size_t>(at), .names = {name}, .look = look});
  }
  return out;
}

}  // namespace crumple

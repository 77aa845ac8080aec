#include "bake/paint_regions.h"

#include <flatbuffers/idl.h>
#include <flatbuffers/util.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <stdexcept>

#include "bake/text_of.h"
#include "car/car.h"
#include "car/nearest.h"
#include "io/files.h"
#include "schema/regions_generated.h"

// REGIONS_BFBS: schema/regions.fbs and its includes, compiled by flatc.
asm(".pushsection .rodata\n.balign 8\nregions_schema:\n.incbin \"" REGIONS_BFBS "\"\nregions_schema_end:\n.popsection");
extern "C" const uint8_t regions_schema[], regions_schema_end[];

namespace crumple {
namespace {

// Share of the length left free at either end: as far as from the bumper to the firewall, which a crash at 56 km/h reaches.
constexpr float free_end = 0.27f;
// Greatest distance of a painted sphere from its nearest node, m: more than the widest gap between the nodes of a car, and far
// below the thousandfold of a wrong unit.
constexpr float between_nodes = 0.3f;
// Depths of the safety cell under the skin, m, tried in this order. Frontal crush was the same for 0.1-0.3; the smaller depths
// are for bodies with no room for the first.
constexpr double cell_depths[] = {0.20, 0.15, 0.10, 0.05, 0.02};

// ---- regions ---------------------------------------------------------------------------------------------------------

uint8_t region_index(Regions& regions, const std::string& name, const std::string& source) {
  const auto found = std::find(regions.name.begin(), regions.name.end(), name);
  if (found != regions.name.end()) return static_cast<uint8_t>(found - regions.name.begin());
  if (regions.name.size() == max_regions)
    throw std::runtime_error(source + ": it makes more than the " + std::to_string(max_regions) +
                             " regions that a car may have, \"body\" among them; use fewer.");
  regions.name.push_back(name);
  return static_cast<uint8_t>(regions.name.size() - 1);
}

// Each node takes the colour of the nearest vertex. White is "body".
void paint_by_color(const TetMesh& mesh, const Surface& surface, Regions& regions, std::vector<std::string>& report) {
  if (surface.color.empty()) return;
  std::map<uint32_t, uint8_t> region_of;
  for (uint32_t color : surface.color) region_of[color] = 0;
  const size_t painted = region_of.size() - region_of.count(0xffffff);
  if (painted > max_regions - 2) {  // beside "body" and "cell"; so many are shading, not regions
    report.push_back("not painted: the surface has " + std::to_string(painted) +
                     " vertex colours, more than a car has regions");
    return;
  }
  for (auto& [color, region] : region_of) {
    char name[8];
    std::snprintf(name, sizeof name, "#%06x", color & 0xffffffu);
    if (color != 0xffffff) region = region_index(regions, name, "the surface's vertex colours");
  }
  std::vector<Box> boxes;
  for (const Vec3& vertex : surface.vertex) boxes.emplace_back(vertex.cast<double>().eval());
  const BoxTree tree = build_tree(boxes);
  for (size_t i = 0; i < mesh.node.size(); ++i) {
    const Eigen::Vector3d point = mesh.node[i].cast<double>();
    const auto measure = [&](uint32_t vertex) { return (surface.vertex[vertex].cast<double>() - point).squaredNorm(); };
    regions.node_region[i] = region_of[surface.color[find_nearest(tree, point, measure).index]];
  }
  report.push_back("painted by " + std::to_string(region_of.size()) + " vertex colours");
}

// FlatBuffers' own parser converts the JSON to a table. Its error message begins with file and line.
schema::PaintRegionsT parse_regions(const RegionsText& regions_text) {
  flatbuffers::Parser parser;
  if (!parser.Deserialize(regions_schema, static_cast<size_t>(regions_schema_end - regions_schema)))
    throw std::runtime_error("the regions schema inside this program is damaged: build it again");
  if (!parser.ParseJson(regions_text.text.c_str(), regions_text.source.c_str()))
    throw std::runtime_error(parser.error_ + " (the form of a regions file: schema/regions.fbs, with an example).");
  schema::PaintRegionsT regions;
  flatbuffers::GetRoot<schema::PaintRegions>(parser.builder_.GetBufferPointer())->UnPackTo(&regions);
  return regions;
}

struct Shape {
  Eigen::AlignedBox3f box;  // half extents about the origin; empty: a sphere
  Eigen::Quaternionf orientation = Eigen::Quaternionf::Identity();
  Vec3 center = Vec3::Zero();
  float radius = 0;
  bool holds(const Vec3& point) const {
    if (box.isEmpty()) return (point - center).squaredNorm() <= radius * radius;
    return box.contains(orientation.conjugate() * (point - center));
  }
};

Vec3 vec3(const schema::Vec3& v) { return {v.x(), v.y(), v.z()}; }

Shape read_shape(const schema::PaintRegionT& region, const std::string& where) {
  const auto refuse = [&](const char* fact) { throw std::runtime_error(where + " " + fact); };
  Shape shape;
  if (!region.box == !region.sphere) refuse("needs a box or a sphere, and only one of them.");
  if (const auto& sphere = region.sphere) {
    shape.center = vec3(*sphere->center);
    shape.radius = sphere->radius;
    if (!(shape.radius > 0 && std::isfinite(shape.radius))) refuse("needs a sphere with a radius above zero, in metres.");
  }
  if (const auto& box = region.box) {
    const Vec3 half = vec3(*box->half);
    shape.center = vec3(*box->center);
    if (!(half.minCoeff() > 0) || !half.allFinite()) refuse("needs a box with half extents above zero, in metres.");
    shape.box = Eigen::AlignedBox3f(-half, half);
    if (const auto& q = box->orientation) {
      shape.orientation = Eigen::Quaternionf(q->w(), q->x(), q->y(), q->z());
      if (!(std::abs(shape.orientation.norm() - 1) < 1e-3f)) refuse("needs an orientation that is a unit quaternion.");
      shape.orientation.normalize();
    }
  }
  if (!shape.center.allFinite()) refuse("needs a centre of finite numbers, in metres.");
  return shape;
}

// The nodes in the shape. For a sphere between nodes the nearest node, so that thin places can be painted too.
std::vector<uint32_t> nodes_in(const TetMesh& mesh, const Shape& shape) {
  std::vector<uint32_t> inside;
  uint32_t nearest = 0;
  const auto squared = [&](uint32_t i) { return (mesh.node[i] - shape.center).squaredNorm(); };
  for (uint32_t i = 0; i < mesh.node.size(); ++i) {
    if (shape.holds(mesh.node[i])) inside.push_back(i);
    if (squared(i) < squared(nearest)) nearest = i;
  }
  if (inside.empty() && shape.radius > 0 && squared(nearest) <= between_nodes * between_nodes) inside.push_back(nearest);
  return inside;
}

void paint_by_text(const TetMesh& mesh, const RegionsText& text, Regions& regions, std::vector<std::string>& report) {
  for (const auto& region : parse_regions(text).regions) {
    const Shape shape = read_shape(*region, text.source + ": region \"" + region->name + "\"");
    const uint8_t index = region_index(regions, region->name, text.source);
    const std::vector<uint32_t> painted = nodes_in(mesh, shape);
    if (painted.empty())
      throw std::runtime_error(
          text.source + ": region \"" + region->name +
          "\" holds no node; place it in the car's frame (X forward, Y left, Z up, metres) or make it larger.");
    for (const uint32_t i : painted) {
      regions.node_region[i] = index;
      regions.node_anchored[i] = region->anchored;
    }
  }
  for (size_t index = 0; index < regions.name.size(); ++index) {
    size_t nodes = 0, anchored = 0;
    for (size_t i = 0; i < mesh.node.size(); ++i) {
      nodes += regions.node_region[i] == index;
      anchored += regions.node_region[i] == index && regions.node_anchored[i];
    }
    report.push_back("region \"" + regions.name[index] + "\": " + std::to_string(nodes) + " nodes" +
                     (anchored ? ", " + std::to_string(anchored) + " of them anchored" : ""));
  }
}

// ---- the default safety cell -------------------------------------------------------------------------------------------

// Depth of each node between the ends under the body's outside, m; -1 for nodes of the ends.
std::vector<double> depths(const TetMesh& mesh) {
  const std::vector<Triangle> outside = boundary(mesh);
  std::vector<Box> boxes(outside.size());
  for (size_t i = 0; i < boxes.size(); ++i)
    for (uint32_t node : outside[i]) boxes[i].extend(mesh.node[node].cast<double>());
  const BoxTree tree = build_tree(boxes);
  Eigen::AlignedBox3f body;
  for (const Vec3& node : mesh.node) body.extend(node);
  const float length = body.sizes().x();
  std::vector<double> out(mesh.node.size(), -1);
  for (size_t i = 0; i < out.size(); ++i) {
    const float x = mesh.node[i].x();
    if (x < body.min().x() + free_end * length || x > body.max().x() - free_end * length) continue;
    const Eigen::Vector3d point = mesh.node[i].cast<double>();
    const auto measure = [&](uint32_t triangle) {
      const auto [a, b, c] = outside[triangle];
      return squared_distance_to_triangle(point, mesh.node[a].cast<double>(), mesh.node[b].cast<double>(),
                                          mesh.node[c].cast<double>());
    };
    out[i] = std::sqrt(find_nearest(tree, point, measure).squared_distance);
  }
  return out;
}

void anchor_default_cell(const TetMesh& mesh, const std::string& name, Regions& regions, std::vector<std::string>& report) {
  const std::vector<double> depth = depths(mesh);
  for (double deepest : cell_depths) {
    const auto count = std::count_if(depth.begin(), depth.end(), [&](double d) { return d > deepest; });
    if (count == 0) continue;
    const uint8_t cell = region_index(regions, "cell", "the default safety cell");
    for (size_t i = 0; i < depth.size(); ++i) {
      if (depth[i] <= deepest) continue;
      regions.node_anchored[i] = 1;
      if (regions.node_region[i] == 0) regions.node_region[i] = cell;
    }
    report.push_back("safety cell: " + std::to_string(count) + " nodes anchored, deeper than " + text_of(deepest, "%.2f") +
                     " m under the skin, " + text_of(100 * free_end, "%.0f") + " % of the length left free at either end" +
                     (deepest == cell_depths[0] ? "" : " (none lay deeper)"));
    return;
  }
  throw std::runtime_error(name + ": no node lies deeper than " + text_of(std::end(cell_depths)[-1]) +
                           " m inside the body, so there is no safety cell to hold it; anchor a part with --regions FILE or "
                           "bake with more --nodes.");
}

// ---- connected parts ---------------------------------------------------------------------------------------------------

void report_loose_parts(const TetMesh& mesh, const Regions& regions, std::vector<std::string>& report) {
  const std::vector<uint32_t> part_of = connected(mesh.node.size(), {mesh.tet.data()->node, 4 * mesh.tet.size()}, 4);
  std::map<uint32_t, std::pair<size_t, size_t>> parts;  // nodes, anchored nodes
  for (uint32_t i = 0; i < part_of.size(); ++i) {
    auto& [nodes, anchored] = parts[part_of[i]];
    ++nodes;
    anchored += regions.node_anchored[i];
  }
  std::vector<size_t> loose;
  for (const auto& [first, part] : parts)
    if (part.second == 0) loose.push_back(part.first);
  if (loose.empty()) return;
  std::sort(loose.rbegin(), loose.rend());
  std::string sizes;
  for (size_t i = 0; i < std::min<size_t>(loose.size(), 5); ++i) sizes += (i ? ", " : "") + std::to_string(loose[i]);
  report.push_back(std::to_string(loose.size()) + " of " + std::to_string(parts.size()) +
                   " parts of the body hang on nothing anchored (nodes: " + sizes + (loose.size() > 5 ? ", ..." : "") +
                   "): nothing holds them when they are hit");
}

uint8_t most_common(const Tet& tet, const std::vector<uint8_t>& node_region) {
  uint8_t best = 0;
  int most = 0;
  for (uint32_t node : tet.node) {
    const uint8_t region = node_region[node];
    int count = 0;
    for (uint32_t other : tet.node) count += node_region[other] == region;
    if (count > most || (count == most && region < best)) best = region, most = count;
  }
  return best;
}

}  // namespace

RegionsText read_regions(const std::filesystem::path& file) {
  return {file.string(), read_file(file, text_limit, "give a regions file, in the form of schema/regions.fbs")};
}

Regions paint_regions(const TetMesh& mesh, const Surface& surface, const std::optional<RegionsText>& text,
                      const std::string& name, std::vector<std::string>& report) {
  Regions regions{{"body"}, std::vector<uint8_t>(mesh.node.size(), 0), std::vector<uint8_t>(mesh.node.size(), 0), {}};
  paint_by_color(mesh, surface, regions, report);
  if (text) paint_by_text(mesh, *text, regions, report);
  const auto anchored = std::count(regions.node_anchored.begin(), regions.node_anchored.end(), 1);
  if (anchored == 0) anchor_default_cell(mesh, name, regions, report);
  report_loose_parts(mesh, regions, report);
  for (const Tet& tet : mesh.tet) regions.tet_region.push_back(most_common(tet, regions.node_region));
  return regions;
}

}  // namespace crumple

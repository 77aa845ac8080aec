#include "bake/bake.h"

#include <flatbuffers/flatbuffers.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <iterator>
#include <limits>
#include <stdexcept>

#include "bake/build_constraints.h"
#include "bake/built_in.h"
#include "bake/load_car.h"
#include "bake/order_spatially.h"
#include "bake/paint_regions.h"
#include "bake/parts.h"
#include "bake/report_parts.h"
#include "bake/text_of.h"
#include "car/build_skin.h"
#include "car/car.h"
#include "io/files.h"
#include "schema/car_generated.h"

namespace crumple {
namespace {

constexpr std::string_view built_in = "built-in";
constexpr size_t default_vertices = 1'259;  // the thesis's smaller surface

// Checks that are cheap enough to be made before the tets.
void check_options(const BakeOptions& options) {
  if (options.mass != 0 && !(options.mass >= least_mass && options.mass <= most_mass))
    throw std::runtime_error("--mass: give the car's mass in kg, from 10 to 100000.");
}

// ---- input -------------------------------------------------------------------------------------------------------------

size_t built_in_vertices(const std::string& input) {
  if (input == built_in) return default_vertices;
  size_t vertices = 0;
  const char* end = input.data() + input.size();
  const auto [stop, error] = std::from_chars(input.data() + built_in.size() + 1, end, vertices);
  if (error != std::errc() || stop != end || vertices < 400 || vertices > 20'000)
    throw std::runtime_error(input + ": write built-in:VERTICES with a number from 400 to 20000, such as built-in:1259.");
  return vertices;
}

bool is_built_in(const std::string& input) { return input == built_in || input.starts_with(std::string(built_in) + ":"); }

ImportedSurface read_surface(const BakeOptions& options) {
  if (!is_built_in(options.input)) return import_surface(options.input, options.import);
  return build_car(built_in_vertices(options.input));
}

std::string default_name(const std::string& input) {
  return is_built_in(input) ? std::string(built_in) : std::filesystem::path(input).stem().string();
}

std::string default_attribution(const std::string& input) {
  return is_built_in(input) ? "built-in car of the crumple project, Apache-2.0" : "not stated";
}

// Of several parts or open edges fTetWild drops parts, takes minutes, or leaves the car hollow.
Mesher choose_mesher(const ImportedSurface& input, const BakeOptions& options, std::vector<std::string>& report) {
  if (options.mesher) return *options.mesher;
  if (input.parts == 1 && input.open_edges == 0) return Mesher::ftetwild;
  report.push_back("the lattice makes the tets, because the surface is not one closed part");
  return Mesher::lattice;
}

// What tets are made for.
ImportedSurface solid_of(const ImportedSurface& input, const Division& division, const BakeOptions& options,
                         std::vector<std::string>& report) {
  if (division.part.empty()) return input;
  std::vector<uint8_t> keep;
  size_t kept = 0;
  for (uint8_t part : division.of_triangle) kept += keep.emplace_back(is_solid(division.part[part].kind));
  if (kept == 0)
    throw std::runtime_error(options.input + ": wheels and interior are all that it has; leave the body to itself.");
  if (kept == keep.size()) return input;
  report.push_back(std::to_string(keep.size() - kept) + " triangles of wheels and interior get no tets");
  return keep_triangles(input, keep);
}

// ---- output ------------------------------------------------------------------------------------------------------------

template <class Theirs, class Ours>
auto structs(flatbuffers::FlatBufferBuilder& builder, const std::vector<Ours>& list) {
  static_assert(sizeof(Theirs) == sizeof(Ours));
  return builder.CreateVectorOfStructs(reinterpret_cast<const Theirs*>(list.data()), list.size());
}

schema::Vec3 stored(const Vec3& v) { return {v.x(), v.y(), v.z()}; }

struct Made {
  const Surface& surface;
  const TetMesh& tets;
  const Constraints& constraints;
  const Masses& masses;
  const Regions& regions;
  const SkinResult& skin;
  std::span<const double> source_to_car;
  const std::vector<Part>& part;
  const std::vector<Look>& look;
};

flatbuffers::Offset<flatbuffers::Vector<flatbuffers::Offset<schema::Part>>> stored(flatbuffers::FlatBufferBuilder& builder,
                                                                                   const std::vector<Part>& parts) {
  std::vector<flatbuffers::Offset<schema::Part>> out;
  for (const Part& part : parts) {
    const schema::Vec3 position(part.position[0], part.position[1], part.position[2]);
    const auto& q = part.orientation;
    const schema::Quat orientation(q[0], q[1], q[2], q[3]);
    out.push_back(schema::CreatePart(builder, builder.CreateString(part.name), part.kind, &position, &orientation, part.radius,
                                     part.width));
  }
  return builder.CreateVector(out);
}

flatbuffers::Offset<flatbuffers::Vector<flatbuffers::Offset<schema::Look>>> stored(flatbuffers::FlatBufferBuilder& builder,
                                                                                   const std::vector<Look>& looks) {
  std::vector<flatbuffers::Offset<schema::Look>> out;
  for (const auto& [name, color, metallic, roughness] : looks) {
    const schema::Color stored_color(color[0], color[1], color[2], color[3]);
    out.push_back(schema::CreateLook(builder, builder.CreateString(name), &stored_color, metallic, roughness));
  }
  return builder.CreateVector(out);
}

std::vector<std::byte> serialise(const Made& made, const BakeOptions& options) {
  flatbuffers::FlatBufferBuilder builder(1 << 20);
  const auto name = builder.CreateString(options.name.empty() ? default_name(options.input) : options.name);
  const auto attribution =
      builder.CreateString(options.attribution.empty() ? default_attribution(options.input) : options.attribution);
  const auto node = structs<schema::Vec3>(builder, made.tets.node);
  const auto node_mass = builder.CreateVector(made.masses.node);
  const auto node_region = builder.CreateVector(made.regions.node_region);
  const auto node_anchored = builder.CreateVector(made.regions.node_anchored);
  const auto tet = structs<schema::Tet>(builder, made.tets.tet);
  const auto gradients = structs<schema::Gradients>(builder, made.constraints.gradients);
  const auto tet_rest = builder.CreateVector(made.constraints.tet_rest);
  const auto tet_region = builder.CreateVector(made.regions.tet_region);
  const auto edge = structs<schema::Edge>(builder, made.constraints.edge);
  const auto edge_rest = builder.CreateVector(made.constraints.edge_rest);
  const auto node_first = builder.CreateVector(made.constraints.node_first);
  const auto corner = builder.CreateVector(made.constraints.corner);
  const auto vertex = structs<schema::Vec3>(builder, made.surface.vertex);
  const auto triangle = builder.CreateVector(made.surface.triangle.data()->data(), 3 * made.surface.triangle.size());
  const auto skin = structs<schema::Skin>(builder, made.skin.skin);
  const auto region = builder.CreateVectorOfStrings(made.regions.name);
  const auto source_to_car = builder.CreateVector(made.source_to_car.data(), made.source_to_car.size());
  flatbuffers::Offset<flatbuffers::Vector<flatbuffers::Offset<schema::Part>>> part;
  flatbuffers::Offset<flatbuffers::Vector<uint8_t>> vertex_part;
  if (!made.part.empty()) part = stored(builder, made.part), vertex_part = builder.CreateVector(made.surface.part);
  flatbuffers::Offset<flatbuffers::Vector<flatbuffers::Offset<schema::Look>>> look;
  flatbuffers::Offset<flatbuffers::Vector<uint8_t>> triangle_look;
  if (!made.look.empty()) look = stored(builder, made.look), triangle_look = builder.CreateVector(made.surface.look);
  const schema::Vec3 center = stored(made.masses.center), inertia = stored(made.masses.inertia);
  schema::FinishCarBuffer(builder, schema::CreateCar(builder, 1, name, attribution, node, node_mass, node_region, node_anchored,
                                                     tet, gradients, tet_rest, tet_region, edge, edge_rest, node_first, corner,
                                                     vertex, triangle, skin, region, static_cast<float>(options.mass), &center,
                                                     &inertia, source_to_car, part, vertex_part, look, triangle_look));
  const auto* bytes = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return {bytes, bytes + builder.GetSize()};
}

void report_result(const Made& made, std::vector<std::string>& report) {
  const auto [smallest, largest] = std::minmax_element(made.constraints.tet_rest.begin(), made.constraints.tet_rest.end());
  report.push_back(std::to_string(made.tets.node.size()) + " nodes, " + std::to_string(made.tets.tet.size()) +
                   " volume constraints (" + text_of(*smallest, "%.2g") + " to " + text_of(*largest, "%.2g") + " m^3), " +
                   std::to_string(made.constraints.edge.size()) + " distance constraints");
  const SkinResult& skin = made.skin;
  report.push_back("skin: " + std::to_string(skin.coincident) + " vertices on a node, " + std::to_string(skin.contained) +
                   " inside a tet, " + std::to_string(skin.nearest) + " on the nearest tet" +
                   (skin.nearest ? ", at most " + text_of(1000 * skin.farthest, "%.1f") + " mm away" : ""));
}

// Wheels move with the frame of their part (schema/car.fbs), so each gets one node, of those that other vertices follow anyway:
// the server sends nothing for it, and an older viewer lets the wheel follow it.
SkinResult skin_with_wheels(const TetMesh& tets, const Surface& surface, const std::vector<Part>& parts) {
  const auto is_wheel = [&](size_t vertex) {
    return !surface.part.empty() && parts[surface.part[vertex]].kind == schema::PartKind::wheel;
  };
  std::vector<Vec3> body;
  for (size_t i = 0; i < surface.vertex.size(); ++i)
    if (!is_wheel(i)) body.push_back(surface.vertex[i]);
  SkinResult out = build_skin(tets, body);
  if (body.size() == surface.vertex.size()) return out;
  std::vector<Skin> of_part(parts.size());
  for (size_t k = 0; k < parts.size(); ++k) {
    const Vec3 hub(parts[k].position[0], parts[k].position[1], parts[k].position[2]);
    float least = std::numeric_limits<float>::infinity();
    for (const Skin& skin : out.skin)
      for (uint32_t c = 0; c < 4; ++c) {
        const float squared = (tets.node[skin.node[c]] - hub).squaredNorm();
        if (!(skin.weight[c] > 0) || !(squared < least)) continue;
        least = squared;
        for (uint32_t j = 0; j < 4; ++j) of_part[k].node[j] = skin.node[(c + j) % 4];
      }
    of_part[k].weight[0] = 1;
  }
  SkinResult all = out;
  all.skin.clear(), all.tet.clear(), all.distance.clear();
  for (size_t i = 0, next = 0; i < surface.vertex.size(); ++i) {
    const bool wheel = is_wheel(i);
    all.skin.push_back(wheel ? of_part[surface.part[i]] : out.skin[next]);
    all.tet.push_back(wheel ? 0 : out.tet[next]);
    all.distance.push_back(wheel ? 0 : out.distance[next]);
    next += !wheel;
  }
  return all;
}

// Gives each triangle the look of its named part. A car has at most max_looks, each once; those beyond are left out.
std::vector<Look> collect_looks(const ImportedSurface& input, std::vector<uint8_t>& of_triangle) {
  std::vector<Look> out;
  of_triangle.assign(input.surface.triangle.size(), no_look);
  for (size_t i = 0; i < input.named.size(); ++i) {
    const auto& look = input.named[i].look;
    const size_t first = input.named[i].first;
    const size_t end = i + 1 < input.named.size() ? input.named[i + 1].first : of_triangle.size();
    if (!look || first == end) continue;
    const size_t at = static_cast<size_t>(std::find(out.begin(), out.end(), *look) - out.begin());
    if (at == max_looks) continue;
    if (at == out.size()) out.push_back(*look);
    std::fill(of_triangle.begin() + std::ptrdiff_t(first), of_triangle.begin() + std::ptrdiff_t(end), static_cast<uint8_t>(at));
  }
  if (out.empty()) of_triangle.clear();
  return out;
}

// Refuses tets of another car, tets in other axes, and surfaces that enclose next to nothing. A few far vertices may be an
// aerial.
void check_fit(const Surface& surface, const SkinResult& skin, const BakeOptions& options) {
  Eigen::AlignedBox3f box;
  for (const Vec3& vertex : surface.vertex) box.extend(vertex);
  const double limit = 0.03 * box.sizes().maxCoeff();
  const auto far = std::count_if(skin.distance.begin(), skin.distance.end(), [&](double distance) { return distance > limit; });
  if (4 * far <= std::ssize(skin.distance)) return;
  const std::string remedy = options.tets.empty() ? "close the surface's holes, so that it has an inside"
                                                  : "give tets of this very surface, in its axes and unit";
  throw std::runtime_error((options.tets.empty() ? options.input : options.tets.string()) + ": " + std::to_string(far) +
                           " of " + std::to_string(skin.distance.size()) + " vertices lie more than " + text_of(limit, "%.2f") +
                           " m outside the tets, up to " + text_of(skin.farthest, "%.2f") + " m; " + remedy + ".");
}

}  // namespace

BakeResult assemble_car(Surface surface, TetMesh tets, const BakeOptions& given, std::span<const double> source_to_car,
                        const std::vector<Part>& part, const std::vector<Look>& look) {
  BakeOptions options = given;
  if (options.mass == 0) options.mass = default_mass;
  BakeResult out;
  order_spatially(surface);
  order_spatially(tets);
  const Constraints constraints = build_constraints(tets);
  const Masses masses = lump_masses(tets, constraints.tet_rest, options.mass);
  const Regions regions = paint_regions(tets, surface, options.regions, options.input, out.report);
  const SkinResult skin = skin_with_wheels(tets, surface, part);
  check_fit(surface, skin, options);
  const Made made{surface, tets, constraints, masses, regions, skin, source_to_car, part, look};
  report_result(made, out.report);
  out.car = read_car(serialise(made, options), options.input);
  out.distance = skin.distance;
  return out;
}

BakeResult bake(const BakeOptions& options, const Progress& progress) {
  check_options(options);
  if (is_baked_car(options.input)) return rebake(*load_car(options.input), options);
  const ImportedSurface input = read_surface(options);
  std::vector<std::string> report = input.report;
  const PartsText text = options.parts ? *options.parts : propose_parts(input, report);
  const Division division = divide_surface(input, text, options.input);
  const ImportedSurface solid = solid_of(input, division, options, report);
  TetMesh tets;
  if (!options.tets.empty())
    tets = import_tets(options.tets, input.from_file, report);
  else if (choose_mesher(solid, options, report) == Mesher::lattice)
    tets = fill_with_tets(solid, options.nodes, options.input, progress, report);
  else
    tets = tetrahedralise(solid, options.nodes, options.input, progress, report);
  if (progress) progress("constraints, skin and regions");
  const Eigen::Matrix<double, 3, 4, Eigen::RowMajor> to_car = input.from_file.affine();
  Surface surface = input.surface;
  if (!division.part.empty()) split_at_parts(surface, division.of_triangle);
  const std::vector<Look> look = collect_looks(input, surface.look);
  if (!look.empty()) report.push_back(std::to_string(look.size()) + " looks kept, of materials with a colour and no texture");
  BakeResult out = assemble_car(std::move(surface), std::move(tets), options, {to_car.data(), 12}, division.part, look);
  out.parts = text.text;
  out.report.insert(out.report.begin(), report.begin(), report.end());
  const Model& model = out.car->model;  // its triangles are in the order of the surface
  const std::vector<std::string> far = report_far_parts(model.vertex, model.triangle, out.distance, input.named);
  out.report.insert(out.report.end(), far.begin(), far.end());
  return out;
}

bool is_baked_car(const std::filesystem::path& file) {
  char head[8] = {};
  std::error_code none;
  if (!std::filesystem::is_regular_file(file, none)) return false;  // opening a pipe would wait
  std::ifstream(file, std::ios::binary).read(head, sizeof head);
  return schema::CarBufferHasIdentifier(head);
}

// Nodes, tets and vertices are in spatial order already, and ordering them again changes nothing.
BakeResult rebake(const Car& car, BakeOptions options) {
  check_options(options);
  const Model& model = car.model;
  const auto &part = car.parts.of_vertex, &look = car.looks.of_triangle;
  Surface surface{{model.vertex.begin(), model.vertex.end()}, {}, {}, {part.begin(), part.end()}, {look.begin(), look.end()}};
  for (size_t i = 0; i < model.triangle.size(); i += 3)
    surface.triangle.push_back({model.triangle[i], model.triangle[i + 1], model.triangle[i + 2]});
  if (options.mass == 0) options.mass = double(model.mass);
  if (options.name.empty()) options.name = car.name;
  if (options.attribution.empty()) options.attribution = car.attribution;
  return assemble_car(std::move(surface), {{model.node.begin(), model.node.end()}, {model.tet.begin(), model.tet.end()}},
                      options, car.source_to_car, car.parts.part, car.looks.look);
}

void write_car(const Car& car, const std::filesystem::path& file) {
  FileWriter writer(file);
  writer.put(car.bytes.data(), car.bytes.size());
  writer.finish();
}

}  // namespace crumple

#include "bake/import_surface.h"

#include <assimp/GltfMaterial.h>
#include <assimp/commonMetaData.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>
#include <fcntl.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <assimp/Importer.hpp>
#include <cerrno>
#include <cmath>
#include <csignal>
#include <cstring>
#include <numeric>
#include <sstream>
#include <stdexcept>

#include "bake/check_shape.h"
#include "bake/text_of.h"
#include "car/car.h"
#include "io/files.h"

namespace crumple {
namespace {

constexpr double shortest_car = 0.5, longest_car = 25;  // m: a pedal car, an articulated bus
// Most vertices and triangles of a file, before any are joined or dropped.
constexpr size_t most_vertices_read = size_t{16} * max_vertices, most_triangles_read = 2 * most_vertices_read;
constexpr size_t most_levels_read = 1000;                  // nesting of nodes: a car has ten levels
constexpr uintmax_t largest_input = uintmax_t{512} << 20;  // bytes: a car with its textures in one GLB
constexpr rlim_t reader_memory = rlim_t{2} << 30;          // bytes: four times the largest input
constexpr unsigned reader_seconds = 300;                   // s; the largest input takes seconds
constexpr size_t most_names_read = 4096, longest_name = 128, longest_names = 512;
constexpr float opaque = 0.99f;
// The triangles from `first` up to the next part's. The names are the file's, end at a zero, and may hold any bytes.
struct PartRead {
  uint32_t first = 0;
  uint8_t transparent = 0, blended = 0, plain = 0;  // plain: it has a colour, and no texture
  float color[4] = {}, metallic = 0, roughness = 1;
  char name[longest_name] = {};
  char names[longest_names] = {};  // a line each
};
// Most bytes of the child's answer: position and colour per vertex, corners per triangle, names, and some counts.
constexpr size_t most_answer = most_vertices_read * (3 * sizeof(double) + sizeof(uint32_t)) +
                               most_triangles_read * sizeof(Triangle) + most_names_read * sizeof(PartRead) + 100;
constexpr double flat_below = 0.01;  // shortest side over the longest
constexpr size_t most_parts = 1000;  // more are a scan's crumbs, not a body: game cars have one to a few hundred

[[noreturn]] void refuse(const std::string& name, const std::string& fact) { throw std::runtime_error(name + ": " + fact); }

Eigen::Vector3d axis(const std::string& spelling, const char* flag) {
  const bool negative = spelling.starts_with('-');
  const std::string letter = spelling.substr(negative || spelling.starts_with('+') ? 1 : 0);
  if (letter != "x" && letter != "y" && letter != "z")
    throw std::runtime_error(std::string("--") + flag + " " + spelling + ": an axis is one of x, y, z, -x, -y, -z.");
  return (negative ? -1 : 1) * Eigen::Vector3d::Unit(letter[0] - 'x');
}

// The rows are the car's axes in the file's coordinates.
Eigen::Matrix3d axes(const std::string& forward, const std::string& up) {
  const Eigen::Vector3d x = axis(forward, "forward"), z = axis(up, "up");
  if (x.dot(z) != 0)
    throw std::runtime_error("--forward " + forward + " --up " + up + ": forward and up must be two different axes.");
  Eigen::Matrix3d rotation;
  rotation << x.transpose(), z.cross(x).transpose(), z.transpose();
  return rotation;
}

// ---- reading the file ------------------------------------------------------------------------------------------------

struct Flattened {
  std::vector<Eigen::Vector3d> position;
  std::vector<uint32_t> color;  // 0xrrggbb; only kept when `painted`
  std::vector<Triangle> triangle;
  std::vector<PartRead> part;
  uint64_t painted = false;
  uint64_t meshes = 0;
  uint64_t not_triangles = 0;
};

uint32_t color_of(const aiColor4D& color) {
  const auto channel = [](float value) { return static_cast<uint32_t>(std::lround(255 * std::clamp(value, 0.0f, 1.0f))); };
  return channel(color.r) << 16 | channel(color.g) << 8 | channel(color.b);
}

void append(const aiMesh& mesh, const Eigen::Affine3d& placed, const std::string& name, Flattened& out) {
  const size_t vertices = out.position.size() + mesh.mNumVertices, triangles = out.triangle.size() + mesh.mNumFaces;
  if (vertices > most_vertices_read || triangles > most_triangles_read)
    refuse(name, "it has over " + std::to_string(most_vertices_read) + " vertices or " + std::to_string(most_triangles_read) +
                     " triangles; decimate it to at most " + std::to_string(max_vertices) + " vertices.");
  const auto first = static_cast<uint32_t>(out.position.size());
  for (unsigned i = 0; i < mesh.mNumVertices; ++i) {
    const aiVector3D& v = mesh.mVertices[i];
    out.position.push_back(placed * Eigen::Vector3d(v.x, v.y, v.z));
    out.color.push_back(mesh.HasVertexColors(0) ? color_of(mesh.mColors[0][i]) : 0xffffff);
  }
  out.painted |= mesh.HasVertexColors(0);
  ++out.meshes;
  const bool mirrored = placed.linear().determinant() < 0;
  for (unsigned i = 0; i < mesh.mNumFaces; ++i) {
    const aiFace& face = mesh.mFaces[i];
    const bool sound = face.mNumIndices == 3 &&
                       std::all_of(face.mIndices, face.mIndices + 3, [&](unsigned index) { return index < mesh.mNumVertices; });
    if (!sound) {
      ++out.not_triangles;
      continue;
    }
    Triangle corners = {first + face.mIndices[0], first + face.mIndices[1], first + face.mIndices[2]};
    if (mirrored) std::swap(corners[1], corners[2]);
    out.triangle.push_back(corners);
  }
}

void read_material(const aiMaterial& material, PartRead& part) {
  float opacity = 1;
  material.Get(AI_MATKEY_OPACITY, opacity);
  part.transparent = opacity < opaque;
  aiString mode;
  material.Get(AI_MATKEY_GLTF_ALPHAMODE, mode);
  part.blended = std::strcmp(mode.C_Str(), "BLEND") == 0;
  // Only glTF has base colours. Others have a diffuse colour as pictures have it, and Assimp's own material says nothing.
  aiColor4D color;
  const bool physical = material.Get(AI_MATKEY_BASE_COLOR, color) == AI_SUCCESS;
  if (!physical && material.Get(AI_MATKEY_COLOR_DIFFUSE, color) != AI_SUCCESS) return;
  if (std::strcmp(material.GetName().C_Str(), AI_DEFAULT_MATERIAL_NAME) == 0) return;
  part.plain = material.GetTextureCount(aiTextureType_DIFFUSE) == 0 && material.GetTextureCount(aiTextureType_BASE_COLOR) == 0;
  const float channel[] = {color.r, color.g, color.b, physical ? color.a : opacity};
  for (int k = 0; k < 4; ++k) {
    const float value = std::isfinite(channel[k]) ? std::clamp(channel[k], 0.0f, 1.0f) : 1;
    part.color[k] = k == 3 || physical ? value : std::pow(value, 2.2f);
  }
  const auto share = [&](auto... key) {
    float value = 0;
    return material.Get(key..., value) == AI_SUCCESS && std::isfinite(value) ? std::clamp(value, 0.0f, 1.0f) : -1;
  };
  part.metallic = std::max(share(AI_MATKEY_METALLIC_FACTOR), 0.0f);
  const float roughness = share(AI_MATKEY_ROUGHNESS_FACTOR);
  part.roughness = roughness < 0 ? 0.5f : roughness;
}

// A node may hold several meshes, which differ by their materials.
void start_part(const aiScene& scene, const aiNode& node, const aiMesh& mesh, Flattened& out) {
  if (out.part.size() == most_names_read) return;
  std::string name = (node.mName.length ? node.mName : mesh.mName).C_Str();
  if (node.mNumMeshes > 1 && mesh.mMaterialIndex < scene.mNumMaterials)
    name += std::string(" ") + scene.mMaterials[mesh.mMaterialIndex]->GetName().C_Str();
  if (out.part.size() + 1 == most_names_read) name = "other parts";
  PartRead part;
  part.first = static_cast<uint32_t>(out.triangle.size());
  std::memcpy(part.name, name.data(), std::min(name.size(), longest_name));
  std::string names;
  if (mesh.mMaterialIndex < scene.mNumMaterials) {
    const aiMaterial& material = *scene.mMaterials[mesh.mMaterialIndex];
    names = std::string(material.GetName().C_Str()) + "\n";
    read_material(material, part);
  }
  names += mesh.mName.C_Str();
  for (const aiNode* each = &node; each && names.size() < longest_names; each = each->mParent)
    names += std::string("\n") + each->mName.C_Str();
  if (out.part.size() + 1 < most_names_read) std::memcpy(part.names, names.data(), std::min(names.size(), longest_names));
  out.part.push_back(part);
}

void flatten(const aiScene& scene, const aiNode& node, const Eigen::Affine3d& above, size_t level, const std::string& name,
             Flattened& out) {
  if (level > most_levels_read)
    refuse(name, "its nodes are nested deeper than " + std::to_string(most_levels_read) + "; join them into one mesh.");
  const aiMatrix4x4& m = node.mTransformation;
  Eigen::Affine3d own;
  own.matrix() << m.a1, m.a2, m.a3, m.a4, m.b1, m.b2, m.b3, m.b4, m.c1, m.c2, m.c3, m.c4, 0, 0, 0, 1;
  const Eigen::Affine3d placed = above * own;
  for (unsigned i = 0; i < node.mNumMeshes; ++i) {
    const aiMesh& mesh = *scene.mMeshes[node.mMeshes[i]];
    start_part(scene, node, mesh, out);
    append(mesh, placed, name, out);
  }
  for (unsigned i = 0; i < node.mNumChildren; ++i) flatten(scene, *node.mChildren[i], placed, level + 1, name, out);
}

Flattened read_scene(const std::string& name) {
  Assimp::Importer importer;
  const aiScene* scene = importer.ReadFile(name, aiProcess_Triangulate);
  if (!scene || !scene->mRootNode) {
    std::string why = scene ? "it has no scene" : importer.GetErrorString();
    if (why.find("bad_alloc") != why.npos) throw std::bad_alloc();
    while (!why.empty() && (why.back() == '\n' || why.back() == '.')) why.pop_back();
    refuse(name, "no surface can be read from it (" + why + "); export it as OBJ, glTF, GLB, STL or PLY.");
  }
  aiString version;
  if (scene->mMetaData && scene->mMetaData->Get(AI_METADATA_SOURCE_FORMAT_VERSION, version) && version.data[0] == '1' &&
      name.find(".gl") != name.npos)
    refuse(name, "it is glTF 1.0, of which Assimp misplaces nodes that are turned; export it as glTF 2.0.");
  Flattened out;
  flatten(*scene, *scene->mRootNode, Eigen::Affine3d::Identity(), 0, name, out);
  return out;
}

// ---- reading it in a child process -------------------------------------------------------------------------------------
// Assimp follows the nodes of a file by recursion, in some formats for ever, and copies a node each time that another node
// names it. So a file of some kB can exhaust the stack or the memory. Therefore a child process with limits reads the file.

template <class T>
void pack(const std::vector<T>& list, std::string& to) {
  const uint64_t count = list.size();
  to.append(reinterpret_cast<const char*>(&count), sizeof count);
  to.append(reinterpret_cast<const char*>(list.data()), count * sizeof(T));
}

// Returns false if the text is too short.
template <class T>
bool unpack(std::string_view& from, std::vector<T>& list) {
  uint64_t count = 0;
  if (from.size() < sizeof count) return false;
  std::memcpy(&count, from.data(), sizeof count);
  from.remove_prefix(sizeof count);
  if (count > from.size() / sizeof(T)) return false;
  list.resize(count);
  if (count > 0) std::memcpy(static_cast<void*>(list.data()), from.data(), count * sizeof(T));
  from.remove_prefix(count * sizeof(T));
  return true;
}

std::string packed(const Flattened& surface) {
  std::string text = "+";
  pack(surface.position, text);
  pack(surface.color, text);
  pack(surface.triangle, text);
  pack(surface.part, text);
  pack(std::vector<uint64_t>{surface.painted, surface.meshes, surface.not_triangles}, text);
  return text;
}

bool unpacked(std::string_view text, Flattened& surface) {
  std::vector<uint64_t> numbers;
  if (!unpack(text, surface.position) || !unpack(text, surface.color) || !unpack(text, surface.triangle) ||
      !unpack(text, surface.part) || !unpack(text, numbers) || numbers.size() != 3 || surface.part.size() > most_names_read)
    return false;
  surface.painted = numbers[0];
  surface.meshes = numbers[1];
  surface.not_triangles = numbers[2];
  const size_t count = surface.position.size();
  return surface.color.size() == count && std::all_of(surface.triangle.begin(), surface.triangle.end(), [&](const Triangle& t) {
           return std::max({t[0], t[1], t[2]}) < count;
         });
}

[[noreturn]] void read_as_child(const std::string& name, int to) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  alarm(reader_seconds);
  const rlimit none{0, 0};
  setrlimit(RLIMIT_CORE, &none);
#if !defined(CRUMPLE_SANITIZE)  // the address sanitizer needs terabytes of addresses
  const rlimit memory{reader_memory, reader_memory};
  setrlimit(RLIMIT_DATA, &memory);
#endif
  std::string text;
  try {
    text = packed(read_scene(name));
  } catch (const std::bad_alloc&) {
    text = "-" + name +
           ": it takes over 2 GiB of memory to read, as where nodes name others again and again; join its parts into one mesh.";
  } catch (const std::exception& refused) {
    text = std::string("-") + refused.what();
  }
  for (std::string_view left = text; !left.empty();) {
    const ssize_t wrote = write(to, left.data(), left.size());
    if (wrote < 0 && errno != EINTR) break;
    left.remove_prefix(static_cast<size_t>(std::max<ssize_t>(0, wrote)));
  }
  _exit(0);
}

Flattened read_file(const std::filesystem::path& file) {
  const std::string name = file.string();
  std::error_code error;
  if (std::filesystem::is_directory(file, error)) refuse(name, "this is a folder; name the mesh file inside it.");
  if (!std::filesystem::exists(file, error)) refuse(name, "there is no such file; check the path.");
  if (!std::filesystem::is_regular_file(file, error)) refuse(name, "this is a pipe or a device; name a mesh file.");
  const uintmax_t size = std::filesystem::file_size(file, error);
  if (size == 0 && !error) refuse(name, "the file is empty; export the mesh again.");
  if (size > largest_input) refuse(name, "it is larger than 512 MiB; export the body alone, without textures.");
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0)
    refuse(name, std::string("no pipe can be opened (") + std::strerror(errno) + "); close other programs.");
  const pid_t child = fork();
  if (child == 0) read_as_child(name, ends[1]);
  close(ends[1]);
  const std::optional<std::string> answer = child > 0 ? read_pipe(ends[0], most_answer) : "";
  close(ends[0]);
  if (!answer) kill(child, SIGKILL);  // it sent more than the largest answer
  const std::string text = answer.value_or("");
  int status = 0;
  while (child > 0 && waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (child < 0) refuse(name, "no process can be started to read it; close other programs.");
  if (text.starts_with("-")) throw std::runtime_error(text.substr(1));
  if (WIFSIGNALED(status) && WTERMSIG(status) == SIGALRM)
    refuse(name, "it takes longer than " + std::to_string(reader_seconds) + " s to read; join its parts into one mesh.");
  Flattened out;
  if (!text.starts_with("+") || !unpacked(std::string_view(text).substr(1), out))
    refuse(name, std::string("the program that reads it broke down (") +
                     (WIFSIGNALED(status) ? strsignal(WTERMSIG(status)) : "Assimp") +
                     "), perhaps because its nodes are nested thousands deep; join its parts into one mesh, or export it as "
                     "OBJ, GLB, STL or PLY.");
  return out;
}

// ---- checking and placing ----------------------------------------------------------------------------------------------

// For each position, the index of the first equal one.
std::vector<uint32_t> weld(const std::vector<Vec3>& position) {
  std::vector<uint32_t> order(position.size()), first(position.size());
  std::iota(order.begin(), order.end(), 0u);
  const auto less = [&](uint32_t a, uint32_t b) {
    const Vec3 &p = position[a], &q = position[b];
    return std::lexicographical_compare(p.data(), p.data() + 3, q.data(), q.data() + 3);
  };
  std::stable_sort(order.begin(), order.end(), less);
  for (size_t i = 0; i < order.size(); ++i)
    first[order[i]] = i > 0 && position[order[i]] == position[order[i - 1]] ? first[order[i - 1]] : order[i];
  return first;
}

bool degenerate(const Vec3& a, const Vec3& b, const Vec3& c) {
  constexpr double smallest_area = 1e-12;  // m^2: floats of a car's size cannot tell smaller ones from a line
  return (b - a).cast<double>().cross((c - a).cast<double>()).norm() / 2 <= smallest_area;
}

size_t count_parts(const Surface& surface) {
  const auto part_of = connected(surface.vertex.size(), {surface.triangle.data()->data(), 3 * surface.triangle.size()}, 3);
  size_t parts = 0;
  for (uint32_t i = 0; i < part_of.size(); ++i) parts += part_of[i] == i;
  return parts;
}

size_t count_open_edges(const Surface& surface) {
  std::vector<uint64_t> edges;
  for (const Triangle& t : surface.triangle)
    for (int k = 0; k < 3; ++k) {
      const auto [low, high] = std::minmax(t[k], t[(k + 1) % 3]);
      edges.push_back(uint64_t{low} << 32 | high);
    }
  std::sort(edges.begin(), edges.end());
  size_t open = 0;
  for (size_t i = 0; i < edges.size(); ++i)
    open += (i == 0 || edges[i - 1] != edges[i]) && (i + 1 == edges.size() || edges[i + 1] != edges[i]);
  return open;
}

// Scales, turns, then drops to the ground and centres.
Eigen::Affine3d placement(const std::vector<Eigen::Vector3d>& positions, const ImportOptions& options,
                          const std::string& name) {
  if (!(options.scale > 0) || !std::isfinite(options.scale))
    throw std::runtime_error("--scale: it must be a number above zero.");
  Eigen::Affine3d turned(options.scale *
                         axes(options.forward.empty() ? "x" : options.forward, options.up.empty() ? "z" : options.up));
  Eigen::AlignedBox3d box;
  for (size_t i = 0; i < positions.size(); ++i) {
    if (!positions[i].allFinite())
      refuse(name, "vertex " + std::to_string(i) + " is not a finite number; export the mesh again without it.");
    box.extend(turned * positions[i]);
  }
  const double longest = box.sizes().maxCoeff(), shortest = box.sizes().minCoeff();
  const std::string size =
      text_of(box.sizes().x()) + " x " + text_of(box.sizes().y()) + " x " + text_of(box.sizes().z()) + " m";
  if (longest < shortest_car || longest > longest_car)
    refuse(name, "it measures " + size + ", but the longest side of a car must be from " + text_of(shortest_car) + " to " +
                     text_of(longest_car) + " m; give the size of one unit of the file in metres, perhaps --scale " +
                     likely_scale(longest / options.scale) + ".");
  if (shortest < flat_below * longest) refuse(name, "it is flat (" + size + "); a car needs a body with an inside.");
  return Eigen::Translation3d(-box.center().x(), -box.center().y(), -box.min().z()) * turned;
}

void drop_unused(Surface& surface, const std::vector<uint8_t>& used) {
  std::vector<uint32_t> place(surface.vertex.size());
  uint32_t count = 0;
  for (size_t i = 0; i < used.size(); ++i) {
    place[i] = count;
    if (!used[i]) continue;
    surface.vertex[count] = surface.vertex[i];
    if (!surface.color.empty()) surface.color[count] = surface.color[i];
    ++count;
  }
  surface.vertex.resize(count);
  if (!surface.color.empty()) surface.color.resize(count);
  for (Triangle& triangle : surface.triangle)
    for (uint32_t& vertex : triangle) vertex = place[vertex];
}

std::string printable(std::string text) {
  for (char& c : text) c = c >= ' ' && c <= '~' ? c : '?';
  return text;
}

// The names are a stranger's text: only printable ASCII is shown.
std::vector<NamedPart> named_parts(const std::vector<PartRead>& read, const std::vector<uint32_t>& kept) {
  std::vector<NamedPart> out;
  for (const PartRead& part : read) {
    NamedPart named;
    named.name = printable({part.name, strnlen(part.name, longest_name)});
    if (named.name.find_first_not_of(' ') == named.name.npos) named.name = "a part without a name";
    named.first = static_cast<size_t>(std::lower_bound(kept.begin(), kept.end(), part.first) - kept.begin());
    std::istringstream names(std::string(part.names, strnlen(part.names, longest_names)));
    for (std::string line; std::getline(names, line);)
      if (!line.empty()) named.names.push_back(printable(line));
    named.transparent = part.transparent;
    named.blended = part.blended;
    if (part.plain && !named.names.empty()) {
      named.look = {named.names[0].substr(0, part_name_limit), {}, part.metallic, part.roughness};
      std::copy(std::begin(part.color), std::end(part.color), named.look->color.begin());
    }
    out.push_back(std::move(named));
  }
  std::stable_sort(out.begin(), out.end(), [](const NamedPart& a, const NamedPart& b) { return a.first < b.first; });
  return out;
}

}  // namespace

ImportedSurface place_surface(const std::vector<Eigen::Vector3d>& positions, const std::vector<uint32_t>& colors,
                              const std::vector<Triangle>& triangles, const ImportOptions& options, const std::string& name) {
  if (positions.empty() || triangles.empty())
    refuse(name, "it holds no triangles; export the body's surface, not only points or lines.");
  ImportedSurface out;
  out.from_file = placement(positions, options, name);
  Surface& surface = out.surface;
  for (const Eigen::Vector3d& position : positions) surface.vertex.push_back((out.from_file * position).cast<float>());
  surface.color = colors;

  const std::vector<uint32_t> first = weld(surface.vertex);
  std::vector<uint8_t> used(positions.size(), 0);
  for (uint32_t i = 0; i < triangles.size(); ++i) {
    Triangle t = triangles[i];
    for (uint32_t& vertex : t) vertex = first[vertex];
    if (degenerate(surface.vertex[t[0]], surface.vertex[t[1]], surface.vertex[t[2]])) continue;
    surface.triangle.push_back(t);
    out.kept.push_back(i);
    for (uint32_t vertex : t) used[vertex] = 1;
  }
  if (surface.triangle.empty()) refuse(name, "none of its triangles has an area; export the mesh again.");
  size_t welded = 0, loose = 0;
  for (uint32_t i = 0; i < first.size(); ++i) {
    welded += first[i] != i;
    loose += first[i] == i && !used[i];
  }
  drop_unused(surface, used);
  if (surface.vertex.size() > max_vertices)
    refuse(name, "it has " + std::to_string(surface.vertex.size()) + " vertices; decimate it to at most " +
                     std::to_string(max_vertices) + ".");
  out.parts = count_parts(surface);
  if (out.parts >= most_parts)
    refuse(name,
           "it falls into " + std::to_string(out.parts) + " pieces that share no vertex; join them, or keep the body only.");
  out.open_edges = count_open_edges(surface);

  Eigen::AlignedBox3f box;
  for (const Vec3& vertex : surface.vertex) box.extend(vertex);
  const Vec3 size = box.sizes();
  out.report = {"size " + text_of(size.x()) + " x " + text_of(size.y()) + " x " + text_of(size.z()) +
                    " m (forward x left x up), " + text_of(options.scale) + " m in a unit of the file",
                std::to_string(surface.vertex.size()) + " vertices, " + std::to_string(surface.triangle.size()) +
                    " triangles, " + std::to_string(out.parts) + (out.parts == 1 ? " part" : " parts") + ", " +
                    std::to_string(out.open_edges) + " open edges" + (out.open_edges ? "" : ": watertight")};
  if (welded) out.report.push_back(std::to_string(welded) + " vertices welded to others of the same position");
  if (loose) out.report.push_back(std::to_string(loose) + " vertices dropped that no triangle uses");
  if (const size_t flat = triangles.size() - surface.triangle.size())
    out.report.push_back(std::to_string(flat) + " triangles dropped that have no area");
  return out;
}

ImportedSurface import_surface(const std::filesystem::path& file, const ImportOptions& options) {
  const Flattened flat = read_file(file);
  ImportOptions chosen = options;
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(), [](unsigned char c) { return std::tolower(c); });
  const bool gltf = extension == ".gltf" || extension == ".glb";
  if (chosen.forward.empty()) chosen.forward = gltf ? "z" : "x";
  if (chosen.up.empty()) chosen.up = gltf ? "y" : "z";
  ImportedSurface out =
      place_surface(flat.position, flat.painted ? flat.color : std::vector<uint32_t>{}, flat.triangle, chosen, file.string());
  out.named = named_parts(flat.part, out.kept);
  out.report.insert(out.report.begin(), std::to_string(flat.meshes) + (flat.meshes == 1 ? " mesh" : " meshes") +
                                            " read; the file's " + chosen.forward + " is forward, its " + chosen.up + " is up");
  const std::vector<std::string> shape = check_shape(out.surface, chosen);
  out.report.insert(out.report.end(), shape.begin(), shape.end());
  if (shape.size() == 1) out.report.push_back(check_front(out, chosen));  // else its axes are in question
  if (flat.not_triangles)
    out.report.push_back(std::to_string(flat.not_triangles) + " faces dropped that are points, lines or name missing vertices");
  return out;
}

ImportedSurface keep_triangles(const ImportedSurface& all, const std::vector<uint8_t>& keep) {
  ImportedSurface out;
  out.from_file = all.from_file;
  out.surface.vertex = all.surface.vertex;
  out.surface.color = all.surface.color;
  std::vector<uint8_t> used(all.surface.vertex.size(), 0);
  for (size_t i = 0; i < keep.size(); ++i) {
    if (!keep[i]) continue;
    out.surface.triangle.push_back(all.surface.triangle[i]);
    out.kept.push_back(all.kept[i]);
    for (uint32_t vertex : all.surface.triangle[i]) used[vertex] = 1;
  }
  drop_unused(out.surface, used);
  out.parts = count_parts(out.surface);
  out.open_edges = count_open_edges(out.surface);
  return out;
}

std::vector<Eigen::Vector3d> read_vertices(const std::filesystem::path& file) { return read_file(file).position; }

}  // namespace crumple

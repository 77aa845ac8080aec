#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <numeric>
#include <stdexcept>

#include "bake/build_constraints.h"
#include "bake/make_tets.h"
#include "bake/script.h"
#include "bake/scripts.h"  // generated: the text of the Python scripts
#include "car/car.h"

namespace crumple {
namespace {

constexpr uintmax_t largest_tets_file = uintmax_t{512} << 20;  // bytes: max_tets as text take a fifth of it
constexpr double smallest_part = 0.02;  // share of the whole volume: smaller parts that no face joins to the rest are dropped

[[noreturn]] void refuse(const std::string& name, const std::string& fact) { throw std::runtime_error(name + ": " + fact); }

// Keeps only nodes that a tet names; returns how many were dropped.
size_t drop_unused(TetMesh& mesh) {
  std::vector<uint32_t> place(mesh.node.size(), UINT32_MAX);
  for (const Tet& tet : mesh.tet)
    for (uint32_t node : tet.node) place[node] = 0;
  uint32_t count = 0;
  for (size_t i = 0; i < place.size(); ++i) {
    if (place[i] == UINT32_MAX) continue;
    mesh.node[count] = mesh.node[i];
    place[i] = count++;
  }
  const size_t dropped = mesh.node.size() - count;
  mesh.node.resize(count);
  for (Tet& tet : mesh.tet)
    for (uint32_t& node : tet.node) node = place[node];
  return dropped;
}

// Finds tets that are connected through faces. parts[i] is the part of tet i: the index of the part's first tet.
std::vector<uint32_t> parts_of(const TetMesh& mesh) {
  std::vector<uint32_t> above(mesh.tet.size());
  std::iota(above.begin(), above.end(), 0u);
  const auto root = [&](uint32_t i) {
    while (above[i] != i) i = above[i] = above[above[i]];
    return i;
  };
  std::vector<std::array<uint32_t, 4>> faces;  // three nodes in order, and the tet
  for (uint32_t t = 0; t < mesh.tet.size(); ++t) {
    for (int out = 0; out < 4; ++out) {
      std::array<uint32_t, 4> face{};
      for (int k = 0, at = 0; k < 4; ++k)
        if (k != out) face[at++] = mesh.tet[t].node[k];
      std::sort(face.begin(), face.begin() + 3);
      face[3] = t;
      faces.push_back(face);
    }
  }
  std::sort(faces.begin(), faces.end());
  for (size_t i = 1; i < faces.size(); ++i) {
    if (!std::equal(faces[i].begin(), faces[i].begin() + 3, faces[i - 1].begin())) continue;
    const uint32_t a = root(faces[i - 1][3]), b = root(faces[i][3]);
    above[std::max(a, b)] = std::min(a, b);
  }
  for (uint32_t t = 0; t < above.size(); ++t) above[t] = root(t);
  return above;
}

// Drops small parts that share a node or an edge with the rest, but no face: such a joint would flap without resistance.
void drop_small_parts(TetMesh& mesh, std::vector<std::string>& report) {
  const std::vector<uint32_t> part = parts_of(mesh);
  std::map<uint32_t, double> volume;
  double all = 0;
  for (size_t t = 0; t < mesh.tet.size(); ++t) {
    const uint32_t* n = mesh.tet[t].node;
    const double own = tet_volume(mesh.node[n[0]], mesh.node[n[1]], mesh.node[n[2]], mesh.node[n[3]]);
    volume[part[t]] += own;
    all += own;
  }
  std::erase_if(volume, [&](const auto& each) { return each.second >= smallest_part * all; });
  if (volume.empty()) return;
  double lost = 0;
  for (const auto& [first, own] : volume) lost += own;
  std::vector<Tet> kept;
  for (size_t t = 0; t < mesh.tet.size(); ++t)
    if (!volume.contains(part[t])) kept.push_back(mesh.tet[t]);
  char share[16];
  std::snprintf(share, sizeof share, "%.2g", 100 * lost / all);
  report.push_back(std::to_string(volume.size()) + " parts of the tets dropped (" + share +
                   " % of the volume) that no face joins to the rest; the surface there rides on the nearest tet");
  mesh.tet = std::move(kept);
}

}  // namespace

void check_node_count(size_t nodes) {
  if (nodes < 100 || nodes > max_nodes)
    throw std::runtime_error("--nodes " + std::to_string(nodes) + ": give a number from 100 to " + std::to_string(max_nodes) +
                             ".");
}

TetMesh clean_tets(const std::vector<double>& nodes, const std::vector<int32_t>& tets, const std::string& name,
                   std::vector<std::string>& report) {
  const size_t n = nodes.size() / 3, t = tets.size() / 4;
  TetMesh mesh;
  for (size_t i = 0; i < n; ++i) {
    mesh.node.push_back(Eigen::Vector3d(nodes[3 * i], nodes[3 * i + 1], nodes[3 * i + 2]).cast<float>());
    if (!mesh.node[i].allFinite())
      refuse(name, "node " + std::to_string(i) + " of the tets is not a finite number; make the tets again.");
  }
  size_t turned = 0;
  for (size_t i = 0; i < t; ++i) {
    Tet tet;
    for (int k = 0; k < 4; ++k) {
      const int32_t node = tets[4 * i + k];
      if (node < 0 || static_cast<size_t>(node) >= n)
        refuse(name, "tet " + std::to_string(i) + " names a node that does not exist; make the tets again.");
      tet.node[k] = static_cast<uint32_t>(node);
    }
    const double volume =
        tet_volume(mesh.node[tet.node[0]], mesh.node[tet.node[1]], mesh.node[tet.node[2]], mesh.node[tet.node[3]]);
    if (std::abs(volume) < smallest_volume) continue;
    if (volume < 0) std::swap(tet.node[2], tet.node[3]), ++turned;
    mesh.tet.push_back(tet);
  }
  if (mesh.tet.empty()) refuse(name, "none of its " + std::to_string(t) + " tets has a volume; make the tets again.");
  const size_t flat = t - mesh.tet.size();
  drop_small_parts(mesh, report);
  if (mesh.tet.empty())
    refuse(name, "its tets form loose parts, each with less than 2 % of the volume; make one connected mesh.");
  const size_t unused = drop_unused(mesh);
  if (mesh.node.size() > max_nodes || mesh.tet.size() > max_tets)
    refuse(name, std::to_string(mesh.node.size()) + " nodes and " + std::to_string(mesh.tet.size()) +
                     " tets are more than a tick can compute (" + std::to_string(max_nodes) + " and " +
                     std::to_string(max_tets) + "); use a coarser mesh.");
  if (turned) report.push_back(std::to_string(turned) + " tets were inside out: two of their corners are swapped");
  if (flat) report.push_back(std::to_string(flat) + " tets dropped that have no volume (below 1e-12 m^3)");
  if (unused) report.push_back(std::to_string(unused) + " nodes dropped that no tet uses");
  return mesh;
}

TetMesh import_tets(const std::filesystem::path& file, const Eigen::Affine3d& from_file, std::vector<std::string>& report) {
  std::error_code none;
  if (std::filesystem::is_regular_file(file, none) && std::filesystem::file_size(file, none) > largest_tets_file)
    refuse(file.string(), "it is larger than 512 MiB; give at most " + std::to_string(max_tets) + " tets.");
  const TemporaryFolder folder;
  std::string last;
  const int status =
      run_script(import_tets_script, {file.string(), folder.path.string()}, [&](const std::string& line) { last = line; });
  if (status != 0) refuse(file.string(), last + "; give tets as Gmsh .msh (2.2 or 4.1), Medit .mesh or TetGen .node/.ele.");
  auto nodes = read_array<double>(folder.path / "nodes.f64");
  for (size_t i = 0; i + 2 < nodes.size(); i += 3) {
    Eigen::Map<Eigen::Vector3d> node(&nodes[i]);
    node = from_file * Eigen::Vector3d(node);
  }
  const auto tets = read_array<int32_t>(folder.path / "tets.i32");
  const TetMesh mesh = clean_tets(nodes, tets, file.string(), report);
  report.insert(report.begin(), std::to_string(mesh.node.size()) + " nodes, " + std::to_string(mesh.tet.size()) + " tets read");
  return mesh;
}

}  // namespace crumple

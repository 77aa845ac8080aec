#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "asset/build_constraints.h"
#include "asset/car.h"
#include "asset/make_tets.h"
#include "asset/script.h"
#include "asset/scripts.h"  // generated: the text of the Python scripts

namespace crumple {
namespace {

constexpr double smallest_volume = 1e-12;  // m^3, a tenth of a millimetre cubed: nothing a solver could divide by

[[noreturn]] void refuse(const std::string& name, const std::string& fact) { throw std::runtime_error(name + ": " + fact); }

// Only the nodes that a tet names; returns how many were dropped.
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

}  // namespace

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
  const size_t flat = t - mesh.tet.size(), unused = drop_unused(mesh);
  if (mesh.node.size() > max_nodes || mesh.tet.size() > max_tets)
    refuse(name, std::to_string(mesh.node.size()) + " nodes and " + std::to_string(mesh.tet.size()) +
                     " tets are more than the " + std::to_string(max_nodes) + " and " + std::to_string(max_tets) +
                     " that a tick can carry; use coarser ones.");
  if (turned) report.push_back(std::to_string(turned) + " tets were inside out: two of their corners are swapped");
  if (flat) report.push_back(std::to_string(flat) + " tets dropped that have no volume (below 1e-12 m^3)");
  if (unused) report.push_back(std::to_string(unused) + " nodes dropped that no tet uses");
  return mesh;
}

TetMesh import_tets(const std::filesystem::path& file, const Eigen::Affine3d& from_file, std::vector<std::string>& report) {
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

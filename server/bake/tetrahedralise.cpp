#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>
#include <optional>
#include <stdexcept>

#include "bake/make_tets.h"
#include "bake/script.h"
#include "bake/scripts.h"  // generated: the text of the Python scripts
#include "bake/text_of.h"
#include "car/car.h"

namespace crumple {
namespace {

constexpr double wanted_within = 0.15;
constexpr int most_runs = 8;
// Envelope as a share of the box's diagonal: how far the tets' outside may lie from the drawn surface. The finest is fTetWild's
// default. The widest still looks like the car (it is a few centimetres; the skin keeps every vertex in its place).
constexpr double finest_epsilon = 1e-3, widest_epsilon = 6e-3;
// If more than this share of the nodes is on the outside, edges cannot grow any more: the drawn detail needs the nodes.
constexpr double too_many_outside = 0.62;

struct Run {
  double edge_length;  // share of the box's diagonal
  double epsilon;
  size_t nodes = 0;
  double outside = 0;  // share of the nodes on the outside
};

// Reads progress from fTetWild's log: passes of splitting, collapsing, swapping and smoothing until the worst tet's energy is
// below 10.
class LogReader {
 public:
  LogReader(std::string title, const Progress& progress) : title_(std::move(title)), progress_(progress) {}
  void operator()(const std::string& line) {
    if (!line.empty()) last_ = line;
    if (line.find("preprocessing") != std::string::npos) stage_ = "inserting the surface";
    if (const size_t at = line.find("pass "); at != std::string::npos)
      stage_ = "pass " + std::to_string(std::atoi(&line[at + 5]));
    if (line.starts_with("max_energy = ")) quality_ = ", worst tet " + line.substr(13) + " (goal 10)";
    if (line.find("winding number") != std::string::npos) stage_ = "telling inside from outside";
    const auto seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    if (progress_) progress_(title_ + ": " + stage_ + quality_ + ", " + text_of(seconds, "%.0f") + " s");
  }
  const std::string& last() const { return last_; }

 private:
  std::string title_;
  const Progress& progress_;
  std::string stage_ = "simplifying the surface", quality_, last_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

double share_outside(const TetMesh& mesh) {
  std::vector<uint8_t> outside(mesh.node.size(), 0);
  for (const Triangle& triangle : boundary(mesh))
    for (uint32_t node : triangle) outside[node] = 1;
  return std::accumulate(outside.begin(), outside.end(), 0.0) / static_cast<double>(outside.size());
}

TetMesh run_once(const ImportedSurface& input, Run& run, const std::string& name, const std::string& title,
                 const Progress& progress, std::vector<std::string>& report) {
  const TemporaryFolder folder;
  std::vector<double> vertices;
  for (const Vec3& vertex : input.surface.vertex)
    for (int k = 0; k < 3; ++k) vertices.push_back(vertex[k]);
  std::vector<int32_t> triangles;
  for (const Triangle& triangle : input.surface.triangle)
    for (uint32_t vertex : triangle) triangles.push_back(static_cast<int32_t>(vertex));
  write_array<double>(folder.path / "vertices.f64", vertices);
  write_array<int32_t>(folder.path / "triangles.i32", triangles);
  LogReader log(title, progress);
  const int status =
      run_script(tetrahedralise_script, {folder.path.string(), text_of(run.edge_length, "%.9g"), text_of(run.epsilon, "%.9g")},
                 [&](const std::string& line) { log(line); });
  if (status != 0)
    throw std::runtime_error(name + ": fTetWild could not make tets of it (exit status " + std::to_string(status) +
                             ", last line of its output: " + log.last() +
                             "); repair the surface, or give your own tets with --tets FILE.");
  const auto nodes = read_array<double>(folder.path / "nodes.f64");
  const auto tets = read_array<int32_t>(folder.path / "tets.i32");
  if (tets.empty())
    throw std::runtime_error(name + ": fTetWild found no inside; close the surface's largest holes or turn its faces outward.");
  TetMesh mesh = clean_tets(nodes, tets, name, report);
  run.nodes = mesh.node.size();
  run.outside = share_outside(mesh);
  return mesh;
}

// Edge length for a body that fills 0.45 of its box: 1.25 cube roots of the volume per node (measured on a sedan's hull).
Run first_guess(const ImportedSurface& input, size_t nodes) {
  Eigen::AlignedBox3d box;
  for (const Vec3& vertex : input.surface.vertex) box.extend(vertex.cast<double>());
  const double edge = 1.25 * std::cbrt(0.45 * box.volume() / static_cast<double>(nodes));
  // Open sheets would become thin double walls if the envelope were not wide enough to close over them.
  return {edge / box.diagonal().norm(), input.open_edges ? 3 * finest_epsilon : finest_epsilon};
}

// The next run, from earlier runs with the same envelope: nodes ~ edge^-k, with k from the two runs nearest to the goal, at
// first 2.5.
Run next_guess(const std::vector<Run>& runs, size_t nodes) {
  const auto error = [&](const Run& run) { return std::log(static_cast<double>(run.nodes) / static_cast<double>(nodes)); };
  Run next = runs.back();
  if (error(next) > 0 && next.outside > too_many_outside && next.epsilon < widest_epsilon) {
    next.epsilon = std::min(widest_epsilon, next.epsilon * std::clamp(std::exp(error(next)), 1.3, 2.5));
    return next;
  }
  std::vector<Run> same;
  for (const Run& run : runs)
    if (run.epsilon == next.epsilon) same.push_back(run);
  std::sort(same.begin(), same.end(), [&](const Run& a, const Run& b) { return std::abs(error(a)) < std::abs(error(b)); });
  double slope = 2.5;
  if (same.size() > 1 && same[0].edge_length != same[1].edge_length)
    slope = std::clamp(-(error(same[0]) - error(same[1])) / std::log(same[0].edge_length / same[1].edge_length), 0.7, 4.0);
  next = same[0];
  next.edge_length = std::clamp(next.edge_length * std::exp(error(next) / slope), 0.002, 0.5);
  return next;
}

}  // namespace

TetMesh tetrahedralise(const ImportedSurface& input, size_t nodes, const std::string& name, const Progress& progress,
                       std::vector<std::string>& report) {
  check_node_count(nodes);
  std::vector<Run> runs;
  Run run = first_guess(input, nodes);
  for (int count = 1; count <= most_runs; ++count) {
    std::vector<std::string> cleaning;
    const TetMesh mesh = run_once(input, run, name, "tetrahedra, run " + std::to_string(count), progress, cleaning);
    runs.push_back(run);
    const double error = static_cast<double>(run.nodes) / static_cast<double>(nodes) - 1;
    if (std::abs(error) > wanted_within) {
      run = next_guess(runs, nodes);
      continue;
    }
    report.push_back("fTetWild: " + std::to_string(run.nodes) + " nodes, " + std::to_string(mesh.tet.size()) + " tets (" +
                     text_of(100 * error, "%+.0f") + " % of the " + std::to_string(nodes) + " wanted) in " +
                     std::to_string(count) + (count == 1 ? " run" : " runs") + ", edge length " +
                     text_of(run.edge_length, "%.3g") + ", envelope " + text_of(run.epsilon, "%.2g") + " of the diagonal");
    report.insert(report.end(), cleaning.begin(), cleaning.end());
    return mesh;
  }
  const auto [fewest, most] = std::minmax_element(runs.begin(), runs.end(), [](auto& a, auto& b) { return a.nodes < b.nodes; });
  throw std::runtime_error(name + ": " + std::to_string(most_runs) + " runs of fTetWild gave " + std::to_string(fewest->nodes) +
                           " to " + std::to_string(most->nodes) + " nodes, never within 15 % of " + std::to_string(nodes) +
                           "; ask for another --nodes, or simplify the surface.");
}

}  // namespace crumple

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "bake/choose_solid_nodes.h"
#include "bake/fill_surface.h"
#include "bake/finish_tets.h"
#include "bake/make_tets.h"
#include "bake/stuff.h"
#include "bake/text_of.h"
#include "car/car.h"

namespace crumple {
namespace {

constexpr double wanted_within = 0.05, good_enough = 0.03;
constexpr int most_runs = 12, most_repairs = 3;
// Voxels in a spacing: a finer lattice would follow the voxels instead of the surface. Bounds a lattice to 4 million nodes.
constexpr double finest_spacing = 1.5;
// How far a drawn vertex may stick out of the tets before the lattice's node nearest to it is held, and all is cut again: the
// distance that a skin may ride apart, but between two shares of the spacing.
constexpr double sticks_out = 0.07, least_share = 0.3, most_share = 0.4;  // m

struct Run {
  double spacing;
  FineTets tets;
  size_t joined;
  double farthest_joined;  // m
};

// So that no rounding of a library's powers and logarithms reaches the tets.
double to_tenth_of_mm(double spacing) { return std::round(1e4 * spacing) / 1e4; }

double error_of(size_t count, size_t wanted) { return std::log(double(count) / double(wanted)); }

class Stuffing {
 public:
  Stuffing(const FilledSurface& filled, const Surface& surface, size_t wanted, const Progress& progress)
      : filled_(filled), wanted_(wanted), progress_(progress), finest_(finest_spacing * filled.voxels.size) {
    for (const Vec3& vertex : surface.vertex) box_.extend(vertex.cast<double>());
  }

  Run run(double spacing) {
    if (progress_)
      progress_("lattice: run " + std::to_string(tried_.size() + 1) + " of at most " + std::to_string(most_runs) +
                ", spacing " + text_of(1000 * spacing, "%.0f") + " mm");
    const Lattice lattice = lattice_around(box_, spacing);
    SolidNodes chosen = choose_solid_nodes(filled_, lattice, held_);
    Run out{spacing, stuff(lattice, std::move(chosen.solid)), chosen.joined, chosen.farthest};
    tried_.push_back({spacing, error_of(out.tets.node.size(), wanted_)});
    return out;
  }

  // The run with the node count nearest to the one wanted.
  Run search(double spacing) {
    tried_.clear();
    Run best = run(std::max(to_tenth_of_mm(spacing), finest_));
    while (std::abs(error_of(best.tets.node.size(), wanted_)) > good_enough && tried_.size() < most_runs) {
      const double next_spacing = std::max(finest_, to_tenth_of_mm(guess()));
      if (std::any_of(tried_.begin(), tried_.end(), [&](const Tried& tried) { return tried.spacing == next_spacing; })) break;
      Run next = run(next_spacing);
      if (std::abs(tried_.back().error) < std::abs(error_of(best.tets.node.size(), wanted_))) best = std::move(next);
    }
    return best;
  }

  void hold(const std::vector<Eigen::Vector3d>& points) { held_.insert(held_.end(), points.begin(), points.end()); }
  double finest() const { return finest_; }
  size_t runs() const { return tried_.size(); }

 private:
  struct Tried {
    double spacing, error;
  };

  // nodes ~ spacing^-k between the two neighbouring runs on either side of the goal; or from the nearest run, with k of the two
  // nearest, 2.5 at first: between a sheet and a solid. The count jumps where a part becomes thin, so it may miss the goal
  // between neighbours too: then beside the best run, farther each time.
  double guess() const {
    constexpr double same = 0.002, step = 0.003;  // of the spacing
    std::vector<Tried> by_error = tried_, by_spacing = tried_;
    std::sort(by_error.begin(), by_error.end(), [](auto& a, auto& b) { return std::abs(a.error) < std::abs(b.error); });
    std::sort(by_spacing.begin(), by_spacing.end(), [](auto& a, auto& b) { return a.spacing < b.spacing; });
    const Tried best = by_error[0];
    double nearest = HUGE_VAL, out = 0;
    for (size_t i = 1; i < by_spacing.size(); ++i) {
      const Tried &a = by_spacing[i - 1], &b = by_spacing[i];
      const double apart = std::abs(a.error) + std::abs(b.error);
      if ((a.error > 0) == (b.error > 0) || b.spacing < (1 + same) * a.spacing || apart >= nearest) continue;
      nearest = apart;
      out = a.spacing * std::pow(b.spacing / a.spacing, std::clamp(std::abs(a.error) / apart, 0.1, 0.9));
    }
    if (out > 0) return out;
    const bool all_on_one_side = by_error.size() == 1 || std::all_of(tried_.begin(), tried_.end(), [&](const Tried& tried) {
                                   return (tried.error > 0) == (best.error > 0);
                                 });
    if (!all_on_one_side) return best.spacing * (1 + (best.error > 0 ? step : -step) * double(tried_.size()));
    double k = 2.5;
    if (by_error.size() > 1)
      k = std::clamp(-(best.error - by_error[1].error) / std::log(best.spacing / by_error[1].spacing), 1.2, 4.0);
    return best.spacing * std::exp(best.error / k);
  }

  const FilledSurface& filled_;
  size_t wanted_;
  const Progress& progress_;
  double finest_;  // m
  Eigen::AlignedBox3d box_;
  std::vector<Eigen::Vector3d> held_;
  std::vector<Tried> tried_;
};

}  // namespace

TetMesh fill_with_tets(const ImportedSurface& input, size_t nodes, const std::string& name, const Progress& progress,
                       std::vector<std::string>& report) {
  check_node_count(nodes);
  const auto tell = [&](const std::string& what) {
    if (progress) progress(what);
  };
  const Surface& surface = input.surface;
  tell("lattice: filling the surface");
  const FilledSurface filled = fill_surface(surface.vertex, surface.triangle, name);
  Stuffing stuffing(filled, surface, nodes, progress);
  Run best = stuffing.search(1.2 * std::cbrt(2 * filled.volume / double(nodes)));
  const auto off = [&](const Run& run) { return std::abs(double(run.tets.node.size()) / double(nodes) - 1); };
  if (off(best) > wanted_within) {
    const std::string got = std::to_string(best.tets.node.size());
    const bool finest = best.spacing == stuffing.finest();
    throw std::runtime_error(name + ": the lattice gave " + got + " nodes, not within 5 % of the " + std::to_string(nodes) +
                             " wanted" + (finest ? ", at its finest spacing" : "") + "; ask for --nodes " + got + ".");
  }

  const DrawnSurface drawn = drawn_surface(surface.vertex, surface.triangle);
  const auto finish = [&](Run& run) {
    tell("lattice: fitting " + std::to_string(run.tets.node.size()) + " nodes to the surface");
    finish_tets(drawn, filled, run.spacing, run.tets);
    return find_outliers(drawn, run.tets, std::clamp(sticks_out, least_share * run.spacing, most_share * run.spacing),
                         run.spacing);
  };
  size_t runs = stuffing.runs();
  Outliers outliers = finish(best);
  Outliers last = outliers;
  for (int repair = 0; repair < most_repairs && !last.point.empty(); ++repair) {
    stuffing.hold(last.point);
    Run next = stuffing.search(best.spacing);
    runs += stuffing.runs();
    last = finish(next);
    if (off(next) <= wanted_within && last.farthest < outliers.farthest) best = std::move(next), outliers = last;
  }

  std::vector<double> positions;
  for (const Eigen::Vector3d& node : best.tets.node) positions.insert(positions.end(), node.data(), node.data() + 3);
  std::vector<int32_t> corners;
  for (const Tet& tet : best.tets.tet) corners.insert(corners.end(), tet.node, tet.node + 4);
  TetMesh out = clean_tets(positions, corners, name, report);
  const AngleRange angles = dihedral_angles(out);
  report.push_back("lattice: " + std::to_string(out.node.size()) + " nodes, " + std::to_string(out.tet.size()) + " tets (" +
                   text_of(100 * (double(out.node.size()) / double(nodes) - 1), "%+.1f") + " % of the " +
                   std::to_string(nodes) + " wanted) in " + std::to_string(runs) + (runs == 1 ? " run" : " runs") +
                   ", spacing " + text_of(1000 * best.spacing, "%.0f") + " mm, dihedral angles " +
                   text_of(angles.least, "%.1f") + " to " + text_of(angles.most, "%.0f") + " degrees");
  report.push_back(filled.sealed
                       ? "solid: " + text_of(filled.volume, "%.2f") + " m^3; the surface closes off " +
                             text_of(100 * filled.closed_share, "%.0f") + " % of it, the rest is sealed"
                       : "solid: " + text_of(filled.volume, "%.2f") + " m^3; the surface holds water, nothing is sealed");
  if (best.joined)
    report.push_back(std::to_string(best.joined) + (best.joined == 1 ? " piece hangs" : " pieces hang") +
                     " apart: joined to the rest over at most " + text_of(1000 * best.farthest_joined, "%.0f") + " mm");
  return out;
}

}  // namespace crumple

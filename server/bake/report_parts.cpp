#include "bake/report_parts.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "bake/text_of.h"

namespace crumple {
namespace {

constexpr size_t most_named = 3;
constexpr double thin = 0.04;  // m

// The part's shortest extent along the axes of its own spread.
double thickness(std::span<const Vec3> vertex, const std::vector<uint32_t>& members) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (uint32_t v : members) mean += vertex[v].cast<double>() / double(members.size());
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (uint32_t v : members) {
    const Eigen::Vector3d d = vertex[v].cast<double>() - mean;
    spread += d * d.transpose();
  }
  const Eigen::Vector3d axis = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(spread).eigenvectors().col(0);
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (uint32_t v : members) {
    const double at = axis.dot(vertex[v].cast<double>());
    low = std::min(low, at);
    high = std::max(high, at);
  }
  return high - low;
}

}  // namespace

std::vector<std::string> report_far_parts(std::span<const Vec3> vertex, std::span<const uint32_t> triangle,
                                          std::span<const double> distance, const std::vector<NamedPart>& named) {
  std::map<std::string, std::vector<uint32_t>> members;
  for (size_t i = 0; i < named.size(); ++i) {
    const size_t end = i + 1 < named.size() ? named[i + 1].first : triangle.size() / 3;
    auto& list = members[named[i].name];
    list.insert(list.end(), triangle.begin() + 3 * std::ptrdiff_t(named[i].first), triangle.begin() + 3 * std::ptrdiff_t(end));
  }
  struct Far {
    double distance;
    std::string sentence;
  };
  std::vector<Far> far;
  for (auto& [name, list] : members) {
    std::sort(list.begin(), list.end());
    list.erase(std::unique(list.begin(), list.end()), list.end());
    const auto worst =
        std::max_element(list.begin(), list.end(), [&](uint32_t a, uint32_t b) { return distance[a] < distance[b]; });
    if (worst == list.end() || distance[*worst] <= far_from_tets) continue;
    const auto beyond = std::count_if(list.begin(), list.end(), [&](uint32_t v) { return distance[v] > far_from_tets; });
    const double thick = thickness(vertex, list);
    const Vec3& at = vertex[*worst];
    far.push_back({distance[*worst],
                   "warning: " + name + ": " + (thick < thin ? text_of(1000 * thick, "%.0f") + " mm thin, " : std::string()) +
                       "rides on tets up to " + text_of(1000 * distance[*worst], "%.0f") + " mm away, farthest at x " +
                       text_of(at.x(), "%.2f") + ", y " + text_of(at.y(), "%.2f") + ", z " + text_of(at.z(), "%.2f") + " (" +
                       std::to_string(beyond) + " of " + std::to_string(list.size()) + " vertices are beyond " +
                       text_of(1000 * far_from_tets) + " mm)"});
  }
  std::stable_sort(far.begin(), far.end(), [](const Far& a, const Far& b) { return a.distance > b.distance; });
  std::vector<std::string> report;
  for (const Far& part : far) report.push_back(part.sentence);
  if (report.size() > most_named) {
    report.resize(most_named);
    const size_t more = far.size() - most_named;
    report.back() +=
        (more == 1 ? std::string("; so does 1 more part") : "; so do " + std::to_string(more) + " more parts") + ", less far";
  }
  return report;
}

}  // namespace crumple

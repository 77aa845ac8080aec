// A word in a name decides the kind. Wheels must also be round and
// stand on the ground, which keeps steering wheels and spare wheels out.
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <regex>
#include <set>
#include <stdexcept>

#include "bake/names.h"
#include "bake/parts.h"
#include "bake/parts_text.h"
#include "bake/text_of.h"

namespace crumple {
namespace {

using schema::PartKind;
using Box = Eigen::AlignedBox3d;

// Of a disc: how much longer than high it may be (a stretched model has oval wheels, so names allow more), how far its corners
// may stick out (a square's by 1.41), and how wide it is against its radius.
constexpr double oval = 1.12, oval_by_name = 1.3, corners = 1.08, widest = 1.8, thinnest = 0.15;
constexpr double least_length = 0.04, most_length = 0.25;  // of a wheel's radius, as a share of the car's length
constexpr double lifted = 0.5;                             // share of its radius that a wheel may be above the ground
constexpr double like_its_twin = 0.2;  // share of its radius by which a wheel may differ from the one across
// Some files blend all materials that have a texture. Glass lies above this share of the car's height, but for headlamps.
constexpr double lowest_pane = 0.25;
constexpr int most_reasons = 4;
constexpr size_t most_panels = 64;

// The kind that a name says, or body.
PartKind kind_of(const std::string& name) {
  static const std::regex interior("interior|seats?|steering(wheel)?|dash(board)?|upholstery"),
      light("(head|tail|fog|brake|turn|side|rear|front|back|stop|signal|reverse)?(lights?|lamps?)|lens(es)?|headl|taill"),
      glass("glass(es)?|windows?|windshield|windscreen"), wheel("(front|rear|back)?(wheels?|tyres?|tires?|rims?)[fr]?[lr]?"),
      not_wheel("arch(es)?|wells?|house|cover|base|guards?|nuts?|spare"),
      panel("(front|rear|left|right)?(doors?|hoods?|bonnets?|trunk(lid)?s?|bootlids?|tailgates?|fenders?|bumpers?)"),
      not_panel("handles?|knobs?|locks?|frames?|steps?|hinges?|mirrors?|plates?");
  const std::vector<std::string> words = words_of(name);
  if (has_word(words, interior)) return PartKind::interior;
  if (has_word(words, light)) return PartKind::light;
  if (has_word(words, glass)) return PartKind::glass;
  if (has_word(words, wheel) && !has_word(words, not_wheel)) return PartKind::wheel;
  if (has_word(words, panel) && !has_word(words, not_panel)) return PartKind::panel;
  return PartKind::body;
}

// A pattern that fits only this name.
std::string pattern_of(const std::string& name) {
  std::string out;
  for (char c : name) out += (std::string("*?[]\\").find(c) != std::string::npos ? "\\" : "") + std::string(1, c);
  return out;
}

// ---- wheels --------------------------------------------------------------------------------------------------------------

struct Wheel {
  Box box;
  std::vector<const Piece*> pieces;
  size_t axle = 0;  // counted from the front, from 1 on
  Eigen::Vector3d hub() const { return box.center(); }
  double radius() const { return std::max(box.sizes().x(), box.sizes().z()) / 2; }
};

class WheelFinder {
 public:
  WheelFinder(const ImportedSurface& input, const std::vector<Piece>& pieces) : input_(input), pieces_(pieces) {
    for (const Vec3& vertex : input.surface.vertex) car_.extend(vertex.cast<double>());
    for (const Piece& piece : pieces) {
      Box& box = boxes_.emplace_back();
      for (uint32_t t : piece.triangle)
        for (uint32_t v : input.surface.triangle[t]) box.extend(at(v));
    }
  }

  // Pieces of these named parts whose boxes overlap are one wheel: a rim, a tyre, and treads.
  std::vector<Wheel> by_name(const std::vector<uint8_t>& is_wheel) const {
    std::vector<Wheel> wheels;
    for (size_t i = 0; i < pieces_.size(); ++i) {
      if (!is_wheel[pieces_[i].named]) continue;
      Wheel all{boxes_[i], {&pieces_[i]}, 0};
      for (auto at = wheels.begin(); at != wheels.end();) {
        if (!all.box.intersects(at->box)) {
          ++at;
          continue;
        }
        all.box.extend(at->box);
        all.pieces.insert(all.pieces.end(), at->pieces.begin(), at->pieces.end());
        wheels.erase(at);
        at = wheels.begin();  // the larger box may reach others
      }
      wheels.push_back(std::move(all));
    }
    std::erase_if(wheels, [&](const Wheel& wheel) { return !is_round(wheel, oval_by_name) || !stands(wheel); });
    for (Wheel& wheel : wheels) widen(wheel);
    return wheels;
  }

  // Of the pieces that are round and stand on the ground, those with a twin across.
  std::vector<Wheel> by_shape() const {
    std::vector<Wheel> round;
    for (size_t i = 0; i < pieces_.size(); ++i) {
      Wheel wheel{boxes_[i], {&pieces_[i]}, 0};
      if (stands(wheel) && is_round(wheel, oval)) round.push_back(std::move(wheel));
    }
    std::stable_sort(round.begin(), round.end(), [](const Wheel& a, const Wheel& b) { return a.radius() > b.radius(); });
    std::vector<Wheel> wheels;  // without the smaller discs in them
    for (Wheel& each : round)
      if (std::none_of(wheels.begin(), wheels.end(), [&](const Wheel& wheel) { return wheel.box.intersects(each.box); }))
        wheels.push_back(std::move(each));
    const auto twins = [](const Wheel& a, const Wheel& b) {
      const Eigen::Vector3d across = (a.hub() - b.hub().cwiseProduct(Eigen::Vector3d(1, -1, 1))) / a.radius();
      return across.cwiseAbs().maxCoeff() < like_its_twin && std::abs(a.radius() / b.radius() - 1) < like_its_twin;
    };
    std::vector<Wheel> paired;
    for (const Wheel& each : wheels)
      if (std::abs(each.hub().y()) > each.radius() &&
          std::any_of(wheels.begin(), wheels.end(), [&](const Wheel& other) { return &other != &each && twins(each, other); }))
        paired.push_back(each);
    for (Wheel& wheel : paired) widen(wheel);
    return paired;
  }

 private:
  Eigen::Vector3d at(uint32_t vertex) const { return input_.surface.vertex[vertex].cast<double>(); }

  bool stands(const Wheel& wheel) const {
    const double length = car_.sizes().x(), radius = wheel.radius();
    return radius > least_length * length && radius < most_length * length &&
           wheel.box.min().z() - car_.min().z() < lifted * radius;
  }

  // A disc about y: in each of eight directions its outline is about as far from the hub.
  bool is_round(const Wheel& wheel, double most_oval) const {
    const Eigen::Vector3d size = wheel.box.sizes(), hub = wheel.hub();
    const double radius = wheel.radius();
    if (size.x() > most_oval * size.z() || size.z() > most_oval * size.x()) return false;
    if (size.y() > widest * radius || size.y() < thinnest * radius) return false;
    double farthest[8] = {};
    for (const Piece* piece : wheel.pieces)
      for (uint32_t t : piece->triangle)
        for (uint32_t v : input_.surface.triangle[t]) {
          const Eigen::Vector3d p = at(v) - hub;
          const auto eighth = static_cast<size_t>((std::atan2(p.z(), p.x()) / std::numbers::pi + 1) * 4) % 8;
          farthest[eighth] = std::max(farthest[eighth], std::hypot(p.x(), p.z()));
        }
    return *std::max_element(farthest, farthest + 8) <= corners * radius &&
           *std::min_element(farthest, farthest + 8) >= radius / most_oval / corners;
  }

  // Takes in the sides of the rim and other pieces within the circle.
  void widen(Wheel& wheel) const {
    const Eigen::Vector3d hub = wheel.hub();
    const double radius = wheel.radius(), width = wheel.box.sizes().y();
    const Box reach(wheel.box.min() - Eigen::Vector3d(0, width / 4, 0), wheel.box.max() + Eigen::Vector3d(0, width / 4, 0));
    for (size_t i = 0; i < pieces_.size(); ++i) {
      if (!reach.contains(boxes_[i])) continue;
      const bool inside = std::all_of(pieces_[i].triangle.begin(), pieces_[i].triangle.end(), [&](uint32_t t) {
        const Triangle& corner = input_.surface.triangle[t];
        return std::all_of(corner.begin(), corner.end(),
                           [&](uint32_t v) { return std::hypot(at(v).x() - hub.x(), at(v).z() - hub.z()) <= radius; });
      });
      if (inside) wheel.box.extend(boxes_[i]);
    }
  }

  const ImportedSurface& input_;
  const std::vector<Piece>& pieces_;
  std::vector<Box> boxes_;  // of the pieces
  Box car_;
};

// Sorts wheels from the front to the rear, and from left to right, and names them: "wheel front left"; of three axles and more
// "wheel 2 left".
std::vector<std::string> name_wheels(std::vector<Wheel>& wheels) {
  std::sort(wheels.begin(), wheels.end(), [](const Wheel& a, const Wheel& b) { return a.hub().x() > b.hub().x(); });
  size_t axles = 0;
  for (size_t i = 0; i < wheels.size(); ++i) {
    if (i == 0 || wheels[i - 1].hub().x() - wheels[i].hub().x() > wheels[i].radius()) ++axles;
    wheels[i].axle = axles;
  }
  std::sort(wheels.begin(), wheels.end(),
            [](const Wheel& a, const Wheel& b) { return std::pair(a.axle, -a.hub().y()) < std::pair(b.axle, -b.hub().y()); });
  std::vector<std::string> names;
  std::map<std::string, int> seen;
  for (const Wheel& wheel : wheels) {
    const std::string which = axles == 1        ? ""
                              : axles > 2       ? " " + std::to_string(wheel.axle)
                              : wheel.axle == 1 ? " front"
                                                : " rear";
    const double y = wheel.hub().y();
    std::string name = "wheel" + which + (std::abs(y) < wheel.box.sizes().y() / 2 ? "" : y > 0 ? " left" : " right");
    if (const int before = seen[name]++) name += " " + std::to_string(before + 1);
    names.push_back(name);
  }
  return names;
}

// ---- the proposal --------------------------------------------------------------------------------------------------------

std::string listed(const std::vector<std::string>& names) {
  std::string out;
  for (size_t i = 0; i < std::min<size_t>(names.size(), most_reasons); ++i) out += (i ? ", '" : "'") + names[i] + "'";
  if (names.size() > most_reasons) out += " and " + std::to_string(names.size() - most_reasons) + " more";
  return out;
}

// How high above the ground each material begins, as a share of the car's height.
std::map<std::string, double> heights_of(const ImportedSurface& input) {
  Box car;
  for (const Vec3& vertex : input.surface.vertex) car.extend(vertex.cast<double>());
  std::map<std::string, double> out;
  for (size_t i = 0; i < input.named.size(); ++i) {
    const size_t end = i + 1 < input.named.size() ? input.named[i + 1].first : input.surface.triangle.size();
    if (input.named[i].names.empty()) continue;
    double& height = out.try_emplace(input.named[i].names[0], 1.0).first->second;
    for (size_t t = input.named[i].first; t < end; ++t)
      for (uint32_t v : input.surface.triangle[t])
        height = std::min(height, (double(input.surface.vertex[v].z()) - car.min().z()) / car.sizes().z());
  }
  return out;
}

// What no name can tell apart: names that all parts of the file have.
std::set<std::string> common_names(const std::vector<NamedPart>& named) {
  std::map<std::string, size_t> count;
  for (const NamedPart& each : named)
    for (const std::string& name : std::set<std::string>(each.names.begin(), each.names.end())) ++count[name];
  std::set<std::string> out;
  for (const auto& [name, times] : count)
    if (times == named.size()) out.insert(name);
  return out;
}

}  // namespace

PartsText propose_parts(const ImportedSurface& input, std::vector<std::string>& report) {
  schema::PartEntriesT entries;
  const std::set<std::string> common = common_names(input.named);
  const std::map<std::string, double> heights = heights_of(input);
  std::map<PartKind, std::vector<std::string>> said;  // names, by kind
  std::vector<uint8_t> is_wheel(std::max<size_t>(1, input.named.size()), 0);
  std::vector<std::string> clear;
  const auto add = [](std::vector<std::string>& list, const std::string& name) {
    if (std::find(list.begin(), list.end(), name) == list.end()) list.push_back(name);
  };
  for (size_t i = 0; i < input.named.size(); ++i) {
    const NamedPart& named = input.named[i];
    const size_t end = i + 1 < input.named.size() ? input.named[i + 1].first : input.surface.triangle.size();
    if (named.first == end) continue;
    for (size_t k = 0; k < named.names.size(); ++k) {
      if (common.contains(named.names[k])) continue;
      const PartKind kind = kind_of(named.names[k]);
      if (kind != PartKind::body) add(said[kind], named.names[k]);
      is_wheel[i] |= kind == PartKind::wheel;
      if (k > 0 || kind != PartKind::body) continue;
      if (named.transparent || (named.blended && heights.at(named.names[k]) > lowest_pane)) add(clear, named.names[k]);
    }
  }
  const auto enter = [&](const char* name, PartKind kind, const std::vector<std::string>& names) {
    auto entry = std::make_unique<schema::PartEntryT>();
    entry->name = name;
    entry->kind = kind;
    for (const std::string& each : names) entry->source.push_back(pattern_of(each));
    entries.parts.push_back(std::move(entry));
  };
  // Each panel is a part, because it may come off by itself. What they hold, such as glass, is entered after them.
  std::vector<std::string>& panels = said[PartKind::panel];
  panels.resize(std::min(panels.size(), most_panels));
  for (const std::string& name : panels)
    if (is_part_name(name)) enter(name.c_str(), PartKind::panel, {name});
  if (!panels.empty()) report.push_back("parts: panels by name: " + listed(panels));
  std::vector<std::string> glass = said[PartKind::glass];
  glass.insert(glass.end(), clear.begin(), clear.end());
  std::string why;
  if (!said[PartKind::glass].empty()) why = " by name: " + listed(said[PartKind::glass]);
  if (!clear.empty()) why += std::string(why.empty() ? "" : ";") + " by transparent material: " + listed(clear);
  if (!glass.empty()) enter("glass", PartKind::glass, glass), report.push_back("parts: glass" + why);
  for (const PartKind kind : {PartKind::interior, PartKind::light}) {
    if (said[kind].empty()) continue;
    const char* name = kind == PartKind::light ? "lights" : "interior";
    enter(name, kind, said[kind]);
    report.push_back(std::string("parts: ") + name + " by name: " + listed(said[kind]));
  }

  const std::vector<Piece> pieces = find_pieces(input);
  const WheelFinder finder(input, pieces);
  std::vector<Wheel> wheels = finder.by_name(is_wheel);
  const bool named = wheels.size() > 1;
  if (!named) wheels = finder.by_shape();
  const std::vector<std::string> names = name_wheels(wheels);
  for (size_t i = 0; i < wheels.size(); ++i) {
    enter(names[i].c_str(), PartKind::wheel, {});
    schema::PartEntryT& entry = *entries.parts.back();
    const Eigen::Vector3f hub = wheels[i].hub().cast<float>();
    entry.position = std::make_unique<schema::Vec3>(hub.x(), hub.y(), hub.z());
    entry.radius = static_cast<float>(wheels[i].radius());
    entry.width = static_cast<float>(wheels[i].box.sizes().y());
  }
  if (wheels.empty())
    report.push_back("parts: no wheels, because no loose part is round and stands on the ground, with one like it across");
  else
    report.push_back("parts: " + std::to_string(wheels.size()) + " wheels by " +
                     (named ? "name: " + listed(said[PartKind::wheel]) : "shape") + ", " +
                     text_of(wheels.front().radius(), "%.2f") + " m radius");
  return {"the proposed parts", write_parts(entries)};
}

}  // namespace crumple

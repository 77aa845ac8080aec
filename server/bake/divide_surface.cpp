#include <fnmatch.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>

#include "bake/parts.h"
#include "bake/parts_text.h"
#include "bake/text_of.h"

namespace crumple {
namespace {

using schema::PartKind;

constexpr size_t names_shown = 8;
// A piece lies inside a wheel's cylinder if it sticks out by no more than this: a person rounds numbers.
constexpr double slack_share = 0.02, slack = 0.002;  // of radius and width; m

struct Frame {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Quaterniond orientation = Eigen::Quaterniond::Identity();
};

class Divider {
 public:
  Divider(const ImportedSurface& input, const PartsText& text, const std::string& name)
      : input_(input), text_(text), name_(name), named_of_(input.surface.triangle.size(), 0) {
    for (size_t i = 0; i < input.named.size(); ++i)
      std::fill(named_of_.begin() + std::ptrdiff_t(input.named[i].first), named_of_.end(), i);
    for (const Vec3& vertex : input.surface.vertex) box_.extend(vertex.cast<double>());
    out_.part.push_back({.name = "body"});
    out_.of_triangle.assign(input.surface.triangle.size(), 0);
  }

  void add(const schema::PartEntryT& entry) {
    where_ = text_.source + ": part \"" + entry.name + "\" ";
    if (!is_part_name(entry.name)) refuse("needs a name of 1 to 64 printable ASCII characters.");
    if (entry.kind == PartKind::wheel) return add_wheel(entry);
    if (entry.kind == PartKind::point) return add_point(entry);
    if (entry.source.empty()) refuse("needs a source: patterns of names in the file, such as [\"*glass*\"].");
    if (entry.position || entry.orientation || entry.radius != 0 || entry.width != 0)
      refuse("has a position, an orientation or a size, which only wheels and points have; leave it out.");
    const uint8_t part = known(entry);
    for (uint32_t t : fitting(entry)) out_.of_triangle[t] = part;
  }

  // Leaves out parts whose triangles later entries took.
  Division finish() {
    std::vector<Box> boxes(out_.part.size());
    for (size_t t = 0; t < out_.of_triangle.size(); ++t)
      for (uint32_t vertex : input_.surface.triangle[t])
        boxes[out_.of_triangle[t]].extend(input_.surface.vertex[vertex].cast<double>());
    Division out;
    std::vector<uint8_t> place_of(out_.part.size(), 0);
    for (size_t i = 0; i < out_.part.size(); ++i) {
      Part& part = out_.part[i];
      const bool framed = part.kind == PartKind::wheel || part.kind == PartKind::point;
      if (i > 0 && part.kind != PartKind::point && boxes[i].isEmpty()) continue;
      if (!framed && !boxes[i].isEmpty()) place(part, {boxes[i].center()});
      place_of[i] = static_cast<uint8_t>(out.part.size());
      out.part.push_back(std::move(part));
    }
    if (out.part.size() == 1) return {};
    for (uint8_t part : out_.of_triangle) out.of_triangle.push_back(place_of[part]);
    return out;
  }

 private:
  using Box = Eigen::AlignedBox3d;

  [[noreturn]] void refuse(const std::string& fact) const { throw std::runtime_error(where_ + fact); }

  static void place(Part& part, const Frame& frame) {
    for (int k = 0; k < 3; ++k) part.position[size_t(k)] = static_cast<float>(frame.position[k]);
    const Eigen::Quaternionf q = frame.orientation.cast<float>();
    part.orientation = {q.x(), q.y(), q.z(), q.w()};
  }

  uint8_t known(const schema::PartEntryT& entry) {
    const auto found =
        std::find_if(out_.part.begin(), out_.part.end(), [&](const Part& part) { return part.name == entry.name; });
    if (found == out_.part.end()) return make(entry);
    if (found->kind != entry.kind) refuse("is of two kinds; give one of them another name.");
    return static_cast<uint8_t>(found - out_.part.begin());
  }

  uint8_t make(const schema::PartEntryT& entry) {
    for (const Part& part : out_.part)
      if (part.name == entry.name) refuse("is there twice; give one of them another name.");
    if (out_.part.size() == max_parts)
      refuse("is one more than the 255 parts that a car may have, the body among them; use fewer.");
    out_.part.push_back({.name = entry.name, .kind = entry.kind});
    return static_cast<uint8_t>(out_.part.size() - 1);
  }

  // The frame of a wheel or a point.
  Frame frame_of(const schema::PartEntryT& entry) const {
    Frame frame;
    if (const auto& p = entry.position) frame.position = {double(p->x()), double(p->y()), double(p->z())};
    if (const auto& q = entry.orientation) frame.orientation = {double(q->w()), double(q->x()), double(q->y()), double(q->z())};
    if (!(std::abs(frame.orientation.norm() - 1) < 1e-3)) refuse("needs an orientation that is a unit quaternion.");
    frame.orientation.normalize();
    return frame;
  }

  void check_inside(const Eigen::Vector3d& position, double around) const {
    const auto outside = [&](double x, int k) { return !(x >= box_.min()[k] - around && x <= box_.max()[k] + around); };
    for (int k = 0; k < 3; ++k) {
      if (!outside(position[k], k)) continue;
      const Eigen::Vector3d size = box_.sizes();
      refuse("lies outside the car, which measures " + text_of(size.x()) + " x " + text_of(size.y()) + " x " +
             text_of(size.z()) +
             " m; give its position in the car's frame (x forward, y left, z up from the lowest point, metres, centred in x "
             "and y).");
    }
  }

  void add_point(const schema::PartEntryT& entry) {
    if (!entry.position) refuse("needs a position, because it is a point.");
    if (!entry.source.empty() || entry.radius != 0 || entry.width != 0)
      refuse("has a source or a size, which a point does not have; leave it out.");
    const Frame frame = frame_of(entry);
    check_inside(frame.position, 1);  // m: an aerial, a trailer's hitch
    place(out_.part[make(entry)], frame);
  }

  void add_wheel(const schema::PartEntryT& entry) {
    Frame frame = frame_of(entry);
    const bool whole = entry.position != nullptr;  // its cylinder is given
    for (const float size : {entry.radius, entry.width})
      if (whole ? !(size > 0 && size <= most_wheel_size) : size != 0)
        refuse(whole ? "needs a radius and a width above zero, in metres, at most 5."
                     : "has a size, but no position; give both, or neither and a source.");
    if (!whole && entry.source.empty()) refuse("needs a position, a radius and a width, or a source.");
    if (whole) check_inside(frame.position, 0);
    std::vector<uint32_t> taken = entry.source.empty() ? std::vector<uint32_t>() : fitting(entry);
    double radius = double(entry.radius), width = double(entry.width);
    if (whole) {
      taken = inside(frame, radius, width, entry.source.empty() ? nullptr : &taken);
      if (taken.empty()) refuse("holds no connected piece of the surface; move its hub, or make it larger.");
    } else {
      const Box box = extent(taken, frame);
      frame.position = frame.orientation * box.center();
      radius = std::max(box.sizes().x(), box.sizes().z()) / 2;
      width = box.sizes().y();
      if (!(radius > 0 && width > 0 && radius <= double(most_wheel_size) && width <= double(most_wheel_size)))
        refuse("takes what has no inside or is larger than any wheel; give its position, radius and width.");
    }
    const uint8_t index = make(entry);
    for (uint32_t t : taken) out_.of_triangle[t] = index;
    Part& part = out_.part[index];
    place(part, frame);
    part.radius = static_cast<float>(radius);
    part.width = static_cast<float>(width);
  }

  // The box of triangles in the axes of a frame, about the car's origin.
  Box extent(const std::vector<uint32_t>& triangles, const Frame& frame) const {
    Box box;
    for (uint32_t t : triangles)
      for (uint32_t v : input_.surface.triangle[t])
        box.extend(frame.orientation.conjugate() * input_.surface.vertex[v].cast<double>());
    return box;
  }

  // The triangles of the pieces in a cylinder. among: only of these.
  std::vector<uint32_t> inside(const Frame& frame, double radius, double width, const std::vector<uint32_t>* among) {
    if (pieces_.empty()) pieces_ = find_pieces(input_);
    std::vector<uint32_t> out;
    for (const Piece& piece : pieces_) {
      if (among && !std::binary_search(among->begin(), among->end(), piece.triangle.front())) continue;
      const bool all = std::all_of(piece.triangle.begin(), piece.triangle.end(), [&](uint32_t t) {
        return std::all_of(input_.surface.triangle[t].begin(), input_.surface.triangle[t].end(), [&](uint32_t v) {
          const Eigen::Vector3d p = frame.orientation.conjugate() * (input_.surface.vertex[v].cast<double>() - frame.position);
          return std::hypot(p.x(), p.z()) <= radius * (1 + slack_share) + slack &&
                 std::abs(p.y()) <= width / 2 * (1 + slack_share) + slack;
        });
      });
      if (all) out.insert(out.end(), piece.triangle.begin(), piece.triangle.end());
    }
    return out;
  }

  // The triangles whose names fit a pattern of the entry, ascending.
  std::vector<uint32_t> fitting(const schema::PartEntryT& entry) const {
    std::vector<uint8_t> taken(input_.named.size(), 0);
    for (const std::string& pattern : entry.source) {
      bool any = false;
      for (size_t i = 0; i < input_.named.size(); ++i)
        for (const std::string& name : input_.named[i].names)
          if (fnmatch(pattern.c_str(), name.c_str(), FNM_CASEFOLD) == 0) taken[i] = 1, any = true;
      if (!any) refuse("has the pattern \"" + pattern + "\", which fits no name in " + name_ + "; " + names_there() + ".");
    }
    std::vector<uint32_t> out;
    for (uint32_t t = 0; t < named_of_.size(); ++t)
      if (!taken.empty() && taken[named_of_[t]]) out.push_back(t);
    if (out.empty()) refuse("takes no triangle of " + name_ + "; give it other patterns.");
    return out;
  }

  std::string names_there() const {
    std::vector<std::string> names;
    for (const NamedPart& named : input_.named)
      for (const std::string& name : named.names)
        if (std::find(names.begin(), names.end(), name) == names.end()) names.push_back(name);
    if (names.empty()) return "the file has no names, so give wheels by position, radius and width";
    std::string out = "its names are ";
    for (size_t i = 0; i < std::min(names.size(), names_shown); ++i) out += (i ? ", " : "") + names[i];
    return out + (names.size() > names_shown ? " and " + std::to_string(names.size() - names_shown) + " more" : "");
  }

  const ImportedSurface& input_;
  const PartsText& text_;
  const std::string& name_;
  std::string where_;
  std::vector<size_t> named_of_;  // of each triangle
  std::vector<Piece> pieces_;
  Box box_;
  Division out_;
};

}  // namespace

bool is_solid(PartKind kind) { return kind != PartKind::wheel && kind != PartKind::interior && kind != PartKind::point; }

std::vector<Piece> find_pieces(const ImportedSurface& input) {
  const auto& triangles = input.surface.triangle;
  std::vector<size_t> named(triangles.size(), 0);
  for (size_t i = 0; i < input.named.size(); ++i)
    std::fill(named.begin() + std::ptrdiff_t(input.named[i].first), named.end(), i);
  std::map<std::pair<size_t, uint32_t>, uint32_t> index;  // of a vertex in a named part
  std::vector<uint32_t> corner;
  for (size_t t = 0; t < triangles.size(); ++t)
    for (uint32_t v : triangles[t])
      corner.push_back(index.try_emplace({named[t], v}, static_cast<uint32_t>(index.size())).first->second);
  const std::vector<uint32_t> first = connected(index.size(), corner, 3);
  std::map<uint32_t, size_t> place;
  std::vector<Piece> out;
  for (uint32_t t = 0; t < triangles.size(); ++t) {
    const auto [at, is_new] = place.try_emplace(first[corner[3 * t]], out.size());
    if (is_new) out.push_back({named[t], {}});
    out[at->second].triangle.push_back(t);
  }
  return out;
}

Division divide_surface(const ImportedSurface& input, const PartsText& text, const std::string& name) {
  Divider divider(input, text, name);
  for (const auto& entry : parse_parts(text).parts) divider.add(*entry);
  return divider.finish();
}

void split_at_parts(Surface& surface, const std::vector<uint8_t>& part_of_triangle) {
  std::vector<int> part(surface.vertex.size(), -1);  // none yet
  std::map<std::pair<uint32_t, int>, uint32_t> twin;
  for (size_t t = 0; t < surface.triangle.size(); ++t)
    for (uint32_t& vertex : surface.triangle[t]) {
      const int wanted = part_of_triangle[t];
      if (part[vertex] < 0) part[vertex] = wanted;
      if (part[vertex] == wanted) continue;
      const auto [at, is_new] = twin.try_emplace({vertex, wanted}, static_cast<uint32_t>(surface.vertex.size()));
      if (is_new) {
        surface.vertex.push_back(Vec3(surface.vertex[vertex]));
        if (!surface.color.empty()) surface.color.push_back(uint32_t(surface.color[vertex]));
        part.push_back(wanted);
      }
      vertex = at->second;
    }
  surface.part.clear();
  for (int each : part) surface.part.push_back(static_cast<uint8_t>(std::max(each, 0)));
}

}  // namespace crumple

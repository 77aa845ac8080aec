#include "wire/check.h"

#include <cmath>
#include <cstdio>

namespace crumple {
namespace {

std::string text(double value) {
  char buffer[32];
  std::snprintf(buffer, sizeof buffer, "%.9g", value);
  return buffer;
}

}  // namespace

std::string count_sentence(size_t count, size_t limit) {
  return "has " + std::to_string(count) + " entries; " + std::to_string(limit) + " are allowed";
}

void Checker::refuse(Reason reason, const Place& place, const char* field, const std::string& fact) {
  if (refusal) return;
  std::string name = place.table ? place.table : "";
  if (place.index) name += '[' + std::to_string(*place.index) + ']';
  if (place.table) name += '.';
  refusal = Refusal{reason, name + field + ' ' + fact};
}

void Checker::finite(const Place& place, const char* field, double value) {
  if (!std::isfinite(value)) refuse(Reason::non_finite, place, field, "is " + text(value) + "; a finite number is needed");
}

float Checker::number(const Place& place, const char* field, float value, double least, double most, const char* unit) {
  finite(place, field, value);
  if (value >= float(least) && value <= float(most)) return value;
  const std::string tail = *unit ? std::string(" ") + unit : std::string();
  refuse(Reason::out_of_range, place, field,
         "is " + text(value) + tail + "; allowed are " + text(least) + " to " + text(most) + tail);
  return float(least);
}

double Checker::energy(const Place& place, const char* field, double value) {
  finite(place, field, value);
  if (value < 0) refuse(Reason::out_of_range, place, field, "is " + text(value) + " J; at least 0 J is needed");
  return value;
}

Eigen::Vector3d Checker::vector(const Place& place, const char* field, const schema::Vec3& value, double longest,
                                const char* unit) {
  const Eigen::Vector3d vector(value.x(), value.y(), value.z());
  finite(place, field, vector.sum());
  if (vector.norm() > longest) {
    refuse(Reason::out_of_range, place, field,
           "is " + text(vector.norm()) + " " + unit + " long; " + text(longest) + " " + unit + " are allowed");
  }
  return vector;
}

Pose Checker::pose(const Place& place, const char* field, const schema::Pose& value) {
  Pose pose;
  pose.position = {value.position().x(), value.position().y(), value.position().z()};
  const schema::Quat& q = value.orientation();
  pose.orientation = Eigen::Quaterniond(q.w(), q.x(), q.y(), q.z());
  finite(place, field, pose.position.sum() + pose.orientation.coeffs().sum());
  if (pose.position.norm() > limits.farthest) {
    refuse(Reason::out_of_range, place, field,
           "has a position " + text(pose.position.norm()) + " m from the origin; " + text(limits.farthest) + " m are allowed");
  }
  const double norm = pose.orientation.norm();
  if (!(std::abs(norm - 1) <= 1e-3)) {
    refuse(Reason::out_of_range, place, field, "has an orientation of norm " + text(norm) + "; 1 within 0.001 is needed");
    return {};
  }
  pose.orientation.normalize();
  return pose;
}

std::string Checker::id(const Place& place, const char* field, std::string_view id) {
  if (!is_id(id) || id.size() > limits.id_length) {
    refuse(Reason::bad_id, place, field,
           "is " + printable(id) + "; 1 to " + std::to_string(limits.id_length) + " characters of a-z A-Z 0-9 _ - are allowed");
  }
  return std::string(id.substr(0, limits.id_length));
}

std::string Checker::asset(const Place& place, const flatbuffers::String* value) {
  const std::string_view digits = value->string_view();
  if (!is_hash(digits)) refuse(Reason::bad_id, place, "asset", "is " + printable(digits) + "; 16 digits of 0-9 a-f are needed");
  return std::string(digits.substr(0, 16));
}

}  // namespace crumple

#include "sim/body.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <type_traits>

namespace crumple {
namespace {

constexpr float farthest_node = 10;  // m from rest: no dent is as deep, and int16 displacements in units of 0.5 mm end at 16 m

void take_towards(float amount, float rest, float& value) { value = value + amount * (rest - value); }
void take_towards(float amount, const Vec3& rest, Vec3& value) { value = value + amount * (rest - value); }
void take_towards(float amount, const Gradients& rest, Gradients& value) {
  for (int k = 0; k < 3; ++k) take_towards(amount, rest.corner[k], value.corner[k]);
}

// Whether the solver can continue with this memory, for a body of this many nodes. Foreign bytes may hold anything.
bool is_sound(const PairMemory& memory, size_t nodes) {
  const std::vector<PairMemory::Touch>& touch = memory.touch;
  const auto not_ascending = [](const auto& a, const auto& b) { return a.node >= b.node; };
  if (std::adjacent_find(touch.begin(), touch.end(), not_ascending) != touch.end()) return false;
  const auto not_sorted = [](const auto& a, const auto& b) { return a.partner >= b.partner; };
  const std::vector<PairMemory::Push>& push = memory.push;
  if (std::adjacent_find(push.begin(), push.end(), not_sorted) != push.end()) return false;
  if (!std::all_of(push.begin(), push.end(), [](const PairMemory::Push& each) { return each.force.allFinite(); })) return false;
  for (const auto* keys : {&memory.near, &memory.passing}) {
    if (!std::is_sorted(keys->begin(), keys->end())) return false;
  }
  return std::all_of(touch.begin(), touch.end(), [&](const PairMemory::Touch& each) {
    return each.node < nodes && each.normal.allFinite() && each.friction.allFinite() && each.pressure >= 0 &&
           std::isfinite(each.pressure);
  });
}

// Hashes all fields: lists at once, single numbers together at the end.
class BodyHash {
 public:
  BodyHash() { numbers_.reserve(32); }
  template <class T>
  void operator()(const std::vector<T>& list) {
    chain(list.data(), list.size() * sizeof(T));
  }
  template <class Number>
  requires std::is_arithmetic_v<Number>
  void operator()(Number number) { numbers_.push_back(double(number)); }
  void operator()(const Eigen::Vector3d& v) { numbers_.insert(numbers_.end(), v.data(), v.data() + 3); }
  void operator()(const AndersonHistory& history) {
    each_field(history, [&](const auto& each) {
      using Field = std::remove_cvref_t<decltype(each)>;
      if constexpr (std::is_arithmetic_v<Field>) {
        (*this)(each);
      } else if constexpr (std::is_trivially_copyable_v<Field>) {
        chain(&each, sizeof each);
      }  // no need to hash the history's lists: their dot products follow from them
    });
  }
  void operator()(const PairMemory& memory) {
    const auto add = [&](const auto& list) {
      if (!list.empty()) (*this)(list);
    };
    add(memory.touch);
    add(memory.push);
    add(memory.near);
    add(memory.passing);
  }
  uint64_t value() {
    chain(numbers_.data(), numbers_.size() * sizeof(double));
    return sum_;
  }

 private:
  void chain(const void* data, size_t size) { sum_ = XXH64(data, size, sum_); }

  uint64_t sum_ = 0;
  std::vector<double> numbers_;
};

}  // namespace

DeformableState make_body(const Model& model) {
  DeformableState body;
  for_each_field([&](const auto& field) {
    if constexpr (IsList<decltype(field)>) {
      auto& list = body.*field.value;
      list.resize(count_of(model, field.per));
      for (size_t i = 0; i < list.size(); ++i) list[i] = rest_of(model, field, i);
    }
  });
  measure_reach(model, body);
  return body;
}

void repair(const Model& model, float amount, DeformableState& body) {
  if (amount >= 1) {
    const double absorbed = body.absorbed;
    body = make_body(model);
    body.absorbed = absorbed;
    return;
  }
  for_each_field([&](const auto& field) {
    if constexpr (IsList<decltype(field)>) {
      auto& list = body.*field.value;
      for (size_t i = 0; i < list.size() && field.traits.repaired; ++i) {
        take_towards(amount, rest_of(model, field, i), list[i]);
      }
    }
  });
  // Forget the motion that made the damage.
  for (Vec3& step : body.step) step.setZero();
  body.history = {};
  body.pairs = {};
  measure_reach(model, body);
  body.settled = false;
}

void measure_reach(const Model& model, DeformableState& body) {
  float most = 0;
  body.low = body.high = body.node[0];
  for (const Vec3& node : body.node) {
    most = std::max(most, (node - model.center_of_mass).squaredNorm());
    body.low = body.low.cwiseMin(node);
    body.high = body.high.cwiseMax(node);
  }
  body.reach = std::sqrt(most);
}

std::optional<std::string> refuse_fields(const Model& model, const DeformableState& body, bool saved) {
  std::optional<std::string> refusal;
  for_each_field([&](const auto& field) {
    if (refusal || (saved && !field.traits.saved)) return;
    const auto wrong = [&](float number) { return !std::isfinite(number) || (field.traits.not_negative && number < 0); };
    const auto& value = body.*field.value;
    const std::string name = std::string("the state's ") + field.name;
    if constexpr (IsList<decltype(field)>) {
      const size_t should = count_of(model, field.per);
      const bool fits = value.size() == should;
      if (!fits) {
        refusal = name + " has " + std::to_string(value.size()) + " entries, but the car needs " + std::to_string(should) +
                  ": the state is of another car";
      }
      const auto is_wrong = [&](const auto& entry) {
        const auto* numbers = reinterpret_cast<const float*>(&entry);
        return std::any_of(numbers, numbers + sizeof entry / sizeof(float), wrong);
      };
      const auto found = std::find_if(value.begin(), value.end(), is_wrong);
      if (fits && found != value.end()) {
        refusal = name + " has a number that is not finite, or negative where this is not allowed, in entry " +
                  std::to_string(found - value.begin());
      }
    } else if constexpr (std::is_same_v<decltype(value), const AndersonHistory&>) {
      if (!is_sound(value, model.node.size())) refusal = name + " is not one that the solver makes";
    } else if constexpr (std::is_same_v<decltype(value), const PairMemory&>) {
      if (!is_sound(value, model.node.size())) refusal = name + " are not ones that the solver makes";
    } else if constexpr (std::is_same_v<decltype(value), const Eigen::Vector3d&>) {
      if (!value.allFinite()) refusal = name + " is not finite";
    } else if (!std::isfinite(double(value)) || (field.traits.not_negative && double(value) < 0)) {
      refusal = name + " is not finite, or negative where this is not allowed";
    }
  });
  return refusal;
}

std::optional<std::string> refuse_state(const Model& model, const DeformableState& body) {
  if (auto refusal = refuse_fields(model, body, true)) return refusal;
  for (size_t i = 0; i < body.node.size(); ++i) {
    if (!((body.node[i] - model.node[i]).norm() <= farthest_node)) {
      return "node " + std::to_string(i) + " of the state is farther than 10 m from rest";
    }
  }
  return std::nullopt;
}

uint64_t hash(const DeformableState& body) {
  BodyHash sum;
  for_each_field([&](const auto& field) { sum(body.*field.value); });
  return sum.value();
}

}  // namespace crumple

// The checks of decode. Each takes a received field and returns it in the program's types, or keeps the first refusal, which
// says the field, its value and the allowed range. After a refusal values are meaningless but harmless.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "protocol/key.h"
#include "protocol/limits.h"
#include "protocol/message.h"
#include "schema/message_generated.h"
#include "sim/obstacle.h"
#include "wire/refusal.h"

namespace crumple {

// The place of a field: "spawn.", "cars[3]." or, with neither, the message itself.
struct Place {
  const char* table = nullptr;
  std::optional<uint32_t> index = std::nullopt;
};

struct Checker {
  const Limits& limits;
  std::optional<Refusal> refusal = std::nullopt;

  void refuse(Reason, const Place&, const char* field, const std::string& fact);
  void finite(const Place&, const char* field, double);
  float number(const Place&, const char* field, float, double least, double most, const char* unit);
  double energy(const Place&, const char* field, double);  // J, at least 0
  Eigen::Vector3d vector(const Place&, const char* field, const schema::Vec3&, double longest, const char* unit);
  Pose pose(const Place&, const char* field, const schema::Pose&);
  std::string id(const Place&, const char* field, std::string_view);
  std::string id(const Place& place, const char* field, const flatbuffers::String* text) {
    return id(place, field, text->string_view());
  }
  std::string asset(const Place&, const flatbuffers::String*);
};

// "has 1001 entries; 1000 are allowed"
std::string count_sentence(size_t count, size_t limit);

// The root table if every offset below it is valid; otherwise null, with a refusal. `tables`: the most entries of its list. The
// verifier allows twice as many tables, so that one entry too many gets a better refusal than a forged file that names one
// table a million times.
template <class Table>
const Table* checked(std::span<const std::byte> bytes, const char* what, const char* table, uint32_t tables, Checker& check) {
  if (bytes.size() > check.limits.message_size) {
    check.refuse(
        Reason::too_large, {}, what,
        "has " + std::to_string(bytes.size()) + " bytes; " + std::to_string(check.limits.message_size) + " are allowed");
    return nullptr;
  }
  if (const auto* root = crumple::verified<Table>(bytes, 2 * tables + 8)) return root;
  check.refuse(Reason::malformed, {}, what,
               "(" + std::to_string(bytes.size()) + " bytes) is not a " + table +
                   " table of schema/message.fbs: it is cut off, an offset is wrong, a required field is missing, or it has "
                   "too many tables");
  return nullptr;
}

}  // namespace crumple

// Why a message was refused: a reason to count, and a sentence that names the field and the limit.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

namespace crumple {

enum class Reason : uint8_t {
  bad_key,       // no such key
  malformed,     // not the FlatBuffers table that belongs there
  too_large,     // more bytes than a message may have
  bad_id,        // id of a host or car: wrong characters or length
  non_finite,    // NaN or infinite
  out_of_range,  // a number beyond its limit
  duplicate,     // one id twice in one message
  too_many_cars,
  too_many_hosts,
  too_many_obstacles,
  bad_hull,  // its points span no convex body
  unknown_host,
  unknown_car,
  unknown_asset,
  not_owner,       // a pose for another host's car
  already_there,   // spawn of a living car
  stale_sequence,  // not above the last sequence
  bad_state,       // of another car, or no deformation state
};
inline constexpr std::array reason_names = {
    "bad_key",       "malformed",      "too_large",          "bad_id",    "non_finite",   "out_of_range", "duplicate",
    "too_many_cars", "too_many_hosts", "too_many_obstacles", "bad_hull",  "unknown_host", "unknown_car",  "unknown_asset",
    "not_owner",     "already_there",  "stale_sequence",     "bad_state",
};
inline constexpr size_t reason_count = reason_names.size();
static_assert(reason_count == size_t(Reason::bad_state) + 1);

// Why an input was refused. Functions that may refuse return std::optional<Refusal>: empty if they took the input.
struct Refusal {
  Reason reason;
  std::string sentence;
};

}  // namespace crumple

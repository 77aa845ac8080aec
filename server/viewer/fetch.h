// Fetches baked cars from the server, piece by piece. A complete car has the hash that names it. A car with another hash is
// thrown away, and fetched again when it is wanted again.
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "viewer/ask.h"

namespace crumple::viewer {

// After this long without a piece the fetch has failed: on a line of 210 kbit/s a piece takes 10 s.
inline constexpr std::chrono::milliseconds piece_patience{10'000};

struct Baked {
  std::vector<uint64_t> words;  // the bytes, aligned
  size_t size = 0;
  std::span<const uint8_t> bytes() const { return {reinterpret_cast<const uint8_t*>(words.data()), size}; }
};

// The result of one answer: the car is whole, or something failed, or neither, and more pieces come.
struct AssetNews {
  std::string hash;
  std::optional<Baked> whole = std::nullopt;
  std::string trouble = {};
  bool corrupt = false;  // `trouble` is that the bytes have another hash
};

struct Fetching {
  struct Asset {
    Baked baked;
    uint64_t asking = 0;  // ticket; 0: none
    Time asked{};
  };
  Ask ask;
  std::chrono::milliseconds patience = piece_patience;
  std::map<std::string, Asset, std::less<>> assets = {};  // by hash
  std::map<uint64_t, std::string> tickets = {};           // ticket of a question -> hash

  // Starts fetching, unless the fetch is under way or failed a moment ago. Call it as long as the car is wanted. Returns false
  // if the question could not be sent.
  bool want(const std::string& hash, Time now);
  void forget(std::string_view hash);
  size_t size() const;  // bytes that have arrived

  // Returns nothing if no question of this object has the ticket.
  std::optional<AssetNews> take_reply(uint64_t ticket, std::span<const uint8_t>, bool failed, Time now);
  std::optional<AssetNews> end(uint64_t ticket);  // no more answers come
};

}  // namespace crumple::viewer

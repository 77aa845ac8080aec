#include "protocol/key.h"

#include <algorithm>
#include <charconv>

namespace crumple {
namespace {

bool is_id_character(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-';
}

// Accepts a number only as it would be printed: no leading zeros, at most `most`.
std::optional<uint64_t> parse_number(std::string_view text, uint64_t most) {
  uint64_t number = 0;
  const char* const end = text.data() + text.size();
  if (text.empty() || (text[0] == '0' && text.size() > 1)) return std::nullopt;
  const auto [stop, error] = std::from_chars(text.data(), end, number);
  return error == std::errc() && stop == end && number <= most ? std::optional(number) : std::nullopt;
}

std::string_view take_chunk(std::string_view& rest) {
  const size_t slash = rest.find('/');
  const std::string_view chunk = rest.substr(0, slash);
  rest = slash == rest.npos ? std::string_view() : rest.substr(slash + 1);
  return chunk;
}

// "{number}-{id}"
std::optional<Key> parse_token(Channel channel, std::string_view text, uint64_t most) {
  const size_t dash = std::min(text.find('-'), text.size());
  const auto number = parse_number(text.substr(0, dash), most);
  const std::string_view id = text.substr(std::min(text.size(), dash + 1));
  return number && is_id(id) ? std::optional(Key{channel, id, *number}) : std::nullopt;
}

std::optional<Key> parse_surface(Channel channel, std::string_view car, std::string_view level) {
  const auto number = parse_number(level, surface_level_count - 1);
  return number ? std::optional(Key{channel, car, *number}) : std::nullopt;
}

}  // namespace

bool is_id(std::string_view text) {
  return !text.empty() && text.size() <= id_length_limit && std::all_of(text.begin(), text.end(), is_id_character);
}

bool is_scene(std::string_view text) { return is_id(text) && root_of(text) != asset_root; }

bool is_hash(std::string_view text) { return text.size() == 16 && text.find_first_not_of("0123456789abcdef") == text.npos; }

std::optional<Key> parse_key(std::string_view key) {
  struct Single {
    std::string_view key;
    Channel channel;
  };
  static constexpr Single singles[] = {
      {"asset", Channel::asset},   {"budget", Channel::budget},       {"health", Channel::health},
      {"inputs", Channel::latest}, {"replica/world", Channel::world}, {"replica/inputs", Channel::replica_inputs},
      {"server", Channel::server}, {"tick", Channel::tick_end},
  };
  for (const Single& single : singles)
    if (key == single.key) return Key{single.channel, {}, 0};
  // The code below uses up the whole key, so a slash at its end would be one too many.
  if (key.ends_with('/')) return std::nullopt;
  std::string_view rest = key;
  const std::string_view kind = take_chunk(rest);
  if (kind == "owner") return parse_token(Channel::owner, rest, epoch_limit);
  if (kind == "standby") return parse_token(Channel::standby, rest, 1);
  const std::string_view id = take_chunk(rest);
  if (!is_id(id)) return std::nullopt;
  if (kind == "host") {
    if (rest == "poses") return Key{Channel::poses, id, 0};
    if (rest == "obstacles") return Key{Channel::obstacles, id, 0};
    if (rest == "reactions") return Key{Channel::reactions, id, 0};
  } else if (kind == "car") {
    if (rest.empty()) return Key{Channel::command, id, 0};
    if (rest == "answer") return Key{Channel::answer, id, 0};
    const std::string_view what = take_chunk(rest);
    if (what == "key") return parse_surface(Channel::keyframe, id, rest);
    if (what == "delta") return parse_surface(Channel::delta, id, rest);
  }
  return std::nullopt;
}

std::optional<Key> parse_key(std::string_view key, std::string_view root) {
  if (key.starts_with(root)) return parse_key(key.substr(root.size()));
  if (!key.starts_with(asset_root)) return std::nullopt;
  const std::string_view hash = key.substr(asset_root.size());
  return is_hash(hash) ? std::optional(Key{Channel::piece, hash, 0}) : std::nullopt;
}

std::string root_of(std::string_view scene) { return std::string(key_root) + std::string(scene) + "/"; }

std::string owner_key(uint64_t epoch, std::string_view server) {
  return "owner/" + std::to_string(epoch) + "-" + std::string(server);
}

std::string standby_key(uint64_t rank, std::string_view server) {
  return "standby/" + std::to_string(rank) + "-" + std::string(server);
}

std::string printable(std::string_view raw) {
  std::string out(raw.substr(0, 64));
  for (char& c : out) {
    if (c < ' ' || c > '~') c = '?';
  }
  return '"' + out + (raw.size() > 64 ? "...\"" : "\"");
}

}  // namespace crumple

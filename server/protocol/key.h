// Every key of the protocol: parsed here where it comes in, and nowhere else. What parses cannot be wrong: ids are ids, levels
// are ours, numbers are in their range, no part is a wildcard. What does not parse is refused and counted by whoever holds the
// door.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace crumple {

inline constexpr std::string_view key_root = "crumple/1/";  // the protocol and its version; then scenes
inline constexpr std::string_view asset_root = "crumple/1/asset/";
inline constexpr size_t id_length_limit = 32;  // characters
inline constexpr size_t surface_level_count = 2;
// Of a scene's owners, one after another: a takeover each second for thirty years. The next one can always be counted.
inline constexpr uint64_t epoch_limit = 1'000'000'000;

// Of a scene, host, car or server: 1 to 32 characters of a-z A-Z 0-9 _ -
bool is_id(std::string_view);
inline constexpr const char* id_rule = "1 to 32 characters of a-z A-Z 0-9 _ -";
// Of a scene: an id, but not "asset", under which the keys of baked cars stand, which no scene owns.
bool is_scene(std::string_view);
// Of a baked car: 16 hexadecimal digits, lower case.
bool is_hash(std::string_view);

// What stands under a key. Inputs of a tick come first.
enum class Channel : uint8_t {
  poses,      // host/{host}/poses
  obstacles,  // host/{host}/obstacles
  budget,     // of a recording: the server's own
  asset,      // a baked car that a player gives
  command,    // car/{car}: queries; also the token of a car that lives
  reactions,  // host/{host}/reactions
  keyframe,   // car/{car}/key/{level}
  delta,      // car/{car}/delta/{level}
  answer,     // car/{car}/answer: of a recording
  health,
  tick_end,        // tick: of a recording
  latest,          // inputs: what hosts told last, for whoever comes late
  world,           // replica/world
  replica_inputs,  // replica/inputs
  piece,           // crumple/1/asset/{hash}: a piece of a baked car
  server,          // the token of a scene that is served
  owner,           // owner/{epoch}-{server}: the token of the server whose ticks count
  standby,         // standby/{rank}-{server}: the token of one that waits
  other            // of a recording: not ours
};
inline bool is_input(Channel channel) { return channel <= Channel::command; }

struct Key {
  Channel channel = Channel::other;
  std::string_view id;  // of the host, car or server, or the hash of the baked car; a part of what was parsed
  uint64_t number = 0;  // surface level, epoch or rank
};

// Below the root of a scene, such as "car/7/key/0".
std::optional<Key> parse_key(std::string_view below_root);
inline constexpr const char* key_rule =
    " is none of host/{host}/poses, host/{host}/obstacles, asset, car/{car}, car/{car}/key/{level}, with ids of 1 to 32 "
    "characters of "
    "a-z A-Z 0-9 _ - and levels 0 and 1";
// A whole one: below `root`, "crumple/1/{scene}/", or a piece of a baked car, which no scene owns.
std::optional<Key> parse_key(std::string_view key, std::string_view root);
// The root of a scene's keys: "crumple/1/{scene}/".
std::string root_of(std::string_view scene);
// Of tokens, below the root.
std::string owner_key(uint64_t epoch, std::string_view server);
std::string standby_key(uint64_t rank, std::string_view server);
// For sentences: at most 64 characters, all of them printable.
std::string printable(std::string_view);

}  // namespace crumple

// Every key of the protocol is parsed here when it arrives, and nowhere else. A parsed key is correct: its ids are ids, its
// level is one of ours, its number is in range, and no part is a wildcard. The receiver refuses and counts keys that do not
// parse.
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
// Largest epoch: enough for a takeover each second for thirty years. So adding 1 to an epoch never overflows.
inline constexpr uint64_t epoch_limit = 1'000'000'000;

// Whether this may name a scene, host, car or server: 1 to 32 characters of a-z A-Z 0-9 _ -
bool is_id(std::string_view);
inline constexpr const char* id_rule = "1 to 32 characters of a-z A-Z 0-9 _ -";
// Whether this may name a scene: any id except "asset", because the keys of baked cars have "asset" in the place of a scene.
bool is_scene(std::string_view);
// Whether this may name a baked car: 16 hexadecimal digits, lower case.
bool is_hash(std::string_view);

// The kind of message under a key. The inputs of a tick come first.
enum class Channel : uint8_t {
  poses,      // host/{host}/poses
  obstacles,  // host/{host}/obstacles
  budget,     // only in recordings: the server's own input
  asset,      // a baked car that a player uploads
  command,    // car/{car}: queries; also the token of a living car
  reactions,  // host/{host}/reactions
  keyframe,   // car/{car}/key/{level}
  delta,      // car/{car}/delta/{level}
  answer,     // car/{car}/answer: only in recordings
  health,
  tick_end,        // tick: only in recordings
  latest,          // inputs: the hosts' last poses and obstacles, for viewers that come late
  world,           // replica/world
  replica_inputs,  // replica/inputs
  piece,           // crumple/1/asset/{hash}: a piece of a baked car
  server,          // the token of a scene that has a server
  owner,           // owner/{epoch}-{server}: the token of the server whose ticks count
  standby,         // standby/{rank}-{server}: the token of a server that waits
  other            // only in recordings: a channel of another program
};
inline bool is_input(Channel channel) { return channel <= Channel::command; }

struct Key {
  Channel channel = Channel::other;
  std::string_view id;  // of the host, car or server, or the baked car's hash; points into the parsed text
  uint64_t number = 0;  // surface level, epoch or rank
};

// Parses a key below the root of a scene, such as "car/7/key/0".
std::optional<Key> parse_key(std::string_view below_root);
inline constexpr const char* key_rule =
    " is none of host/{host}/poses, host/{host}/obstacles, asset, car/{car}, car/{car}/key/{level}, with ids of 1 to 32 "
    "characters of "
    "a-z A-Z 0-9 _ - and levels 0 and 1";
// Parses a whole key: below `root`, "crumple/1/{scene}/", or a piece of a baked car, which belongs to no scene.
std::optional<Key> parse_key(std::string_view key, std::string_view root);
// The root of a scene's keys: "crumple/1/{scene}/".
std::string root_of(std::string_view scene);
// Keys of tokens, below the root.
std::string owner_key(uint64_t epoch, std::string_view server);
std::string standby_key(uint64_t rank, std::string_view server);
// Text for sentences: at most 64 characters, all printable.
std::string printable(std::string_view);

}  // namespace crumple

// Fuzzes keys of samples, queries and tokens as Zenoh delivers them.
#include "protocol/key.h"

#include "fuzz/entries.h"

namespace crumple::fuzz {
namespace {

// Writes the parsed key in its only form.
std::string written(const Key& key) {
  const std::string id(key.id), number = std::to_string(key.number);
  switch (key.channel) {
    case Channel::poses:
      return "host/" + id + "/poses";
    case Channel::obstacles:
      return "host/" + id + "/obstacles";
    case Channel::reactions:
      return "host/" + id + "/reactions";
    case Channel::command:
      return "car/" + id;
    case Channel::keyframe:
      return "car/" + id + "/key/" + number;
    case Channel::delta:
      return "car/" + id + "/delta/" + number;
    case Channel::answer:
      return "car/" + id + "/answer";
    case Channel::owner:
      return owner_key(key.number, id);
    case Channel::standby:
      return standby_key(key.number, id);
    case Channel::asset:
      return "asset";
    case Channel::budget:
      return "budget";
    case Channel::health:
      return "health";
    case Channel::tick_end:
      return "tick";
    case Channel::latest:
      return "inputs";
    case Channel::world:
      return "replica/world";
    case Channel::replica_inputs:
      return "replica/inputs";
    case Channel::server:
      return "server";
    case Channel::piece:
    case Channel::other:
      break;
  }
  throw Broken{"a key below the root is of a channel that stands there"};
}

}  // namespace

bool key_run(Input input) {
  const std::string_view text(reinterpret_cast<const char*>(input.data()), input.size());
  const std::string root = root_of("main");
  if (const auto below = parse_key(text)) {
    expect(written(*below) == text, "a key is parsed only as it would be written");
    expect(below->id.empty() || is_id(below->id), "an id is one");
    const std::string with_root = root + std::string(text);
    const auto whole = parse_key(with_root, root);
    expect(whole && whole->channel == below->channel && whole->id == below->id, "a root before it changes nothing");
    saw("below" + std::to_string(int(below->channel)));
    return true;
  }
  const auto whole = parse_key(text, root);
  if (!whole) return false;
  if (whole->channel == Channel::piece)
    expect(std::string(asset_root) + std::string(whole->id) == text && is_hash(whole->id), "a piece is of a baked car");
  else
    expect(root + written(*whole) == text, "a key is parsed only as it would be written");
  return true;
}

std::vector<std::vector<uint8_t>> key_seeds() {
  std::vector<std::vector<uint8_t>> seeds;
  for (const std::string key :
       {"host/h/poses", "host/h/obstacles", "host/h/reactions", "car/c-1", "car/c_1/key/0", "car/c/delta/1", "car/c/answer",
        "asset", "budget", "health", "tick", "inputs", "replica/world", "replica/inputs", "server", "owner/1000000000-00ff",
        "standby/0-a", "crumple/1/asset/0123456789abcdef", "crumple/1/main/car/c/key/1"})
    seeds.emplace_back(key.begin(), key.end());
  return seeds;
}

}  // namespace crumple::fuzz

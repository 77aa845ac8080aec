// Tests keys: a key that parses is correct and is written as it was; every other key is refused.
#include "protocol/key.h"

#include <gtest/gtest.h>

namespace crumple {
namespace {

const std::string root = root_of("main");

TEST(Keys, AreParsedIntoWhatStandsUnderThem) {
  struct Row {
    const char* key;
    Channel channel;
    std::string_view id;
    uint64_t number;
  };
  for (const auto& [key, channel, id, number] : {
           Row{"host/game/poses", Channel::poses, "game", 0},
           {"host/game/obstacles", Channel::obstacles, "game", 0},
           {"host/game/reactions", Channel::reactions, "game", 0},
           {"car/a-1", Channel::command, "a-1", 0},
           {"car/a_1/key/0", Channel::keyframe, "a_1", 0},
           {"car/a_1/key/1", Channel::keyframe, "a_1", 1},
           {"car/7/delta/1", Channel::delta, "7", 1},
           {"car/7/answer", Channel::answer, "7", 0},
           {"asset", Channel::asset, "", 0},
           {"budget", Channel::budget, "", 0},
           {"health", Channel::health, "", 0},
           {"tick", Channel::tick_end, "", 0},
           {"inputs", Channel::latest, "", 0},
           {"replica/inputs", Channel::replica_inputs, "", 0},
           {"replica/world", Channel::world, "", 0},
           {"server", Channel::server, "", 0},
           {"owner/1000000000-00ff", Channel::owner, "00ff", 1'000'000'000},
           {"standby/1-00ff-", Channel::standby, "00ff-", 1},
       }) {
    const std::string whole = root + key;  // the parsed key points into it
    const auto parsed = parse_key(whole, root);
    ASSERT_TRUE(parsed) << key;
    EXPECT_EQ(parsed->channel, channel) << key;
    EXPECT_EQ(parsed->id, id) << key;
    EXPECT_EQ(parsed->number, number) << key;
    EXPECT_EQ(channel <= Channel::command, is_input(channel));
  }
  EXPECT_EQ(owner_key(1'000'000'000, "00ff"), "owner/1000000000-00ff");
  EXPECT_EQ(standby_key(1, "00ff-"), "standby/1-00ff-");
  const auto piece = parse_key("crumple/1/asset/0123456789abcdef", root);
  ASSERT_TRUE(piece);
  EXPECT_EQ(piece->channel, Channel::piece);
  EXPECT_EQ(piece->id, "0123456789abcdef");
}

TEST(Keys, OfNobodyAreRefused) {
  const std::string long_id(33, 'a');
  for (const std::string& key : {
           std::string(),
           std::string("car"),
           std::string("host"),
           std::string("host/game"),
           std::string("car/a/"),
           std::string("car/a/key"),
           std::string("car/a/key/"),
           std::string("car/a/key/2"),
           std::string("car/a/key//"),
           std::string("car/a/key/*"),
           std::string("car/a/key/00"),
           std::string("car/a/key/0/"),
           std::string("car/a/key/0/1"),
           std::string("/"),
           std::string("//"),
           std::string("car/"),
           std::string("host//poses"),
           std::string("car/*"),
           std::string("car/a b"),
           std::string("car/\x01/key/0"),
           std::string("car/a\0b", 7),
           std::string("**"),
           std::string("*"),
           std::string("car/**"),
           std::string("host/*/poses"),
           std::string("host/a$*/poses"),
           std::string("@/car/a"),
           std::string("car/@a"),
           std::string("owner/2-"),
           std::string("owner/-a"),
           std::string("owner/2"),
           std::string("owner/"),
           std::string("owner/**"),
           std::string("owner/02-a"),
           std::string("owner/+2-a"),
           std::string("owner/-2-a"),
           std::string("owner/1000000001-a"),
           std::string("owner/18446744073709551615-a"),
           std::string("owner/99999999999999999999999-a"),
           std::string("owner/2-a/b"),
           std::string("standby/2-a"),
           std::string("replica/**"),
           std::string("replica/inputs/"),
           std::string("Asset"),
           std::string("asset/"),
           "car/" + long_id,
           "host/" + long_id + "/poses",
       })
    EXPECT_FALSE(parse_key(key)) << key;
  for (const char* key : {"crumple/1/asset/*", "crumple/1/asset/", "crumple/1/asset/0123456789ABCDEF", "crumple/1/main",
                          "crumple/1/main2/health", "crumple/1/asset/0123456789abcdef0", "**", "crumple/**", ""})
    EXPECT_FALSE(parse_key(key, root)) << key;
}

TEST(Keys, OfNoSceneAreThoseOfBakedCars) {
  for (const char* name : {"main", "Asset", "assets", "a", "-"}) EXPECT_TRUE(is_scene(name)) << name;
  for (const char* name : {"asset", "", "*", "a/b", "asset/"}) EXPECT_FALSE(is_scene(name)) << name;
}

}  // namespace
}  // namespace crumple

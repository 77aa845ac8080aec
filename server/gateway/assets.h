// The baked cars that browsers get under /asset/{hash}: those of the living cars, and the newest few of earlier ones for pages
// that lag behind.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "car/car.h"
#include "io/net.h"
#include "io/web.h"
#include "viewer/fetch.h"

namespace crumple {

class ShownAssets {
 public:
  using Bytes = std::shared_ptr<const std::vector<uint8_t>>;
  using Hashes = std::set<std::string_view>;
  // of_cars: the hashes of the living cars' assets. keeps: keep the bytes here too, for painting.
  ShownAssets(Web*, viewer::Ask, std::function<Hashes()> of_cars, bool keeps);
  // Fetches the asset unless it is there.
  void want(const std::string& hash, viewer::Time now);
  // Adds an asset that the gateway painted: browsers ask for it as soon as a car uses it.
  void add_painted(const Car&);
  // The bytes of an asset; null: not there, or not kept.
  Bytes bytes(const std::string& hash) const;
  // Whether the event belonged to a question of this object.
  bool take_reply(const NetEvent&, viewer::Time now);

 private:
  struct Shown {
    uint64_t number = 0;  // order in which browsers or cars wanted the assets
    size_t size = 0;
    Bytes bytes = nullptr;
    bool done = false;  // browsers have it, or there is no room for it
  };
  Shown& find_or_add(const std::string& hash);
  void forget_spare();
  bool has_room(size_t more) const;
  void show(const std::string& hash, Shown&, std::span<const uint8_t>);

  Web* web_;
  std::function<Hashes()> of_cars_;
  bool keeps_;
  viewer::Fetching fetching_;
  std::map<std::string, Shown, std::less<>> assets_;  // by hash
  uint64_t wanted_ = 0;                               // number of assets wanted so far
};

}  // namespace crumple

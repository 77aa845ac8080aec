// Baked cars that arrive while the world runs, so that a newly painted car can be driven without restarting the server. They do
// not become levels of other assets, so they do not change living cars.
#include "tick/uploads.h"

#include <algorithm>

#include "tick/state.h"

namespace crumple {
namespace {

// Anybody who may send commands may upload again and again, so uploads are limited. The size of one: largest_upload, uploads.h.
constexpr size_t upload_count_limit = 16, upload_size_limit = size_t{64} << 20;  // cars; bytes of their files together

bool drives(const World& world, const Levels& levels) {
  return std::any_of(world.cars.begin(), world.cars.end(), [&](const auto& each) { return each.second.levels == &levels; });
}

bool has_room(const World& world, size_t size) {
  for (const Levels& levels : world.uploaded) size += levels.front()->bytes.size();
  return world.uploaded.size() < upload_count_limit && size <= upload_size_limit;
}

}  // namespace

const Levels* find_asset(const World& world, const std::string& hash) {
  if (const auto found = world.assets.find(hash); found != world.assets.end()) return &found->second;
  const auto is_it = [&](const Levels& levels) { return levels.front()->hash == hash; };
  const auto found = std::find_if(world.uploaded.begin(), world.uploaded.end(), is_it);
  return found != world.uploaded.end() ? &*found : nullptr;
}

std::optional<Refusal> upload(World& world, std::shared_ptr<const Car> car) {
  if (find_asset(world, car->hash)) return std::nullopt;
  while (!has_room(world, car->bytes.size())) {
    const auto unused = std::find_if(world.uploaded.begin(), world.uploaded.end(),
                                     [&](const Levels& levels) { return !drives(world, levels); });
    if (unused == world.uploaded.end()) {
      return Refusal{Reason::too_large, "asset: there is no room for one more baked car of " +
                                            std::to_string(car->bytes.size()) +
                                            " bytes, because cars use all others; despawn another car first"};
    }
    world.uploaded.erase(unused);
  }
  world.uploaded.push_back({std::move(car)});
  return std::nullopt;
}

std::vector<std::shared_ptr<const Car>> uploaded_cars(const World& world) {
  std::vector<std::shared_ptr<const Car>> cars;
  for (const Levels& levels : world.uploaded) cars.push_back(levels.front());
  return cars;
}

}  // namespace crumple

// Fuzzes a whole world as bytes, as in a standby and a recording. An attacker can also forge the checksum, so any world that
// can be loaded must be able to tick.
#include "tick/snapshot.h"

#include <stdexcept>

#include "fuzz/small_world.h"
#include "host.h"
#include "tick/health.h"
#include "tick/state.h"

namespace crumple::fuzz {

bool snapshot_run(Input input) {
  const WorldHandle world = small_world();
  try {
    load_unsummed_world(with_assets(input), *world);
  } catch (const std::runtime_error&) {
    expect(cars(*world).empty() && tick_count(*world) == 0, "a world that is refused is empty");
    return false;
  }
  expect_saved(*world);
  Inbox inbox;
  for (const auto& [id, host] : world->hosts) inbox.push_back({"host/" + id + "/obstacles", host::obstacles(UINT64_MAX, {})});
  for (const std::string& car : cars(*world)) inbox.push_back({"car/" + car + "/key/0", {}, 1});
  advance(*world, {});
  advance(*world, inbox);
  inbox.clear();
  for (const std::string& car : cars(*world)) inbox.push_back({"car/" + car, host::despawn(), 1});
  advance(*world, inbox);
  return refusal_count(*world) == 0;
}

std::vector<std::vector<uint8_t>> snapshot_seeds() {
  using host::pose_at;
  const WorldHandle world = small_world();
  std::vector<std::vector<uint8_t>> seeds = {without_assets(save_world(*world))};
  const host::Thing wall{1, schema::Shape::box, {0.5f, 5, 5}, pose_at(2.85, 0, 1)},
      ball{7, schema::Shape::sphere, {1, 0, 0}, pose_at(9, 9, 9)};
  advance(*world, {{"car/c0", host::spawn(fine_car()->hash, "h0"), 1},
                   {"car/c1", host::spawn(coarse_car()->hash, "h1", pose_at(0, 9)), 1},
                   {"host/h0/obstacles", host::obstacles(1, {wall, ball})}});
  for (uint64_t k = 1; k < 4; ++k)
    advance(*world, {{"host/h0/poses", host::poses(k, {{"c0", pose_at(0.2 * double(k)), {14, 0, 0}}})}});
  seeds.push_back(without_assets(save_world(*world)));
  return seeds;
}

}  // namespace crumple::fuzz

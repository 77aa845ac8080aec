// Fuzzes the messages from the owner of a scene to a standby: the inputs of a tick.
#include "fuzz/small_world.h"
#include "host.h"
#include "recording/recording.h"
#include "service/standby.h"
#include "tick/budget.h"
#include "tick/health.h"

namespace crumple::fuzz {

bool inputs_run(Input input) {
  const WorldHandle world = small_world();
  bool taken = true;
  for (const Part& part : parts_of(input)) {
    const auto inputs = read_inputs(with_assets(part.bytes));
    taken = taken && inputs;
    if (!inputs) continue;
    advance(*world, inputs->inbox);
    if (tick_count(*world) == 12) break;
  }
  expect_saved(*world);
  return taken && refusal_count(*world) == 0;
}

std::vector<std::vector<uint8_t>> inputs_seeds() {
  const host::Thing wall{1, schema::Shape::box, {0.5f, 5, 5}, host::pose_at(2.85, 0, 1)};
  std::vector<uint8_t> seed;
  const auto add = [&](uint64_t tick, const Inbox& inbox) {
    put(0, 0, input_of(inputs_message(tick, inbox, 7 * tick).bytes), seed);
  };
  add(1, {{"car/c0", host::spawn(fine_asset, "h0"), 1}, {"host/h0/obstacles", host::obstacles(1, {wall})}, budget_message(9)});
  for (uint64_t k = 2; k < 6; ++k)
    add(k, {{"host/h0/poses", host::poses(k, {{"c0", host::pose_at(0.2 * double(k)), {14, 0, 0}}})}});
  return {seed};
}

}  // namespace crumple::fuzz

// Fuzzes messages of hosts and viewers in the ticks of a small world.
#include "fuzz/small_world.h"
#include "host.h"
#include "tick/health.h"
#include "wire/encode.h"

namespace crumple::fuzz {
namespace {

enum Kind : uint8_t { poses, obstacles, command, keyframe, named, end_of_tick, asset, kinds };

// which: bit 0: the host; bit 1: the car.
std::string key_of(const Part& part) {
  const std::string host = part.which & 1 ? "host/h1" : "host/h0", car = part.which & 2 ? "car/c1" : "car/c0";
  switch (part.kind % kinds) {
    case poses:
      return host + "/poses";
    case obstacles:
      return host + "/obstacles";
    case command:
      return car;
    case asset:
      return "asset";
    default:
      return car + "/key/0";
  }
}

Message message_of(const Part& part) {
  if (part.kind % kinds != named) {
    const bool query = part.kind % kinds == command || part.kind % kinds == keyframe || part.kind % kinds == asset;
    return {key_of(part), with_assets(part.bytes), query ? 1u : 0u};
  }
  const size_t split = std::min<size_t>(part.which, part.bytes.size());  // any key, then the bytes
  const Input bytes(part.bytes);
  return {std::string(part.bytes.begin(), part.bytes.begin() + ptrdiff_t(split)), with_assets(bytes.subspan(split)),
          part.bytes.size() % 2};
}

void add(Kind kind, uint8_t which, const Bytes& bytes, std::vector<uint8_t>& to) { put(kind, which, input_of(bytes), to); }

}  // namespace

bool tick_run(Input input) {
  const WorldHandle world = small_world();
  Inbox inbox;
  int left = 12;
  for (const Part& part : parts_of(input)) {
    if (part.kind % kinds == end_of_tick) {
      advance(*world, std::move(inbox));
      inbox.clear();
      if (--left == 0) break;
    } else if (Message message = message_of(part); message.key != "budget") {  // only the program sends this key
      sequence_of(message.bytes);
      inbox.push_back(std::move(message));
    }
  }
  for (int k = 0; k < 2; ++k) advance(*world, std::exchange(inbox, {}));
  expect_saved(*world);
  return refusal_count(*world) == 0;
}

std::vector<std::vector<uint8_t>> tick_seeds() {
  using host::pose_at;
  const Bytes spawn = host::spawn(fine_asset, "h0");
  std::vector<uint8_t> crash, shapes, states, given;
  add(command, 0, spawn, crash);
  add(obstacles, 0, host::obstacles(1, {{1, schema::Shape::box, {0.5f, 5, 5}, pose_at(2.85, 0, 1)}}), crash);
  for (uint64_t k = 1; k <= 8; ++k) {
    add(poses, 0, host::poses(k, {{"c0", pose_at(0.2 * double(k)), {14, 0, 0}, {0, 0, 1}, k / 2, 0.4f}}), crash);
    if (k == 6) add(keyframe, 0, {}, crash);
    put(end_of_tick, 0, {}, crash);
  }
  add(command, 0, host::repair(0.5f), crash);
  put(end_of_tick, 0, {}, crash);
  add(command, 0, host::despawn(), crash);

  using Shape = schema::Shape;
  const std::vector<schema::Vec3> corners = {{-1, -1, -1}, {1, -1, -1}, {0, 1, -1}, {0, 0, 1}, {0.2f, 0.1f, 0.3f}};
  add(command, 0, spawn, shapes);
  add(command, 2, host::spawn(coarse_asset, "h1", pose_at(0, 8), 900), shapes);
  add(obstacles, 0,
      host::obstacles(1, {{1, Shape::sphere, {0.6f, 0, 0}, pose_at(2.6, 0.2, 0.5), {-9, 0, 0}},
                          {2, Shape::capsule, {0.3f, 1, 0}, pose_at(2.5, 8, 1), {-9, 0, 0}, 0},
                          {3, Shape::half_space, {0, 0, 0}, pose_at(0, 0, 0.02)}}),
      shapes);
  add(obstacles, 1, host::obstacles(1, {{1, Shape::hull, {0, 0, 0}, pose_at(-3, 8, 1), {7, 0, 0}, 1, corners}}), shapes);
  for (int k = 0; k < 4; ++k) put(end_of_tick, 0, {}, shapes);

  add(command, 0, spawn, states);
  add(command, 0, host::parameters([](auto& p) {
        p.add_iterations(3);
        p.add_substeps(2);
        p.add_region(0);
        p.add_yield_strain(0.02f);
        p.add_drag(1e4f);
      }),
      states);
  add(command, 0, host::parameters([](auto& p) { p.add_solver(schema::Solver::classic); }), states);
  add(command, 0, host::save(), states);
  DeformableState body = make_body(fine_car()->model);
  body.node[0].x() += 0.3f;
  body.hardening[1] = 0.2f;
  add(command, 0, host::load(encode_state(fine_asset, body)), states);
  add(command, 0, host::load(encode_state(coarse_asset, make_body(coarse_car()->model))), states);
  add(command, 0, host::replace(coarse_asset), states);
  const std::string key = "car/c2";
  std::vector<uint8_t> free(key.begin(), key.end());
  free.insert(free.end(), input_of(spawn).begin(), input_of(spawn).end());
  put(named, uint8_t(key.size()), free, states);
  put(end_of_tick, 0, {}, states);

  add(asset, 0, host::asset(*uploaded_car()), given);
  add(command, 0, host::spawn(uploaded_asset, "h0"), given);
  add(obstacles, 0, host::obstacles(1, {{1, Shape::sphere, {0.6f, 0, 0}, pose_at(2.6, 0.2, 0.5), {-9, 0, 0}}}), given);
  for (int k = 0; k < 3; ++k) put(end_of_tick, 0, {}, given);
  return {crash, shapes, states, given};
}

}  // namespace crumple::fuzz

#include "fuzz/small_world.h"

#include <algorithm>
#include <cstring>

#include "box_car.h"
#include "recording/recording.h"
#include "schema/message_generated.h"
#include "tick/budget.h"
#include "tick/hash.h"
#include "tick/levels.h"
#include "tick/snapshot.h"
#include "tick/state.h"
#include "tick/uploads.h"
#include "viewer/surface.h"

namespace crumple::fuzz {
namespace {

constexpr BoxCells cell{1, 1, 1}, cells{2, 1, 1};

void replace(std::string_view from, std::string_view to, std::span<std::byte> in) {
  std::string_view text(reinterpret_cast<const char*>(in.data()), in.size());
  for (size_t at = 0; (at = text.find(from, at)) != text.npos; at += to.size()) std::memcpy(&in[at], to.data(), to.size());
}

template <class Table>
bool verifies(const Bytes& bytes) {
  flatbuffers::Verifier verifier(reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size());
  return verifier.VerifyBuffer<Table>(nullptr);
}

bool is_what_readers_take(const Message& message) {
  if (message.failed || (message.ticket != 0 && channel_of(message.key) != Channel::keyframe))
    return verifies<schema::Answer>(message.bytes);
  viewer::Surface none;
  switch (channel_of(message.key)) {
    case Channel::keyframe:
      return viewer::apply_keyframe(input_of(message.bytes), none).applied == viewer::Applied::whole;
    case Channel::delta:
      return viewer::apply_delta(input_of(message.bytes), none).applied == viewer::Applied::missing_keyframe;
    case Channel::reactions:
      return verifies<schema::Reactions>(message.bytes);
    default:
      return false;
  }
}

void expect_sound(const World& world) {
  size_t cars = 0, obstacles = 0;
  for (const auto& [id, host] : world.hosts) {
    cars += host.cars;
    obstacles += host.obstacles;
  }
  expect(cars == world.cars.size() && obstacles == world.obstacles.size(), "hosts know what they have");
  for (const auto& [id, car] : world.cars) {
    const Motion& motion = car.motion;
    bool finite = motion.pose.position.allFinite() && motion.velocity.allFinite() && motion.angular_velocity.allFinite();
    for (const Vec3& node : car.body.node) finite = finite && node.allFinite();
    expect(finite, "numbers stay finite");
  }
}

}  // namespace

const std::shared_ptr<const Car>& fine_car() {
  static const auto car = read_car(box_car_bytes(cells, 1200, 4.5f, cell), "fine");
  return car;
}
const std::shared_ptr<const Car>& coarse_car() {
  static const auto car = read_car(box_car_bytes(cell, 1200, 4.5f, cell), "coarse");
  return car;
}

// This car has its own surface, so that it is no level of the others.
const std::shared_ptr<const Car>& uploaded_car() {
  static const auto car = read_car(box_car_bytes(cells, 1100, 4, cell), "given");
  return car;
}

Bytes with_assets(Input input) {
  Bytes bytes(bytes_of(input).begin(), bytes_of(input).end());
  replace(fine_asset, fine_car()->hash, bytes);
  replace(coarse_asset, coarse_car()->hash, bytes);
  replace(uploaded_asset, uploaded_car()->hash, bytes);
  return bytes;
}

std::vector<uint8_t> without_assets(std::span<const std::byte> from) {
  Bytes bytes(from.begin(), from.end());
  replace(fine_car()->hash, fine_asset, bytes);
  replace(coarse_car()->hash, coarse_asset, bytes);
  replace(uploaded_car()->hash, uploaded_asset, bytes);
  const Input out = input_of(bytes);
  return {out.begin(), out.end()};
}

WorldHandle small_world() {
  Limits limits;
  limits.cars = 4;
  limits.hosts = 3;
  WorldHandle world = make_world(60, 0.0005f, limits);
  for (const auto& car : {fine_car(), coarse_car()}) add_asset(*world, car);
  return world;
}

void advance(World& world, Inbox inbox) {
  inbox.push_back(budget_message(1));  // the fewest sweeps, whatever the cars ask for
  Outbox outbox;
  tick(world, inbox, outbox, 1);
  for (const Message& message : outbox) expect(is_what_readers_take(message), "readers take " + message.key);
  expect_sound(world);
}

void expect_saved(const World& world) {
  const WorldHandle copy = small_world();
  for (const auto& car : uploaded_cars(world)) expect(!upload(*copy, car), "a world has room for what another was given");
  load_world(save_world(world), *copy);
  expect(hash(*copy) == hash(world), "a world that was saved and loaded is the same");
}

}  // namespace crumple::fuzz

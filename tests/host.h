// Messages of a host for tests, written with the generated code of the schema; and a viewer on the client library.
#pragma once

#include <gtest/gtest.h>

#include <map>
#include <string>
#include <vector>

#include "schema/message_generated.h"
#include "tick/world.h"
#include "viewer/surface.h"
#include "wire/decode.h"

namespace crumple::host {

using Builder = flatbuffers::FlatBufferBuilder;

template <class Table>
Bytes done(Builder& builder, flatbuffers::Offset<Table> root) {
  builder.Finish(root);
  const auto* data = reinterpret_cast<const std::byte*>(builder.GetBufferPointer());
  return Bytes(data, data + builder.GetSize());
}

inline schema::Pose pose_at(double x, double y = 0, double z = 0) { return {{x, y, z}, {0, 0, 0, 1}}; }

struct CarPose {
  std::string car;
  schema::Pose pose = pose_at(0);
  schema::Vec3 velocity{0, 0, 0};
  schema::Vec3 angular_velocity{0, 0, 0};
  uint64_t seen = 0;
  float importance = 1;
};

inline Bytes poses(uint64_t sequence, const std::vector<CarPose>& cars, double time = 0) {
  Builder builder;
  std::vector<flatbuffers::Offset<schema::CarPose>> list;
  for (const CarPose& car : cars) {
    list.push_back(schema::CreateCarPoseDirect(builder, car.car.c_str(), &car.pose, &car.velocity, &car.angular_velocity,
                                               car.seen, car.importance));
  }
  return done(builder, schema::CreatePosesDirect(builder, sequence, time, &list));
}

struct Thing {
  uint32_t id = 1;
  schema::Shape shape = schema::Shape::box;
  schema::Vec3 size{0.5f, 5, 5};
  schema::Pose pose = pose_at(0);
  schema::Vec3 velocity{0, 0, 0};
  float friction = 0.3f;
  std::vector<schema::Vec3> points = {};
};

inline Bytes obstacles(uint64_t sequence, const std::vector<Thing>& things) {
  Builder builder;
  std::vector<flatbuffers::Offset<schema::Obstacle>> list;
  for (const Thing& thing : things) {
    const schema::Vec3 turn(0, 0, 0);
    list.push_back(schema::CreateObstacleDirect(builder, thing.id, thing.shape, &thing.size,
                                                thing.points.empty() ? nullptr : &thing.points, &thing.pose, &thing.velocity,
                                                &turn, thing.friction));
  }
  return done(builder, schema::CreateObstaclesDirect(builder, sequence, &list));
}

template <class Table>
Bytes command(Builder& builder, flatbuffers::Offset<Table> order) {
  return done(builder, schema::CreateCommand(builder, schema::OrderTraits<Table>::enum_value, order.Union()));
}

inline Bytes spawn(const std::string& asset, const std::string& owner, const schema::Pose& pose = pose_at(0), float mass = 0) {
  Builder builder;
  return command(builder, schema::CreateSpawnDirect(builder, asset.c_str(), owner.c_str(), &pose, mass));
}
inline Bytes replace(const std::string& asset) {
  Builder builder;
  return command(builder, schema::CreateReplaceDirect(builder, asset.c_str()));
}
inline Bytes asset(const Car& car) {
  Builder builder;
  const auto bytes = builder.CreateVector(reinterpret_cast<const uint8_t*>(car.bytes.data()), car.bytes.size());
  return done(builder, schema::CreateAsset(builder, bytes));
}
inline Bytes despawn() {
  Builder builder;
  return command(builder, schema::CreateDespawn(builder));
}
inline Bytes repair(float amount) {
  Builder builder;
  return command(builder, schema::CreateRepair(builder, amount));
}
inline Bytes save() {
  Builder builder;
  return command(builder, schema::CreateSave(builder));
}
inline Bytes load(const Bytes& state) {
  Builder builder;
  const std::vector<uint8_t> bytes(reinterpret_cast<const uint8_t*>(state.data()),
                                   reinterpret_cast<const uint8_t*>(state.data()) + state.size());
  return command(builder, schema::CreateLoadDirect(builder, &bytes));
}
// `fill` sets the fields: [](schema::ParametersBuilder& p) { p.add_yield_strain(0.1f); }
template <class Fill>
Bytes parameters(Fill fill) {
  Builder builder;
  schema::ParametersBuilder order(builder);
  fill(order);
  return command(builder, order.Finish());
}

template <class Table>
const Table* read_as(const Bytes& bytes) {
  const auto* data = reinterpret_cast<const uint8_t*>(bytes.data());
  flatbuffers::Verifier verifier(data, bytes.size());
  if (!verifier.VerifyBuffer<Table>(nullptr)) {
    ADD_FAILURE() << "a message of the server is malformed";
    return nullptr;
  }
  return flatbuffers::GetRoot<Table>(data);
}

// A viewer of one car on one surface level.
struct Viewer {
  viewer::Surface surface;
  std::string level = "0";

  const std::vector<int16_t>& key() const { return surface.key; }
  const std::vector<int16_t>& held() const { return surface.quanta; }
  void take_keyframe(const Bytes& bytes) { expect_taken(viewer::apply_keyframe(bytes_of(bytes), surface)); }
  void take_delta(const Bytes& bytes) { expect_taken(viewer::apply_delta(bytes_of(bytes), surface)); }
  void take(const Message& message) {
    if (message.key.ends_with("/key/" + level)) take_keyframe(message.bytes);
    if (message.key.ends_with("/delta/" + level)) take_delta(message.bytes);
  }

 private:
  static std::span<const uint8_t> bytes_of(const Bytes& bytes) {
    return {reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()};
  }
  static void expect_taken(const viewer::Outcome& outcome) {
    EXPECT_NE(outcome.applied, viewer::Applied::refused) << outcome.why;
  }
};

}  // namespace crumple::host

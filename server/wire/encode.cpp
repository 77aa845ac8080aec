#include "wire/encode.h"

#include "wire/state_fields.h"

namespace crumple {
namespace {

schema::Vec3 vec3(const Eigen::Vector3d& v) { return {float(v.x()), float(v.y()), float(v.z())}; }

schema::Pose wire_pose(const Pose& pose) {
  const Eigen::Quaterniond& q = pose.orientation;
  return {{pose.position.x(), pose.position.y(), pose.position.z()}, {float(q.x()), float(q.y()), float(q.z()), float(q.w())}};
}

std::vector<flatbuffers::Offset<schema::Count>> encode_counts(flatbuffers::FlatBufferBuilder& builder,
                                                              const std::vector<HealthReport::Count>& counts) {
  std::vector<flatbuffers::Offset<schema::Count>> out;
  for (const auto& count : counts)
    out.push_back(schema::CreateCountDirect(builder, count.name.c_str(), count.value, count.limit));
  return out;
}

using Builder = flatbuffers::FlatBufferBuilder;
flatbuffers::uoffset_t write_list(Builder& builder, const std::vector<Vec3>& list) {
  static_assert(sizeof(schema::Vec3) == sizeof(Vec3));
  return builder.CreateVectorOfStructs(reinterpret_cast<const schema::Vec3*>(list.data()), list.size()).o;
}
flatbuffers::uoffset_t write_list(Builder& builder, const std::vector<Gradients>& list) {
  static_assert(sizeof(Gradients) == 9 * sizeof(float));
  return builder.CreateVector(reinterpret_cast<const float*>(list.data()), 9 * list.size()).o;
}
flatbuffers::uoffset_t write_list(Builder& builder, const std::vector<float>& list) { return builder.CreateVector(list).o; }

template <class List>
void add_list(schema::StateBuilder& state, void (schema::StateBuilder::*add)(flatbuffers::Offset<List>),
              flatbuffers::uoffset_t list) {
  (state.*add)(flatbuffers::Offset<List>(list));
}

}  // namespace

Bytes encode_reactions(uint64_t tick, double time, const std::vector<CarReaction>& reactions) {
  flatbuffers::FlatBufferBuilder builder;
  std::vector<flatbuffers::Offset<schema::Reaction>> cars;
  for (const CarReaction& reaction : reactions) {
    const auto car = builder.CreateString(reaction.car);
    std::vector<flatbuffers::Offset<schema::Partner>> partners;
    for (const CarReaction::Partner& each : reaction.partners) {
      const auto given = vec3(each.impulse);
      partners.push_back(schema::CreatePartnerDirect(builder, each.car.c_str(), each.host.c_str(), &given, each.contacts));
    }
    // Absent if there are none: then the message has the bytes that it had before there were partners.
    const auto partner_list = partners.empty() ? 0 : builder.CreateVector(partners);
    const auto impulse = vec3(reaction.result.impulse), angular_impulse = vec3(reaction.result.angular_impulse);
    const auto velocity = vec3(reaction.motion.velocity), angular_velocity = vec3(reaction.motion.angular_velocity);
    const auto pose = wire_pose(reaction.motion.pose);
    cars.push_back(schema::CreateReaction(builder, car, &impulse, &angular_impulse, &pose, &velocity, &angular_velocity,
                                          reaction.absorbed, reaction.stored, reaction.result.deepest, reaction.result.contacts,
                                          partner_list));
  }
  const auto list = builder.CreateVector(cars);
  return finish(builder, schema::CreateReactions(builder, tick, time, list));
}

Bytes encode_answer(uint64_t tick, const std::optional<Refusal>& refusal, const Bytes& state) {
  flatbuffers::FlatBufferBuilder builder(state.size() + 256);
  const auto sentence = refusal ? builder.CreateString(refusal->sentence) : flatbuffers::Offset<flatbuffers::String>();
  const auto bytes = state.empty() ? flatbuffers::Offset<flatbuffers::Vector<uint8_t>>()
                                   : builder.CreateVector(reinterpret_cast<const uint8_t*>(state.data()), state.size());
  return finish(builder, schema::CreateAnswer(builder, !refusal, sentence, tick, bytes));
}

Bytes encode_state(const std::string& asset, const DeformableState& body) {
  flatbuffers::FlatBufferBuilder builder(body.node.size() * 12 + body.gradients.size() * 44 + body.edge_rest.size() * 4 + 256);
  const auto name = builder.CreateString(asset);
  std::vector<flatbuffers::uoffset_t> lists;
  for_each_saved_field([&](auto field, auto, auto) {
    if constexpr (requires { (body.*field).data(); }) lists.push_back(write_list(builder, body.*field));
  });
  schema::StateBuilder state(builder);
  state.add_asset(name);
  size_t next = 0;
  for_each_saved_field([&](auto field, auto, auto add) {
    if constexpr (requires { (body.*field).data(); }) {
      add_list(state, add, lists[next++]);
    } else {
      (state.*add)(body.*field);
    }
  });
  return finish(builder, state.Finish());
}

Bytes encode_tick_end(const TickEnd& end) {
  flatbuffers::FlatBufferBuilder builder(64);
  return finish(builder, schema::CreateTickEnd(builder, end.tick, end.hash, end.lost_inputs, end.lost_outputs, end.inputs));
}

Bytes encode_budget(uint64_t work) {
  flatbuffers::FlatBufferBuilder builder(64);
  return finish(builder, schema::CreateBudget(builder, work));
}

Bytes encode_health(const HealthReport& report) {
  flatbuffers::FlatBufferBuilder builder;
  std::vector<flatbuffers::Offset<schema::Room>> rooms;
  for (const auto& room : report.rooms) {
    rooms.push_back(schema::CreateRoomDirect(builder, room.name.c_str(), float(1e3 * room.mean), float(1e3 * room.worst)));
  }
  const auto counts = encode_counts(builder, report.counts), refusals = encode_counts(builder, report.refusals);
  std::vector<flatbuffers::Offset<schema::CarTold>> told;
  for (const auto& car : report.told) told.push_back(schema::CreateCarToldDirect(builder, car.car.c_str(), &car.ticks));
  return finish(builder, schema::CreateHealthDirect(builder, report.tick, float(report.rate), report.late, &rooms, &counts,
                                                    &refusals, &told));
}

}  // namespace crumple

#include "wire/encode.h"

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

}  // namespace

Bytes encode_reactions(uint64_t tick, double time, const std::vector<CarReaction>& reactions) {
  flatbuffers::FlatBufferBuilder builder;
  std::vector<flatbuffers::Offset<schema::Reaction>> cars;
  for (const CarReaction& reaction : reactions) {
    const auto car = builder.CreateString(reaction.car);
    const auto impulse = vec3(reaction.response.impulse), angular_impulse = vec3(reaction.response.angular_impulse);
    const auto velocity = vec3(reaction.motion.velocity), angular_velocity = vec3(reaction.motion.angular_velocity);
    const auto pose = wire_pose(reaction.motion.pose);
    cars.push_back(schema::CreateReaction(builder, car, &impulse, &angular_impulse, &pose, &velocity, &angular_velocity,
                                          reaction.absorbed, reaction.stored, reaction.response.deepest,
                                          reaction.response.contacts));
  }
  const auto list = builder.CreateVector(cars);
  return finish(builder, schema::CreateReactions(builder, tick, time, list));
}

Bytes encode_answer(uint64_t tick, const Verdict& refusal, const Bytes& state) {
  flatbuffers::FlatBufferBuilder builder(state.size() + 256);
  const auto sentence = refusal ? builder.CreateString(refusal->sentence) : flatbuffers::Offset<flatbuffers::String>();
  const auto bytes = state.empty() ? flatbuffers::Offset<flatbuffers::Vector<uint8_t>>()
                                   : builder.CreateVector(reinterpret_cast<const uint8_t*>(state.data()), state.size());
  return finish(builder, schema::CreateAnswer(builder, !refusal, sentence, tick, bytes));
}

Bytes encode_state(const std::string& asset, const Body& body) {
  static_assert(sizeof(schema::Vec3) == sizeof(Vec3) && sizeof(Gradients) == 9 * sizeof(float));
  flatbuffers::FlatBufferBuilder builder(body.node.size() * 12 + body.gradients.size() * 44 + body.edge_rest.size() * 4 + 256);
  const auto name = builder.CreateString(asset);
  const auto node = builder.CreateVectorOfStructs(reinterpret_cast<const schema::Vec3*>(body.node.data()), body.node.size());
  const auto gradients = builder.CreateVector(reinterpret_cast<const float*>(body.gradients.data()), 9 * body.gradients.size());
  const auto hardening = builder.CreateVector(body.hardening);
  const auto edge_rest = builder.CreateVector(body.edge_rest);
  const auto tet_rest = builder.CreateVector(body.tet_rest);
  return finish(builder, schema::CreateState(builder, name, node, gradients, hardening, edge_rest, tet_rest, body.absorbed,
                                             body.stored, body.settled));
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

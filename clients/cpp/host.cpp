// The host's side of a session makes messages of structs. It already refuses what the server would refuse for its form, and
// names the field.
#include <cmath>
#include <limits>

#include "cpp/session.h"
#include "protocol/key.h"
#include "schema/message_generated.h"

using namespace crumple::client;
namespace schema = crumple::schema;

namespace {

bool finite(const float* values, size_t count) {
  for (size_t i = 0; i < count; ++i)
    if (!std::isfinite(values[i])) return false;
  return true;
}

bool good_pose(const CrumplePose& pose) {
  for (const double p : pose.position)
    if (!std::isfinite(p)) return false;
  double square = 0;
  for (const float q : pose.orientation) square += double{q} * q;
  return std::abs(std::sqrt(square) - 1) < 1e-3;
}

int refuse_pose(const std::string& whose) {
  return fail(CRUMPLE_BAD_ARGUMENT, "the pose of " + whose + " is not finite, or its orientation is not a unit quaternion");
}

schema::Vec3 vector_of(const float* v) { return {v[0], v[1], v[2]}; }

schema::Pose pose_of(const CrumplePose& pose) {
  const double* p = pose.position;
  const float* q = pose.orientation;
  return {schema::Vec3d(p[0], p[1], p[2]), schema::Quat(q[0], q[1], q[2], q[3])};
}

int put(Crumple& session, const char* what, const flatbuffers::FlatBufferBuilder& builder) {
  if (!session.net) return fail(CRUMPLE_CLOSED, no_network);
  if (session.host.empty()) return fail(CRUMPLE_BAD_ARGUMENT, "this session has no host id: give options.host to crumple_open");
  const std::string key = session.root + "host/" + session.host + "/" + what;
  // A bad line impairs poses only: obstacles are sent once, and no real line loses them for good.
  const bool lossy = std::string_view(what) == "poses";
  if (lossy && impair(session.impaired, true, key, {builder.GetBufferPointer(), builder.GetSize()})) return CRUMPLE_OK;
  const int status = net_put(session.net, key.c_str(), builder.GetBufferPointer(), builder.GetSize(), NET_REAL_TIME);
  if (status == TRANSPORT_DROPPED) return fail(CRUMPLE_DROPPED, transport_error());
  return status == 0 ? CRUMPLE_OK : fail(CRUMPLE_CLOSED, transport_error());
}

int order(Crumple& session, const char* car, schema::Order kind, flatbuffers::Offset<void> body,
          flatbuffers::FlatBufferBuilder& builder, uint64_t* ticket) {
  if (!session.net) return fail(CRUMPLE_CLOSED, no_network);
  if (!is_id(car)) return fail(CRUMPLE_BAD_ARGUMENT, "car is not an id: give 1 to 32 characters of a-z A-Z 0-9 _ -");
  builder.Finish(schema::CreateCommand(builder, kind, body));
  const std::string key = session.root + "car/" + car;
  const auto timeout = static_cast<uint32_t>(session.timeout.count());
  if (net_get(session.net, key.c_str(), builder.GetBufferPointer(), builder.GetSize(), timeout, ticket) != 0)
    return fail(CRUMPLE_CLOSED, transport_error());
  session.answers[*ticket] = {};
  while (session.answers.size() > answers_kept) session.answers.erase(session.answers.begin());
  return CRUMPLE_OK;
}

int find_answer(Crumple& session, uint64_t ticket, CrumpleAnswer* out) {
  const auto at = session.answers.find(ticket);
  if (at == session.answers.end()) return fail(CRUMPLE_UNKNOWN, "the ticket belongs to none of the last 256 commands");
  const CommandAnswer& answer = at->second;
  if (!answer.arrived) return CRUMPLE_PENDING;
  *out = {answer.ok, answer.tick, answer.sentence.c_str(), answer.state.data(), answer.state.size()};
  return CRUMPLE_OK;
}

}  // namespace

CrumpleParameters crumple_keep(void) {
  const float keep = std::numeric_limits<float>::quiet_NaN();
  return {-1, 0, 0, keep, -1, keep, keep, keep, keep, keep, keep, keep, keep, keep, keep, keep, keep, keep};
}

int crumple_spawn(Crumple* handle, const char* car, const char* asset, const CrumpleSpawn* spawn, uint64_t* ticket) {
  return with(handle, {{"car", car}, {"asset", asset}, {"spawn", spawn}, {"ticket", ticket}}, [&](Crumple* session) -> int {
    if (!crumple::is_hash(asset)) return fail(CRUMPLE_BAD_ARGUMENT, "asset is not a hash: give 16 hexadecimal digits");
    if (session->host.empty())
      return fail(CRUMPLE_BAD_ARGUMENT, "this session has no host id: give options.host to crumple_open");
    if (!good_pose(spawn->pose)) return refuse_pose(car);
    flatbuffers::FlatBufferBuilder builder;
    const schema::Pose pose = pose_of(spawn->pose);
    const schema::Vec3 inertia = vector_of(spawn->inertia), center = vector_of(spawn->center_of_mass);
    const auto any = [](const float(&v)[3]) { return v[0] != 0 || v[1] != 0 || v[2] != 0; };
    const auto body = schema::CreateSpawnDirect(builder, asset, session->host.c_str(), &pose, spawn->mass,
                                                any(spawn->inertia) ? &inertia : nullptr,
                                                any(spawn->center_of_mass) ? &center : nullptr, spawn->planar != 0);
    return order(*session, car, schema::Order::Spawn, body.Union(), builder, ticket);
  });
}

int crumple_despawn(Crumple* handle, const char* car, uint64_t* ticket) {
  return with(handle, {{"car", car}, {"ticket", ticket}}, [&](Crumple* session) -> int {
    flatbuffers::FlatBufferBuilder builder;
    return order(*session, car, schema::Order::Despawn, schema::CreateDespawn(builder).Union(), builder, ticket);
  });
}

int crumple_repair(Crumple* handle, const char* car, float amount, uint64_t* ticket) {
  return with(handle, {{"car", car}, {"ticket", ticket}}, [&](Crumple* session) -> int {
    flatbuffers::FlatBufferBuilder builder;
    return order(*session, car, schema::Order::Repair, schema::CreateRepair(builder, amount).Union(), builder, ticket);
  });
}

int crumple_set_parameters(Crumple* handle, const char* car, const CrumpleParameters* parameters, uint64_t* ticket) {
  return with(handle, {{"car", car}, {"parameters", parameters}, {"ticket", ticket}}, [&](Crumple* session) -> int {
    if (parameters->iterations > 65535) return fail(CRUMPLE_BAD_ARGUMENT, "iterations is over 65535");
    if (parameters->substeps > 65535) return fail(CRUMPLE_BAD_ARGUMENT, "substeps is over 65535");
    if (parameters->region < -1 || parameters->region > 127) return fail(CRUMPLE_BAD_ARGUMENT, "region is not in [-1, 127]");
    if (parameters->solver < -1 || parameters->solver > 1) return fail(CRUMPLE_BAD_ARGUMENT, "solver is not -1, 0 or 1");
    flatbuffers::FlatBufferBuilder builder;
    schema::ParametersBuilder to(builder);
    if (parameters->solver >= 0) to.add_solver(static_cast<schema::Solver>(parameters->solver));
    if (parameters->iterations) to.add_iterations(static_cast<uint16_t>(parameters->iterations));
    if (parameters->substeps) to.add_substeps(static_cast<uint16_t>(parameters->substeps));
    to.add_region(static_cast<int8_t>(parameters->region));
    const auto add = [&](float value, auto setter) {
      if (!std::isnan(value)) (to.*setter)(value);
    };
    using To = schema::ParametersBuilder;
    add(parameters->young_modulus, &To::add_young_modulus);
    add(parameters->poisson_ratio, &To::add_poisson_ratio);
    add(parameters->yield_strain, &To::add_yield_strain);
    add(parameters->hardening, &To::add_hardening);
    add(parameters->hardening_strain, &To::add_hardening_strain);
    add(parameters->densification, &To::add_densification);
    add(parameters->densification_strain, &To::add_densification_strain);
    add(parameters->plastic_limit, &To::add_plastic_limit);
    add(parameters->drag, &To::add_drag);
    add(parameters->friction, &To::add_friction);
    add(parameters->distance_stiffness, &To::add_distance_stiffness);
    add(parameters->volume_stiffness, &To::add_volume_stiffness);
    add(parameters->plasticity, &To::add_plasticity);
    add(parameters->tolerance, &To::add_tolerance);
    return order(*session, car, schema::Order::Parameters, to.Finish().Union(), builder, ticket);
  });
}

int crumple_save(Crumple* handle, const char* car, uint64_t* ticket) {
  return with(handle, {{"car", car}, {"ticket", ticket}}, [&](Crumple* session) -> int {
    flatbuffers::FlatBufferBuilder builder;
    return order(*session, car, schema::Order::Save, schema::CreateSave(builder).Union(), builder, ticket);
  });
}

int crumple_load(Crumple* handle, const char* car, const void* state, size_t size, uint64_t* ticket) {
  return with(handle, {{"car", car}, {"state", state}, {"ticket", ticket}}, [&](Crumple* session) -> int {
    if (size > message_limit) return fail(CRUMPLE_BAD_ARGUMENT, "the state is over 64 MiB");
    flatbuffers::FlatBufferBuilder builder;
    const auto bytes = builder.CreateVector(static_cast<const uint8_t*>(state), size);
    return order(*session, car, schema::Order::Load, schema::CreateLoad(builder, bytes).Union(), builder, ticket);
  });
}

int crumple_answer(Crumple* handle, uint64_t ticket, CrumpleAnswer* out) {
  return with(handle, {{"out", out}}, [&](Crumple* session) { return find_answer(*session, ticket, out); });
}

int crumple_wait(Crumple* handle, uint64_t ticket, CrumpleAnswer* out) {
  return with(handle, {{"out", out}}, [&](Crumple* session) -> int {
    // A little longer than the query itself, because its end brings the sentence that the caller should get.
    const auto deadline = Clock::now() + session->timeout + std::chrono::seconds(1);
    for (;;) {
      const int status = find_answer(*session, ticket, out);
      if (status != CRUMPLE_PENDING) return status;
      const auto left = std::chrono::duration_cast<std::chrono::microseconds>(deadline - Clock::now());
      if (left.count() <= 0) return fail(CRUMPLE_NO_ANSWER, "the server did not answer within the timeout of the session");
      if (const int got = poll(session, static_cast<uint64_t>(left.count())); got < 0) return got;
    }
  });
}

int crumple_publish_poses(Crumple* handle, double time, const CrumpleCarPose* cars, size_t count) {
  return with(handle, {}, [&](Crumple* session) -> int {
    if (count > 0 && !not_null({{"cars", cars}})) return CRUMPLE_BAD_ARGUMENT;
    if (count > list_limit) return fail(CRUMPLE_BAD_ARGUMENT, "there are over 10000 poses");
    flatbuffers::FlatBufferBuilder builder;
    std::vector<flatbuffers::Offset<schema::CarPose>> list;
    for (size_t i = 0; i < count; ++i) {
      const CrumpleCarPose& car = cars[i];
      if (!is_id(car.car))
        return fail(CRUMPLE_BAD_ARGUMENT, "car of a pose is not an id: give 1 to 32 characters of a-z A-Z 0-9 _ -");
      if (!good_pose(car.pose)) return refuse_pose(car.car);
      if (!finite(car.velocity, 3) || !finite(car.angular_velocity, 3))
        return fail(CRUMPLE_BAD_ARGUMENT, std::string("the velocity of ") + car.car + " is not finite");
      const schema::Pose pose = pose_of(car.pose);
      const schema::Vec3 velocity = vector_of(car.velocity), turn = vector_of(car.angular_velocity);
      const float importance = car.importance == 0 ? 1 : car.importance;
      list.push_back(schema::CreateCarPoseDirect(builder, car.car, &pose, &velocity, &turn, car.seen, importance));
    }
    builder.Finish(schema::CreatePosesDirect(builder, ++session->sequence, time, &list));
    return put(*session, "poses", builder);
  });
}

int crumple_publish_obstacles(Crumple* handle, const CrumpleObstacle* obstacles, size_t count) {
  return with(handle, {}, [&](Crumple* session) -> int {
    if (count > 0 && !not_null({{"obstacles", obstacles}})) return CRUMPLE_BAD_ARGUMENT;
    if (count > list_limit) return fail(CRUMPLE_BAD_ARGUMENT, "there are over 10000 obstacles");
    size_t left = point_limit;
    flatbuffers::FlatBufferBuilder builder;
    std::vector<flatbuffers::Offset<schema::Obstacle>> list;
    for (size_t i = 0; i < count; ++i) {
      const CrumpleObstacle& from = obstacles[i];
      if (from.shape < CRUMPLE_BOX || from.shape > CRUMPLE_HULL)
        return fail(CRUMPLE_BAD_ARGUMENT, "shape is not a CrumpleShape");
      if (!good_pose(from.pose)) return refuse_pose("obstacle " + std::to_string(from.id));
      const schema::Pose pose = pose_of(from.pose);
      const schema::Vec3 size = vector_of(from.size), velocity = vector_of(from.velocity),
                         turn = vector_of(from.angular_velocity);
      if (from.point_count > 0 && !not_null({{"points of an obstacle", from.points}})) return CRUMPLE_BAD_ARGUMENT;
      if (from.point_count > left) return fail(CRUMPLE_BAD_ARGUMENT, "the hulls have over 100000 points together");
      left -= from.point_count;
      std::vector<schema::Vec3> points;
      for (size_t k = 0; k < from.point_count; ++k) points.push_back(vector_of(from.points + 3 * k));
      list.push_back(schema::CreateObstacleDirect(builder, from.id, static_cast<schema::Shape>(from.shape), &size, &points,
                                                  &pose, &velocity, &turn, from.friction));
    }
    builder.Finish(schema::CreateObstaclesDirect(builder, ++session->sequence, &list));
    session->obstacles.assign(builder.GetBufferPointer(), builder.GetBufferPointer() + builder.GetSize());
    return put(*session, "obstacles", builder);
  });
}

size_t crumple_take_reactions(Crumple* handle, CrumpleReaction* out, size_t capacity) {
  size_t count = 0;
  with(handle, {}, [&](Crumple* session) {
    if (capacity > 0 && !not_null({{"out", out}})) return CRUMPLE_BAD_ARGUMENT;
    session->partners.clear();
    for (; count < capacity && !session->reactions.empty(); ++count) {
      auto& [reaction, partners] = session->reactions.front();
      out[count] = reaction;
      if (!partners.empty()) out[count].partners = session->partners.emplace_back(std::move(partners)).data();
      session->reactions.pop_front();
    }
    return CRUMPLE_OK;
  });
  return count;
}

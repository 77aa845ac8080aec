// Fuzzes everything that a session of the client library receives: samples, replies and tokens, in any order.
#define XXH_INLINE_ALL
#include <xxhash.h>

#include <memory>

#include "cpp/session.h"
#include "fuzz/small_world.h"
#include "fuzz/surface.h"
#include "protocol/surface_codec.h"
#include "schema/message_generated.h"
#include "wire/encode.h"

namespace crumple::fuzz {
namespace {

enum Kind : uint8_t { keyframe, delta, health, reactions, alive, gone, answer, keyframe_reply, asset, end, named, kinds };
constexpr uint64_t answer_ticket = 1, keyframe_ticket = 2, asset_ticket = 3;

const std::string root = "crumple/1/main/";

// which: bit 0: the car; bit 1, for surfaces: the hash is corrected; bit 7: the reply is an error.
NetEvent event_of(const Part& part, std::string& key) {
  NetEvent event{};
  event.data = part.bytes.data();
  event.size = part.bytes.size();
  const std::string car = part.which & 1 ? "car/c1" : "car/c0";
  const auto sample = [&](const std::string& below) { key = root + below; };
  const auto reply = [&](uint64_t ticket) {
    event.kind = NET_REPLY;
    event.ticket = ticket;
    event.failed = part.which >> 7;
  };
  switch (part.kind % kinds) {
    case keyframe:
      sample(car + "/key/0");
      break;
    case delta:
      sample(car + "/delta/0");
      break;
    case health:
      sample("health");
      break;
    case reactions:
      sample("host/h0/reactions");
      break;
    case alive:
      event.kind = NET_ALIVE;
      sample(part.which & 2 ? "server" : car);
      break;
    case gone:
      event.kind = NET_GONE;
      sample(part.which & 2 ? "server" : car);
      break;
    case answer:
      reply(answer_ticket);
      break;
    case keyframe_reply:
      reply(keyframe_ticket);
      break;
    case asset:
      reply(asset_ticket);
      break;
    case end:
      event.kind = NET_REPLY_END;
      event.ticket = 1 + part.which % 4;
      break;
    default: {  // any key, then the bytes
      const size_t split = std::min<size_t>(8 * (part.which / 8), part.bytes.size());
      sample({part.bytes.begin(), part.bytes.begin() + ptrdiff_t(split)});
      key = key.substr(0, key.find('\0'));
      event.data += split;
      event.size -= split;
    }
  }
  event.key = key.c_str();
  return event;
}

// Calls the functions that show the result to the caller.
void look(Crumple* handle, const Crumple& session) {
  const char* ids[64];
  const size_t count = std::min<size_t>(64, crumple_cars(handle, ids, 64));
  std::vector<float> position(3 * 4096), normal(3 * 4096);
  for (size_t i = 0; i < count; ++i) {
    CrumpleSurface surface;
    if (crumple_surface(handle, ids[i], &surface) == CRUMPLE_OK)
      expect(XXH64(surface.quanta, 6 * size_t{surface.node_count}, 0) == surface.hash, "a surface has its hash");
    CrumpleVertices vertices{position.data(), nullptr, normal.data(), 12, 4096, i % 2 ? 0 : 0.05, 0, 0, 0, nullptr};
    crumple_copy(handle, ids[i], &vertices);
    expect(vertices.first + vertices.count <= 4096, "what changed is in the buffer");
  }
  for (const auto& [hash, held] : std::map(session.assets.begin(), session.assets.end())) {
    CrumpleMesh mesh;
    if (crumple_mesh(handle, hash.c_str(), &mesh) != CRUMPLE_OK) continue;
    for (size_t i = 0; i < 3 * size_t{mesh.triangle_count}; ++i)
      expect(mesh.triangle[i] < mesh.vertex_count, "triangles name vertices that are there");
  }
  CrumpleReaction reaction;
  while (crumple_take_reactions(handle, &reaction, 1) == 1) expect(client::is_id(reaction.car), "reactions name cars");
  CrumpleHealth told;
  crumple_health(handle, &told);
  CrumpleAnswer answered;
  crumple_answer(handle, answer_ticket, &answered);
}

}  // namespace

bool client_run(Input input) {
  const CrumpleOptions options{CRUMPLE_CLIENT_VERSION, 0, nullptr, "main", nullptr, nullptr};  // its queries fail
  Crumple* handle = nullptr;
  expect(crumple_open(&options, &handle) == CRUMPLE_OK, "a session without a network can be opened");
  const std::unique_ptr<Crumple, void (*)(Crumple*)> closer(handle, crumple_close);
  Crumple& session = *client::find(handle);
  session.following.level = 0;
  for (Part& part : parts_of(input)) {
    const uint8_t kind = part.kind % kinds;
    if (part.which & 2 && (kind == keyframe || kind == delta || kind == keyframe_reply)) {
      const viewer::FollowedCar& car = session.following.cars[part.which & 1 && kind != keyframe_reply ? "c1" : "c0"];
      fit_hash(kind != delta, car.fresh && kind != delta ? car.coming : car.surface, part.bytes);
    }
    session.answers[answer_ticket];
    session.following.questions[keyframe_ticket] = {"c0", false};
    // The asset with these bytes: its name is their hash.
    char hash[17];
    std::snprintf(hash, sizeof hash, "%016llx",
                  static_cast<unsigned long long>(XXH64(part.bytes.data(), part.bytes.size(), 0)));
    if (kind == asset) session.fetching.tickets[asset_ticket] = hash;
    std::string key;
    client::take(session, event_of(part, key));
  }
  look(handle, session);
  return session.statistics.refused == 0;
}

std::vector<std::vector<uint8_t>> client_seeds() {
  std::vector<uint8_t> seen, asked;
  const Car& car = *coarse_car();
  viewer::Quanta key(3 * car.skin_node.size(), 5), later(key);
  later[4] = 90;
  const auto add = [](uint8_t kind, const Bytes& bytes, std::vector<uint8_t>& to) { put(kind, 0, input_of(bytes), to); };
  put(alive, 2, {}, seen);
  put(alive, 0, {}, seen);
  add(keyframe, encode_keyframe({3, car.hash, 0.0005f}, key).at(0), seen);
  add(delta, encode_delta({4, car.hash, 0.0005f}, later, 3, key).at(0), seen);
  CarReaction reaction;
  reaction.car = "c0";
  add(reactions, encode_reactions(4, 0.1, {reaction, reaction}), seen);
  add(health, encode_health({4, 60, 1, {{"tick", 0.001, 0.002}}, {{"cars", 1, 9}}, {{"malformed", 2, 0}}, {{"c0", {9, 6}}}}),
      seen);
  put(gone, 0, {}, seen);
  add(answer, encode_answer(3, Refusal{Reason::malformed, "a sentence"}), asked);
  add(answer, encode_answer(3, std::nullopt, Bytes(5)), asked);
  put(answer, 128, std::vector<uint8_t>{'n', 'o'}, asked);
  add(keyframe_reply, encode_keyframe({3, car.hash, 0.0005f}, key).at(0), asked);
  put(asset, 0, input_of(car.bytes), asked);
  for (uint8_t ticket = 0; ticket < 3; ++ticket) put(end, ticket, {}, asked);
  const std::string odd = "car/car00007/key/0";
  std::vector<uint8_t> free(odd.begin(), odd.end());
  const Bytes bytes = encode_keyframe({3, car.hash, 0.0005f}, key).at(0);
  free.insert(free.end(), input_of(bytes).begin(), input_of(bytes).end());
  put(named, uint8_t(odd.size()), free, asked);
  return {seen, asked};
}

}  // namespace crumple::fuzz

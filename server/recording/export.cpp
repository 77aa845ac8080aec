// Reads the recording once. Surfaces are decoded as viewers do it (keyframes and deltas of level 0). A car's pose is the host's
// intent, or the reaction in ticks that have one. A frame is the state after the first tick in its time, or after a tick in
// which a car appears. Frames in which nothing changed are left out.
#include "recording/export.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <map>
#include <optional>
#include <sstream>
#include <stdexcept>

#include "io/files.h"
#include "io/obj.h"
#include "recording/gltf.h"
#include "recording/recording.h"
#include "schema/message_generated.h"
#include "viewer/parts.h"
#include "viewer/surface.h"
#include "wire/decode.h"

namespace crumple {
namespace {

struct Shown {  // one car, as long as it keeps its asset
  std::string name;
  std::shared_ptr<const Car> car;
  std::vector<std::array<uint32_t, 4>> at;  // per vertex: indices of its four nodes among the skin's nodes
  std::vector<viewer::Point> rest;          // of the skin's nodes
  std::vector<viewer::NodesAround> around;  // of each part
  float quantum = 0;
  std::vector<viewer::Quanta> shapes;  // shapes that differ from rest and from the previous one
  viewer::Quanta last;                 // the shape of the last key
  std::vector<Animation::Key> keys;
  double from = 0;  // s: time of the first frame
};

struct Actor {
  viewer::Surface surface;
  std::string host;
  Pose pose;
  std::optional<SpawnOrder> spawning;  // spawn command without an answer yet
  std::optional<Shown> shown;
  int assets = 0;  // number of assets shown so far
};

struct Export {
  explicit Export(const ExportOptions& o) : options(o), file(o.file) { row.precision(9); }
  const ExportOptions& options;
  RecordingReader file;
  std::map<std::string, Actor, std::less<>> actors;  // by car
  std::optional<FileWriter> csv;                     // reactions.csv
  std::ostringstream row;                            // the line of reactions.csv being made
  double frame_time = 0;                             // time of the previous frame, s
  bool appeared = false;                             // a car appeared in this tick: show it before more happens to it
  size_t objs = 0, glbs = 0, reactions = 0;

  std::string path(const std::string& name) const { return (std::filesystem::path(options.folder) / name).string(); }
};

std::span<const std::byte> bytes_of(const RecordingReader::Item& item) {
  return {reinterpret_cast<const std::byte*>(item.bytes.data()), item.bytes.size()};
}

void take_input(const RecordingReader::Item& item, Export& out) {
  const Limits& limits = out.file.head().limits;
  const std::string_view id = parse_key(item.key).value_or(Key{}).id;
  if (item.channel == Channel::command) {
    Order order;
    if (decode(bytes_of(item), limits, order)) return;
    if (const auto* spawn = std::get_if<SpawnOrder>(&order)) out.actors[std::string(id)].spawning = *spawn;
  } else if (item.channel == Channel::poses) {
    Intents intents;
    if (decode(bytes_of(item), limits, intents)) return;
    for (const Intent& intent : intents.cars) {
      const auto at = out.actors.find(intent.car);
      if (at != out.actors.end() && at->second.host == id) at->second.pose = intent.motion.pose;
    }
  }
}

void take_answer(const RecordingReader::Item& item, Export& out) {
  const auto at = out.actors.find(item.key.substr(4, item.key.find('/', 4) - 4));
  if (at == out.actors.end() || !at->second.spawning) return;
  flatbuffers::Verifier verifier(item.bytes.data(), item.bytes.size());
  if (verifier.VerifyBuffer<schema::Answer>(nullptr) && flatbuffers::GetRoot<schema::Answer>(item.bytes.data())->ok()) {
    at->second.host = at->second.spawning->host;
    at->second.pose = at->second.spawning->pose;
  }
  at->second.spawning.reset();
}

void take_reactions(const RecordingReader::Item& item, Export& out) {
  flatbuffers::Verifier verifier(item.bytes.data(), item.bytes.size());
  if (!verifier.VerifyBuffer<schema::Reactions>(nullptr)) return;
  const auto* message = flatbuffers::GetRoot<schema::Reactions>(item.bytes.data());
  for (const schema::Reaction* r : *message->cars()) {
    const auto& position = r->pose()->position();
    const auto& turn = r->pose()->orientation();
    Pose& pose = out.actors[r->car()->str()].pose;
    pose.position = {position.x(), position.y(), position.z()};
    pose.orientation = Eigen::Quaterniond(turn.w(), turn.x(), turn.y(), turn.z());
    out.row.str({});
    out.row << message->tick() << ',' << static_cast<double>(message->tick()) / out.file.head().rate << ',' << r->car()->str();
    for (const double x : {position.x(), position.y(), position.z()}) out.row << ',' << x;
    for (const schema::Vec3* v : {r->velocity(), r->angular_velocity(), r->impulse(), r->angular_impulse()})
      out.row << ',' << v->x() << ',' << v->y() << ',' << v->z();
    out.row << ',' << r->energy_absorbed() << ',' << r->energy_stored() << ',' << r->deepest() << ',' << r->contacts() << '\n';
    out.csv->put(out.row.view());
    ++out.reactions;
  }
}

void take(const RecordingReader::Item& item, Export& out) {
  if (is_input(item.channel)) return take_input(item, out);
  if (item.channel == Channel::answer) return take_answer(item, out);
  if (item.channel == Channel::reactions) return take_reactions(item, out);
  if ((item.channel != Channel::keyframe && item.channel != Channel::delta) || item.level != 0) return;
  Actor& actor = out.actors[std::string(item.key.substr(4, item.key.find('/', 4) - 4))];
  viewer::Surface& surface = actor.surface;
  out.appeared |= !actor.shown;
  const auto [applied, why] = item.channel == Channel::keyframe ? viewer::apply_keyframe(item.bytes, surface)
                                                                : viewer::apply_delta(item.bytes, surface);
  if (applied == viewer::Applied::refused)
    throw std::runtime_error(out.options.file + ": tick " + std::to_string(item.tick) + ": " + why);
}

// The same computation as in a viewer (crumple_copy).
std::vector<Vec3> displacement(const Shown& shown, const viewer::Quanta& quanta) {
  std::vector<Vec3> out(shown.at.size());
  for (size_t v = 0; v < out.size(); ++v) {
    Vec3 sum = Vec3::Zero();
    for (size_t k = 0; k < 4; ++k) {
      const int16_t* node = &quanta[size_t{3} * shown.at[v][k]];
      sum += shown.car->model.skin[v].weight[k] * Vec3(float(node[0]), float(node[1]), float(node[2]));
    }
    out[v] = shown.quantum * sum;
  }
  const Parts& parts = shown.car->parts;
  const std::vector<float> moved(quanta.begin(), quanta.end());
  for (size_t k = 0; k < parts.part.size(); ++k) {
    if (parts.part[k].kind != schema::PartKind::wheel) continue;
    const viewer::Motion motion = viewer::motion_of(shown.around[k], shown.rest, moved, shown.quantum);
    for (size_t v = 0; v < out.size(); ++v) {
      if (parts.of_vertex[v] != k) continue;
      const Vec3& rest = shown.car->model.vertex[v];
      const viewer::Point by = motion.displacement({rest.x(), rest.y(), rest.z()});
      out[v] = {by[0], by[1], by[2]};
    }
  }
  return out;
}

Shown begin(const std::string& id, Actor& actor, double time, const Export& out) {
  Shown shown;
  shown.name = ++actor.assets == 1 ? id : id + "-" + std::to_string(actor.assets);
  shown.from = time;
  shown.quantum = actor.surface.quantum;
  for (const auto& car : out.file.cars())
    if (car->hash == actor.surface.asset) shown.car = car;
  if (!shown.car)
    throw std::runtime_error(out.options.file + ": car " + id + " has asset " + actor.surface.asset +
                             ", and the file does not contain this baked car");
  const auto& nodes = shown.car->skin_node;
  for (const Skin& skin : shown.car->model.skin) {
    auto& at = shown.at.emplace_back();
    for (size_t k = 0; k < 4; ++k)
      if (skin.weight[k] > 0)
        at[k] = static_cast<uint32_t>(std::lower_bound(nodes.begin(), nodes.end(), skin.node[k]) - nodes.begin());
  }
  for (uint32_t i : nodes) {
    const Vec3& node = shown.car->model.node[i];
    shown.rest.push_back({node.x(), node.y(), node.z()});
  }
  for (const Part& part : shown.car->parts.part) shown.around.push_back(viewer::nodes_around(part, shown.rest));
  return shown;
}

// What a triangle looks like: as the car says, else as the kind of its part.
struct Shading {
  std::vector<Look> look;
  std::vector<size_t> of_triangle;
};

Shading shading_of(const Car& car) {
  using schema::PartKind;
  Shading out{{{"paint", {0.55f, 0.07f, 0.06f, 1}, 0.1f, 0.4f},
               {"glass", {0.01f, 0.02f, 0.03f, 0.45f}, 0.3f, 0.05f},
               {"light", {0.9f, 0.84f, 0.64f, 1}, 0.1f, 0.15f},
               {"wheel", {0.011f, 0.011f, 0.013f, 1}, 0, 0.85f},
               {"interior", {0.044f, 0.037f, 0.034f, 1}, 0, 0.9f}},
              {}};
  const size_t kinds = out.look.size();
  out.look.insert(out.look.end(), car.looks.look.begin(), car.looks.look.end());
  for (size_t t = 0; t < car.model.triangle.size() / 3; ++t) {
    const uint8_t look = car.looks.of_triangle.empty() ? no_look : car.looks.of_triangle[t];
    const PartKind kind =
        car.parts.of_vertex.empty() ? PartKind::body : car.parts.part[car.parts.of_vertex[car.model.triangle[3 * t]]].kind;
    const size_t by_kind = kind == PartKind::glass      ? 1
                           : kind == PartKind::light    ? 2
                           : kind == PartKind::wheel    ? 3
                           : kind == PartKind::interior ? 4
                                                        : 0;
    out.of_triangle.push_back(look == no_look ? by_kind : kinds + look);
  }
  return out;
}

void end(Actor& actor, Export& out) {
  const Shown& shown = *actor.shown;
  Animation animation;
  animation.name = shown.name;
  animation.copyright = shown.car->attribution;
  animation.vertex = shown.car->model.vertex;
  const Shading shading = shading_of(*shown.car);
  std::vector<uint32_t> triangle;
  for (size_t look = 0; look < shading.look.size(); ++look) {
    const size_t first = triangle.size();
    for (size_t t = 0; t < shading.of_triangle.size(); ++t) {
      const auto corner = shown.car->model.triangle.begin() + std::ptrdiff_t(3 * t);
      if (shading.of_triangle[t] == look) triangle.insert(triangle.end(), corner, corner + 3);
    }
    if (triangle.size() > first) animation.groups.push_back({first, shading.look[look]});
  }
  animation.triangle = triangle;
  animation.shapes = shown.shapes.size();
  animation.displacement = [&](size_t i) { return displacement(shown, shown.shapes[i]); };
  animation.keys = shown.keys;
  write_glb(out.path(shown.name + ".glb"), animation);
  ++out.glbs;
  actor.shown.reset();
}

void show(const std::string& id, Actor& actor, uint64_t tick, double time, Export& out) {
  const viewer::Surface& surface = actor.surface;
  if (surface.quanta.empty()) return;
  if (actor.shown && actor.shown->car->hash != surface.asset) end(actor, out);
  const bool first = !actor.shown;
  if (first) actor.shown = begin(id, actor, time, out);
  Shown& shown = *actor.shown;
  if (surface.quanta.size() != 3 * shown.car->skin_node.size())
    throw std::runtime_error(out.options.file + ": tick " + std::to_string(tick) + ": the surface of car " + id +
                             " and the skin of its asset have different numbers of nodes");
  const bool changed = first || shown.last != surface.quanta;
  Animation::Key key{time - shown.from, actor.pose, first ? 0 : shown.keys.back().shape};
  if (changed) {
    shown.last = surface.quanta;
    const bool rest = std::all_of(shown.last.begin(), shown.last.end(), [](int16_t q) { return q == 0; });
    if (!rest) shown.shapes.push_back(shown.last);
    key.shape = rest ? 0 : shown.shapes.size();
    const std::vector<Vec3> moved = displacement(shown, shown.last);
    const Model& model = shown.car->model;
    char name[32];
    std::snprintf(name, sizeof name, "_%06llu.obj", static_cast<unsigned long long>(tick));
    write_obj(out.path(shown.name + name), shown.car->attribution, id, tick,
              {model.vertex.data()->data(), 3 * model.vertex.size()}, {moved.data()->data(), 3 * moved.size()}, model.triangle);
    ++out.objs;
  }
  if (!first) {
    const Animation::Key& before = shown.keys.back();
    if (!changed && before.pose.position == key.pose.position &&
        before.pose.orientation.coeffs() == key.pose.orientation.coeffs())
      return;
    // The car stood still until the previous frame.
    if (out.frame_time - shown.from > before.time)
      shown.keys.push_back({out.frame_time - shown.from, before.pose, before.shape});
  }
  shown.keys.push_back(key);
}

}  // namespace

int export_recording(const ExportOptions& options) {
  Export out(options);
  std::error_code trouble;
  std::filesystem::create_directories(options.folder, trouble);
  if (trouble)
    throw std::runtime_error(options.folder + ": cannot be made (" + trouble.message() + "): give -o another folder");
  out.csv.emplace(out.path("reactions.csv"));
  out.csv->put(
      "tick,time_s,car,x_m,y_m,z_m,velocity_x_m_s,velocity_y_m_s,velocity_z_m_s,angular_velocity_x_rad_s,"
      "angular_velocity_y_rad_s,angular_velocity_z_rad_s,impulse_x_N_s,impulse_y_N_s,impulse_z_N_s,angular_impulse_x_N_m_s,"
      "angular_impulse_y_N_m_s,angular_impulse_z_N_m_s,energy_absorbed_J,energy_stored_J,deepest_m,contacts\n");
  const double rate = out.file.head().rate;
  uint64_t tick = 0, shown_tick = 0;
  double frame = -1;
  const auto show_all = [&] {
    const double time = static_cast<double>(tick) / rate;
    for (auto& [id, actor] : out.actors) show(id, actor, tick, time, out);
    out.frame_time = time;
    shown_tick = tick;
  };
  for (RecordingReader::Item item; out.file.next(item);) {
    take(item, out);
    if (item.channel != Channel::tick_end) continue;
    tick = item.tick;
    const double now = std::floor(static_cast<double>(tick) / rate * options.fps);
    if (now > frame || out.appeared) show_all();
    frame = now;
    out.appeared = false;
  }
  if (tick > shown_tick) show_all();  // always show the end
  for (auto& [id, actor] : out.actors)
    if (actor.shown) end(actor, out);
  out.csv->finish();
  std::printf("%s: %zu GLB, %zu OBJ, %zu reactions of %llu ticks%s\n", options.folder.c_str(), out.glbs, out.objs,
              out.reactions, static_cast<unsigned long long>(tick),
              out.file.cut() ? "; the file was cut off, exported up to its end" : "");
  return 0;
}

}  // namespace crumple

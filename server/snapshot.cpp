// One list of fields, walked in two directions. Numbers stand as this machine has them: whoever reads them runs the same
// program.
#include "snapshot.h"

#include <cstring>
#include <stdexcept>

#include "state.h"

namespace crumple {
namespace {

constexpr uint32_t format = 2;  // to be counted up with every change of a field below

class Writer {
 public:
  static constexpr bool reads = false;
  std::vector<std::byte> bytes;
  void raw(const void* data, size_t size) {
    const auto* begin = static_cast<const std::byte*>(data);
    bytes.insert(bytes.end(), begin, begin + size);
  }
  template <class List>
  void resize(List& list) {
    const uint64_t size = list.size();
    raw(&size, sizeof size);
  }
};

class Reader {
 public:
  static constexpr bool reads = true;
  explicit Reader(std::span<const std::byte> bytes) : left(bytes) {}
  std::span<const std::byte> left;
  void raw(void* data, size_t size) {
    if (size > left.size()) throw std::runtime_error("the snapshot of the world is cut off or damaged");
    if (size > 0) std::memcpy(data, left.data(), size);  // an empty list has no address
    left = left.subspan(size);
  }
  template <class List>
  void resize(List& list) {
    uint64_t size = 0;
    raw(&size, sizeof size);
    // Not more than could be in the rest: damage must not ask for memory.
    if (size > left.size()) throw std::runtime_error("the snapshot of the world is cut off or damaged");
    list.resize(size);
  }
};

template <class File, class Number>
requires std::is_arithmetic_v<Number> || std::is_enum_v<Number>
void field(File& file, Number& value) { file.raw(&value, sizeof value); }
template <class File>
void field(File& file, bool& value) {
  uint8_t number = value;
  file.raw(&number, sizeof number);
  value = number != 0;  // damage may be any number
}
template <class File, int Rows>
void field(File& file, Eigen::Matrix<float, Rows, 1>& v) {
  file.raw(v.data(), sizeof(float) * Rows);
}
template <class File>
void field(File& file, Eigen::Vector3d& v) {
  file.raw(v.data(), 3 * sizeof(double));
}
template <class File>
void field(File& file, std::string& text) {
  file.resize(text);
  file.raw(text.data(), text.size());
}
// Of numbers without padding.
template <class File, class Number>
void field(File& file, std::vector<Number>& list) {
  file.resize(list);
  file.raw(static_cast<void*>(list.data()), list.size() * sizeof(Number));
}
template <class File>
void field(File& file, std::optional<uint64_t>& value) {
  uint8_t there = value.has_value();
  field(file, there);
  if (there && !value) value = 0;
  if (there) field(file, *value);
}
template <class File, class... Fields>
requires(sizeof...(Fields) > 1) void field(File& file, Fields&... each) { (field(file, each), ...); }

template <class File>
void field(File& file, Pose& pose) {
  field(file, pose.position);
  file.raw(pose.orientation.coeffs().data(), 4 * sizeof(double));
}
template <class File>
void field(File& file, Motion& motion) {
  field(file, motion.pose, motion.velocity, motion.angular_velocity);
}
template <class File>
void field(File& file, Parameters& parameters) {
  static_assert(sizeof(Material) == 9 * sizeof(float));
  field(file, parameters.solver, parameters.iterations, parameters.tolerance, parameters.substeps);
  file.raw(parameters.region.data(), sizeof parameters.region);
}
template <class File>
void field(File& file, History& history) {
  field(file, history.count, history.next);
  for (auto& list : history.residual) field(file, list);
  for (auto& list : history.result) field(file, list);
  file.raw(history.products.data(), sizeof history.products);
}
template <class File>
void field(File& file, Body& body) {
  field(file, body.node, body.step, body.step_seconds, body.gradients, body.hardening, body.edge_rest, body.tet_rest);
  field(file, body.history);
  field(file, body.absorbed, body.stored, body.owed, body.reach, body.low, body.high, body.force, body.moment);
  field(file, body.touching, body.drift, body.lost, body.settled);
}
template <class File>
void field(File& file, Told& told) {
  field(file, told.keyframe, told.latest, told.tick, told.keyframe_tick, told.due, told.flowing);
}
template <class File>
void field(File& file, Obstacle& obstacle) {
  field(file, obstacle.faces, obstacle.half_length, obstacle.radius, obstacle.reach, obstacle.friction);
  field(file, obstacle.pose, obstacle.velocity, obstacle.angular_velocity);
}

// Without levels and body.
template <class File>
void field(File& file, Instance& car) {
  field(file, car.level_tick, car.importance, car.host, car.mass.mass, car.mass.inertia, car.mass.center, car.mass.planar);
  field(file, car.parameters, car.motion);
  for (ImpulseLog::Change& change : car.log.changes) field(file, change.tick, change.velocity, change.angular_velocity);
  field(file, car.touched_tick, car.sweeps, car.substeps, car.fresh);
  for (uint64_t& hash : car.hashes) field(file, hash);
  for (Told& told : car.told) field(file, told);
  field(file, car.response.sweeps, car.response.substeps, car.response.work, car.response.residual);
}

// What the sizes of a body's lists must be, and whether its history can be gone on with: no sum covers that one's lists.
void check(const Model& model, const Instance& car) {
  const Body& body = car.body;
  const auto fits = [&](size_t size, size_t wanted) { return size == 0 || size == wanted; };
  bool good = hash(body) == car.hashes[0] && body.node.size() == model.node.size() && fits(body.step.size(), model.node.size());
  good &= body.gradients.size() == model.tet.size() && body.hardening.size() == model.tet.size();
  good &= body.tet_rest.size() == model.tet.size() && body.edge_rest.size() == model.edge.size();
  const History& history = body.history;
  good &= history.count >= 0 && history.count <= mixing_depth && history.next >= 0 && history.next < mixing_depth;
  for (int k = 0; good && k < history.count; ++k) {
    const size_t size = history.residual[size_t(k)].size();
    good &= size == history.residual[0].size() && size == history.result[size_t(k)].size() && size >= model.node.size();
  }
  for (const Told& told : car.told) {
    good &= fits(told.keyframe.size(), 3 * car.levels->front()->skin_node.size());
    good &= fits(told.latest.size(), 3 * car.levels->front()->skin_node.size());
  }
  if (!good) throw std::runtime_error("the snapshot of the world is damaged: a body does not fit its car");
}

const Levels& levels_of(const World& world, const std::string& asset) {
  const auto found = world.assets.find(asset);
  if (found == world.assets.end())
    throw std::runtime_error("the snapshot of the world has a car of asset " + asset + ": give its file to --car here too");
  return found->second;
}

// hash of a body as baked, by asset.
using Pristine = std::map<std::string, uint64_t>;

void save(Writer& file, const std::string& id, Instance& car, Pristine& pristine) {
  std::string name = id, shown = car.levels->front()->hash, level = car.car->hash;
  field(file, name, shown, level);
  field(file, car);
  auto found = pristine.find(level);
  if (found == pristine.end()) found = pristine.emplace(level, hash(make_body(car.car->model))).first;
  bool damaged = car.hashes[0] != found->second;
  field(file, damaged);
  if (damaged) field(file, car.body);
}

void load(Reader& file, World& world) {
  std::string id, shown, level;
  field(file, id, shown, level);
  Instance& car = world.cars[id];
  car.levels = &levels_of(world, shown);
  car.car = levels_of(world, level).front();
  const bool is_level =
      std::any_of(car.levels->begin(), car.levels->end(), [&](const auto& each) { return each->hash == level; });
  if (!is_level) throw std::runtime_error("the snapshot of the world is damaged: car " + id + " is on a level of another car");
  field(file, car);
  bool damaged = false;
  field(file, damaged);
  car.body = make_body(car.car->model);
  if (damaged) field(file, car.body);
  check(car.car->model, car);
}

// tick, budget, hosts and obstacles.
template <class File>
void field(File& file, World& world) {
  field(file, world.tick, world.budget);
  uint64_t hosts = world.hosts.size();
  field(file, hosts);
  auto at = world.hosts.begin();
  for (uint64_t k = 0; k < hosts; ++k) {
    std::string id;
    if constexpr (!File::reads) id = at->first;
    field(file, id);
    if constexpr (File::reads) at = world.hosts.try_emplace(id).first;
    Host& host = at->second;
    field(file, host.poses_sequence, host.obstacles_sequence, host.cars, host.obstacles);
    ++at;
  }
  file.resize(world.obstacles);
  for (Obstacle& obstacle : world.obstacles) field(file, obstacle);
}

void clear(World& world) {
  world.cars.clear();
  world.hosts.clear();
  world.obstacles.clear();
  world.tick = world.budget = 0;
}

}  // namespace

std::vector<std::byte> save_world(const World& of) {
  World& world = const_cast<World&>(of);  // the list of fields serves both directions; this one only reads
  Writer file;
  uint32_t version = format;
  uint64_t cars = world.cars.size(), sum = hash(world);
  field(file, version, world.rate, world.quantum, sum);
  field(file, world);
  field(file, cars);
  Pristine pristine;
  for (auto& [id, car] : world.cars) save(file, id, car, pristine);
  return std::move(file.bytes);
}

void load_world(std::span<const std::byte> bytes, World& world) {
  clear(world);
  try {
    Reader file(bytes);
    uint32_t version = 0;
    double rate = 0;
    float quantum = 0;
    uint64_t cars = 0, sum = 0;
    field(file, version);
    if (version != format)
      throw std::runtime_error("the snapshot of the world is of another version of crumple: use the same on both sides");
    field(file, rate, quantum, sum);
    if (rate != world.rate || quantum != world.quantum)
      throw std::runtime_error("the snapshot of the world has another rate or quantum: give --rate " + std::to_string(rate) +
                               " --quantum " + std::to_string(1e3f * quantum) + " here too");
    field(file, world);
    field(file, cars);
    for (uint64_t k = 0; k < cars; ++k) load(file, world);
    if (!file.left.empty() || hash(world) != sum)
      throw std::runtime_error("the snapshot of the world is damaged: its sum does not match");
  } catch (...) {
    clear(world);
    throw;
  }
}

}  // namespace crumple

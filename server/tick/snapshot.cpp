// Numbers are written in this machine's format: only the same program reads them.
#include "tick/snapshot.h"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <stdexcept>

#include "tick/fields.h"
#include "tick/uploads.h"
#include "wire/check.h"

namespace crumple {
namespace {

constexpr uint32_t format = 10;                      // increase it with every change of a field
constexpr uint64_t latest_tick = uint64_t{1} << 53;  // the largest tick that a double holds exactly

[[noreturn]] void refuse(const std::string& fact) { throw std::runtime_error("the snapshot of the world is damaged: " + fact); }

class Writer {
 public:
  static constexpr bool reads = false, sums = false;
  std::vector<std::byte> bytes;
  void raw(const void* data, size_t size) {
    const auto* begin = static_cast<const std::byte*>(data);
    bytes.insert(bytes.end(), begin, begin + size);
  }
  template <class List>
  void resize(const List& list) {
    const uint64_t size = list.size();
    raw(&size, sizeof size);
  }
};

class Reader {
 public:
  static constexpr bool reads = true, sums = false;
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
    // Not more than the remaining bytes can hold: damaged bytes must not make us allocate memory.
    if (size > left.size() / sizeof(typename List::value_type))
      throw std::runtime_error("the snapshot of the world is cut off or damaged");
    list.resize(size);
  }
};

// ---- checks of what the next tick relies on ---------------------------------------------------------------------------------

bool finite(const Eigen::Vector3d& v) { return v.allFinite(); }
bool finite(const Pose& pose) { return finite(pose.position) && std::abs(pose.orientation.norm() - 1) < 1e-3; }
bool finite(const Motion& motion) { return finite(motion.pose) && finite(motion.velocity) && finite(motion.angular_velocity); }
template <class... Numbers>
bool not_negative(Numbers... numbers) {
  return ((std::isfinite(numbers) && numbers >= 0) && ...);
}

void check_id(const std::string& id) {
  const Limits limits;
  Checker checker{limits};
  (void)checker.id({"snapshot"}, "id", id);
  if (checker.refusal) refuse(checker.refusal->sentence);
}

void check(const World& world, const Instance& car) {
  if (!world.hosts.contains(car.host)) refuse("a car belongs to host " + car.host + ", but the snapshot has no such host");
  if (car.parameters.solver > Solver::classic) refuse("a car has neither of the two solvers");
  if (const auto sentence = out_of_range(car.parameters)) refuse(*sentence);
  const Mass& mass = car.mass;
  bool good = not_negative(car.importance) && car.importance <= 1 && finite(car.motion) && finite(mass.center);
  good = good && std::isfinite(mass.mass) && mass.mass > 0 && finite(mass.inertia) && mass.inertia.minCoeff() > 0;
  for (const ImpulseLog::Change& change : car.log.changes)
    good = good && finite(change.velocity) && finite(change.angular_velocity);
  const StepResult& last = car.result;  // the budget divides and doubles these numbers
  good = good && last.sweeps <= uint64_t{1000} * last.substeps && last.work <= uint64_t{max_tets} * last.sweeps;
  good = good && last.residual >= 0;
  const size_t shown = 3 * car.levels->front()->skin_node.size();
  for (const ViewerState& told : car.told) {
    good = good && told.keyframe.size() == shown && told.latest.size() == shown;
    good = good && told.keyframe_tick <= told.tick && told.tick <= world.tick;
  }
  if (!good) refuse("a number or a size of a car is out of its range");
}

void check(const World& world) {
  if (world.tick >= latest_tick) refuse("its tick " + std::to_string(world.tick) + " is too large");
  if (world.hosts.size() > world.limits.hosts || world.cars.size() > world.limits.cars) refuse("it has too many cars or hosts");
  std::map<std::string, uint64_t> cars;
  uint64_t obstacles = 0;
  for (const auto& [id, car] : world.cars) {
    check_id(id);
    check(world, car);
    // Unlike in a State any shape is good: a body that was torn apart is a part of the world too.
    if (refuse_fields(car.car->model, car.body, false)) refuse("a body does not fit its car");
    ++cars[car.host];
  }
  for (const auto& [id, host] : world.hosts) {
    check_id(id);
    if (host.cars != cars[id]) refuse("host " + id + " states another number of cars than it has");
    obstacles += host.obstacles;
  }
  if (obstacles != world.obstacles.size()) refuse("the hosts state another number of obstacles than they have");
  for (const Obstacle& obstacle : world.obstacles) {
    bool good = finite(obstacle.pose) && finite(obstacle.velocity) && finite(obstacle.angular_velocity);
    good = good && not_negative(obstacle.half_length, obstacle.radius, obstacle.friction) && obstacle.reach >= 0 &&
           obstacle.width >= 0;
    for (const Plane& face : obstacle.faces)
      good = good && std::abs(face.normal.norm() - 1) < 1e-3f && std::isfinite(face.offset);
    if (!good) refuse("a number of an obstacle is out of its range");
  }
}

const Levels& levels_of(const World& world, const std::string& asset) {
  const Levels* found = find_asset(world, asset);
  if (!found)
    throw std::runtime_error("the snapshot of the world has a car of asset " + asset + ": give its file to --car here too");
  return *found;
}

// Hash of the undamaged body, by asset.
using Pristine = std::map<std::string, uint64_t>;

void save(Writer& file, const std::string& id, const Instance& car, Pristine& pristine) {
  const std::string& level = car.car->hash;
  field(file, id, car.levels->front()->hash, level);
  field(file, car);
  auto found = pristine.find(level);
  if (found == pristine.end()) found = pristine.emplace(level, hash(make_body(car.car->model))).first;
  const bool damaged = car.hashes.body != found->second;
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
  if (!is_level) refuse("car " + id + " is on a level of another car");
  field(file, car);
  bool damaged = false;
  field(file, damaged);
  car.body = make_body(car.car->model);
  if (damaged) field(file, car.body);
  if (car.body.node.size() == car.car->model.node.size()) measure_reach(car.car->model, car.body);
  car.hashes.body = hash(car.body);
  car.hashes.log = hash(car.log);
  for (size_t k = 0; k < car.told.size(); ++k) {
    car.hashes.keyframe[k] = surface_hash(car.told[k].keyframe);
    car.hashes.latest[k] = surface_hash(car.told[k].latest);
  }
}

void clear(World& world) {
  world.cars.clear();
  world.hosts.clear();
  world.obstacles.clear();
  world.uploaded.clear();
  world.tick = world.budget = 0;
}

std::vector<std::string> assets_of(const World& world) {
  std::vector<std::string> hashes;
  for (const auto& [hash, levels] : world.assets) hashes.push_back(hash);
  return hashes;
}

uint64_t sum_of(std::span<const std::byte> bytes) { return XXH64(bytes.data(), bytes.size(), 0); }

}  // namespace

std::vector<std::byte> save_world(const World& world) {
  Writer file;
  uint64_t sum = 0;  // checksum of all bytes behind it
  field(file, format, world.rate, world.quantum, sum);
  const size_t begin = file.bytes.size();
  const std::vector<std::string> assets = assets_of(world);
  file.resize(assets);
  for (const std::string& asset : assets) field(file, asset);
  const uint64_t given = world.uploaded.size(), cars = world.cars.size();
  field(file, given);
  for (const Levels& levels : world.uploaded) {
    const std::vector<std::byte> bytes(levels.front()->bytes.begin(), levels.front()->bytes.end());
    field(file, bytes);
  }
  field(file, world);
  field(file, cars);
  Pristine pristine;
  for (const auto& [id, car] : world.cars) save(file, id, car, pristine);
  sum = sum_of(std::span(file.bytes).subspan(begin));
  std::memcpy(&file.bytes[begin - sizeof sum], &sum, sizeof sum);
  return std::move(file.bytes);
}

bool load_unsummed_world(std::span<const std::byte> bytes, World& world) {
  clear(world);
  try {
    Reader file(bytes);
    uint32_t version = 0;
    double rate = 0;
    float quantum = 0;
    uint64_t cars = 0, sum = 0;
    field(file, version);
    if (version != format)
      throw std::runtime_error("another version of crumple made the snapshot of the world: use the same version on both sides");
    field(file, rate, quantum, sum);
    if (rate != world.rate || quantum != world.quantum)
      throw std::runtime_error("the snapshot of the world has another rate or quantum: give --rate " + std::to_string(rate) +
                               " --quantum " + std::to_string(1e3f * quantum) + " here too");
    const bool right = sum_of(file.left) == sum;
    std::vector<std::string> assets;
    file.resize(assets);
    for (std::string& asset : assets) field(file, asset);
    std::sort(assets.begin(), assets.end());
    if (assets != assets_of(world))
      throw std::runtime_error(
          "the server that made the snapshot of the world has other cars: give the same files to --car here too");
    uint64_t given = 0;
    field(file, given);
    for (uint64_t k = 0; k < given; ++k) {
      std::vector<std::byte> car;
      field(file, car);
      if (upload(world, read_car(car, "the snapshot's asset"))) refuse("it has more uploaded cars than the limits allow");
    }
    field(file, world);
    field(file, cars);
    for (uint64_t k = 0; k < cars; ++k) load(file, world);
    if (!file.left.empty()) refuse("it does not end where it should");
    check(world);
    return right;
  } catch (...) {
    clear(world);
    throw;
  }
}

void load_world(std::span<const std::byte> bytes, World& world) {
  if (load_unsummed_world(bytes, world)) return;
  clear(world);
  refuse("its checksum does not match");
}

}  // namespace crumple

// Measures the thesis's deformation loop (6.3.3) and the parts that we added. All use one scene: the car has driven into a wall
// at 50 km/h for one tick of 1/60 s, so its front is crushed and pressed against the wall. Serial means one car on one thread.
// Parallel means one car on each thread, because the server gives whole cars to threads; the time is per car.
#include <tbb/parallel_for.h>

#include "rooms.h"
#include "sim/classic.h"
#include "sim/deform.h"
#include "sim/skin.h"
#include "tick/surface_update.h"

namespace crumple {
namespace {

constexpr double tick_seconds = 1.0 / 60;
constexpr double speed = 50 / 3.6;  // m/s

struct Scene {
  std::shared_ptr<const Car> car;
  Parameters parameters;
  Mass mass;
  std::vector<Obstacle> wall;
  DeformableState body;
  Motion motion;
};

// The data that one car needs for a tick.
struct Lane {
  DeformableState body;
  Motion motion;
  ScratchHandle scratch = make_scratch();
  ContactSet contacts;
  std::vector<Vec3> vertex;
  StepResult result;
};

Scene make_scene(const std::shared_ptr<const Car>& car) {
  const Model& model = car->model;
  Scene scene{car, {}, {model.mass, model.inertia.cast<double>(), model.center_of_mass.cast<double>()}, {}, make_body(model),
              {}};
  float front = model.node[0].x();
  for (const Vec3& node : model.node) front = std::max(front, node.x());
  scene.wall.resize(1);
  make_box({1, 5, 5}, scene.wall[0]);
  scene.wall[0].pose.position.x() = double(front) + 1;
  scene.motion.velocity.x() = speed;
  scene.parameters.iterations = 4;
  deform({model, scene.parameters, scene.mass, scene.wall, tick_seconds}, *make_scratch(), scene.body, scene.motion);
  scene.motion.velocity = Eigen::Vector3d(speed, 0, 0);  // restores the speed, which few sweeps would get wrong
  return scene;
}

// Created when the first benchmark of a car needs it.
const Scene& scene_of(const Bench& bench) {
  static std::string owner;
  static std::unique_ptr<const Scene> scene;
  if (owner != bench.name) {
    scene = std::make_unique<const Scene>(make_scene(bench.car));
    owner = bench.name;
  }
  return *scene;
}

void collide(const Scene& scene, Lane& lane) {
  const Pose to = advance(scene.motion, scene.mass, tick_seconds);
  const StepInput input{scene.car->model, scene.parameters, scene.mass, scene.wall, tick_seconds};
  find_candidates(input, lane.body, scene.motion, lane.contacts);
  find_contacts(lane.body, scene.wall, {scene.motion.pose, to, 0, tick_seconds}, lane.contacts);
}

std::vector<Lane> make_lanes(const Scene& scene, int count) {
  std::vector<Lane> lanes(count);
  for (Lane& lane : lanes) {
    lane.body = scene.body;
    lane.motion = scene.motion;
    lane.vertex.resize(scene.car->model.vertex.size());
    collide(scene, lane);
  }
  return lanes;
}

using Work = std::function<void(const Scene&, Lane&)>;

// Returns the seconds per lane of `work` on all lanes at once, with a thread for each.
double side_by_side(const Scene& scene, std::vector<Lane>& lanes, tbb::task_arena& arena, const Work& work) {
  if (lanes.size() == 1) return seconds_of([&] { work(scene, lanes[0]); }, thread_seconds);
  const auto all = [&] { tbb::parallel_for(size_t(0), lanes.size(), [&](size_t i) { work(scene, lanes[i]); }); };
  return seconds_of([&] { arena.execute(all); }) / double(lanes.size());
}

// changes: the work changes the body, so the benchmark restores the body before each run.
benchmark::internal::Benchmark* register_work(const std::shared_ptr<const Bench>& bench, const std::string& room, int threads,
                                              bool changes, const Work& work) {
  return register_room(room + "/" + bench->name + "/" + std::to_string(threads), [=](benchmark::State& state) {
    const Scene& scene = scene_of(*bench);
    std::vector<Lane> lanes = make_lanes(scene, threads);
    tbb::task_arena arena(threads);
    for (auto _ : state) {
      for (Lane& lane : lanes) {
        if (!changes) break;
        lane.body = scene.body;
        lane.motion = scene.motion;
      }
      state.SetIterationTime(side_by_side(scene, lanes, arena, work));
    }
    state.counters["contacts"] = double(lanes[0].contacts.contact.size());
  });
}

Work classic(int iterations) {
  return [iterations](const Scene& scene, Lane& lane) {
    Parameters parameters = scene.parameters;
    parameters.iterations = uint16_t(iterations);
    solve_classic(scene.car->model, parameters, lane.contacts.contact, lane.body);
  };
}

void update_skin(const Scene& scene, Lane& lane) { skin(scene.car->model, lane.body, lane.vertex); }

// A tick of `classic` as the server computes it: the three stages and the code between them.
void whole_loop(const Scene& scene, Lane& lane) {
  Parameters parameters = scene.parameters;
  parameters.solver = Solver::classic;
  parameters.iterations = 1;
  lane.result =
      deform({scene.car->model, parameters, scene.mass, scene.wall, tick_seconds}, *lane.scratch, lane.body, lane.motion);
  update_skin(scene, lane);
}

// Four sub-steps of `nodal`, with the time of each stage from the timer that also feeds the server's health.
class RoomTimes final : public Timer {
 public:
  std::array<double, 3> seconds{};
  void enter(SolveStage stage) override {
    stage_ = stage;
    start_ = thread_seconds();
  }
  void leave() override { seconds[size_t(stage_)] += thread_seconds() - start_; }

 private:
  SolveStage stage_ = SolveStage::contacts;
  double start_ = 0;
};

void register_nodal(const std::shared_ptr<const Bench>& bench, int sweeps) {
  register_room("nodal_" + std::to_string(sweeps) + "/" + bench->name, [bench, sweeps](benchmark::State& state) {
    const Scene& scene = scene_of(*bench);
    std::vector<Lane> lanes = make_lanes(scene, 1);
    Lane& lane = lanes[0];
    Parameters parameters = scene.parameters;
    parameters.iterations = uint16_t(sweeps);
    parameters.tolerance = 0;
    RoomTimes times;
    double substeps = 0;
    for (auto _ : state) {
      lane.body = scene.body;
      lane.motion = scene.motion;
      const double before = times.seconds[size_t(SolveStage::solve)];
      lane.result = deform({scene.car->model, parameters, scene.mass, scene.wall, 4 * substep_seconds(parameters)},
                           *lane.scratch, lane.body, lane.motion, &times);
      state.SetIterationTime(times.seconds[size_t(SolveStage::solve)] - before);
      substeps += lane.result.substeps;
    }
    const double milli = 1000 / std::max(1.0, substeps);  // ms in a sub-step
    state.counters["substeps"] = lane.result.substeps;
    state.counters["contacts_ms"] = times.seconds[size_t(SolveStage::contacts)] * milli;
    state.counters["flow_ms"] = times.seconds[size_t(SolveStage::flow)] * milli;
  });
}

// A tick with default parameters, including the surface.
void default_tick(const Scene& scene, Lane& lane) {
  lane.result = deform({scene.car->model, {}, scene.mass, scene.wall, tick_seconds}, *lane.scratch, lane.body, lane.motion);
  update_skin(scene, lane);
}

void register_messages(const std::shared_ptr<const Bench>& bench) {
  const auto add = [&](const std::string& room,
                       const std::function<std::vector<Bytes>(const SurfaceHead&, std::span<const int16_t>)>& encode) {
    register_room(room + "/" + bench->name, [bench, encode](benchmark::State& state) {
      const Scene& scene = scene_of(*bench);
      std::vector<Lane> lanes = make_lanes(scene, 1);
      const Model& model = bench->car->model;
      std::vector<Vec3> displaced(bench->car->skin_node.size());
      displace(model, lanes[0].body, bench->car->skin_node, displaced);
      std::vector<int16_t> displacement(3 * displaced.size());
      const SurfaceHead head{2, bench->car->hash, 0.5e-3f};
      size_t size = 0;
      for (auto _ : state) {
        std::vector<Bytes> parts;
        const auto tell = [&] {
          quantise(displaced, head.quantum, displacement);
          parts = encode(head, displacement);
        };
        state.SetIterationTime(seconds_of(tell, thread_seconds));
        size = 0;
        for (const Bytes& part : parts) size += part.size();
      }
      state.counters["bytes"] = double(size);
    });
  };
  const std::vector<int16_t> rest(3 * bench->car->skin_node.size(), 0);
  add("delta", [rest](const SurfaceHead& head, std::span<const int16_t> now) { return encode_delta(head, now, 1, rest); });
  add("keyframe", [](const SurfaceHead& head, std::span<const int16_t> now) { return encode_keyframe(head, now); });
}

}  // namespace

void register_loop(const std::shared_ptr<const Bench>& bench) {
  for (int threads : all_threads() > 1 ? std::vector{1, all_threads()} : std::vector{1}) {
    register_work(bench, "contacts", threads, false, collide);
    register_work(bench, "classic_1", threads, true, classic(1));
    register_work(bench, "update", threads, false, update_skin);
    register_work(bench, "loop", threads, true, whole_loop);
  }
  register_work(bench, "classic_5", 1, true, classic(5));
  register_nodal(bench, 2);
  register_nodal(bench, 6);
  register_messages(bench);
  register_work(bench, "tick", 1, true, default_tick)->Iterations(1)->Repetitions(1);  // half a minute at 50,000 nodes
}

}  // namespace crumple

#include "hostile.h"

#include <cstdio>
#include <stdexcept>

#include "bake/build_constraints.h"
#include "schema/car_generated.h"

namespace crumple {
namespace {

constexpr double pi = 3.14159265358979323846;

Parameters elastic_car() {
  Parameters parameters;
  for (Material& material : parameters.region) {
    material.yield_strain = 1;   // the strain of ten times the length is larger still,
    material.plastic_limit = 0;  // so no plastic strain is allowed
    material.plasticity = 1;
  }
  return parameters;
}

template <class Change>
Parameters with(Parameters parameters, const Change& change) {
  for (int r = 0; r < region_limit; ++r) change(r, parameters.region[r]);
  return parameters;
}

void displaced_starts(std::vector<Scene>& out) {
  using Start = std::function<void(Run&)>;
  const auto scaled = [](const Vec3& factor) -> Start {
    return [factor](Run& run) {
      const Vec3 middle = run.box.center();
      run.displace([&](const Vec3& p) -> Vec3 { return middle + factor.cwiseProduct(p - middle); });
    };
  };
  const Start random = [](Run& run) {
    run.displace([&](const Vec3&) -> Vec3 { return run.random.in(run.box.low, run.box.high); });
  };
  const Start twisted = [](Run& run) {
    const Vec3 middle = run.box.center();
    run.displace([&](const Vec3& p) -> Vec3 {
      const float angle = float(4 * pi) * (p.x() - middle.x()) / run.box.size().x();
      return middle + Eigen::AngleAxisf(angle, Vec3::UnitX()) * (p - middle);
    });
  };
  const Start nan = [](Run& run) {
    run.displace([](const Vec3& p) -> Vec3 { return p; });
    run.poisoned = true;
    for (size_t i = 0; i < run.body.node.size(); ++i) {
      if (run.model.node_anchored[i]) continue;
      run.body.node[i].setConstant(std::numeric_limits<float>::quiet_NaN());
      break;
    }
  };
  const std::pair<const char*, Start> starts[] = {
      {"all at a point", scaled({0, 0, 0})},
      {"on a plane", scaled({1, 1, 0})},
      {"on a line", scaled({1, 0, 0})},
      {"random in the box", random},
      {"mirrored", scaled({-1, 1, 1})},
      {"mirrored x 1.2", scaled({-1.2f, 1.2f, 1.2f})},
      {"stretched x 10", scaled({10, 1, 1})},
      {"twisted 720 degrees", twisted},
      {"one node at NaN", nan},
  };
  for (const bool plastic : {false, true}) {
    for (const auto& [name, start] : starts) {
      out.push_back({std::string(name) + (plastic ? ", plastic" : ", elastic"), plastic ? Parameters() : elastic_car(),
                     [plastic, start = start](Run& run) {
                       if (plastic) run.dent();
                       start(run);
                       run.release();
                     },
                     nullptr});
    }
  }
}

// Changes some baked arrays of the car in place and reads the result as any baked car.
template <class Change>
std::shared_ptr<const Car> changed_car(const Car& car, const Change& change) {
  std::vector<std::byte> bytes(car.bytes.begin(), car.bytes.end());
  const auto writable = [&]<class T>(std::span<const T> view) {
    const auto offset = reinterpret_cast<const std::byte*>(view.data()) - car.bytes.data();
    return std::span<T>(reinterpret_cast<T*>(bytes.data() + offset), view.size());
  };
  change(writable);
  const Balance all = balance(writable(car.model.node), writable(car.model.node_mass));
  const auto store = [](const schema::Vec3* at, const Eigen::Vector3d& v) {
    *const_cast<schema::Vec3*>(at) = {float(v.x()), float(v.y()), float(v.z())};
  };
  const schema::Car& file = *schema::GetCar(bytes.data());
  store(file.center_of_mass(), all.center);
  store(file.inertia(), all.inertia);
  return read_car(bytes, car.name);
}

// The quality of a tet: its volume relative to the cube of its rms edge length; 1 for a regular tet, 0 for a flat one.
double quality(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  double squares = 0;
  for (const Vec3& edge : {Vec3(b - a), Vec3(c - a), Vec3(d - a), Vec3(c - b), Vec3(d - b), Vec3(d - c)}) {
    squares += double(edge.squaredNorm());
  }
  return 6 * std::sqrt(2.0) * tet_volume(a, b, c, d) / std::pow(squares / 6, 1.5);
}

double quality(const TetMesh& mesh, uint32_t tet) {
  const uint32_t* n = mesh.tet[tet].node;
  return quality(mesh.node[n[0]], mesh.node[n[1]], mesh.node[n[2]], mesh.node[n[3]]);
}

// Flattens tets to the quality `worst` if their neighbours keep a better one, until one in fifty is a sliver. It moves one
// corner of a tet towards the middle of the opposite face. It moves each node and changes each tet at most once.
std::shared_ptr<const Car> sliver_car(const Car& car, double worst) {
  const Model& model = car.model;
  TetMesh mesh{{model.node.begin(), model.node.end()}, {model.tet.begin(), model.tet.end()}};
  std::vector<bool> used(mesh.tet.size());
  size_t made = 0;
  for (uint32_t tet = 0; tet < mesh.tet.size() && 50 * made < mesh.tet.size(); ++tet) {
    for (int corner = 0; corner < 4 && !used[tet]; ++corner) {
      const uint32_t node = mesh.tet[tet].node[corner];
      const std::span<const uint32_t> around =
          model.corner.subspan(model.node_first[node], model.node_first[node + 1] - model.node_first[node]);
      if (model.node_anchored[node] || std::any_of(around.begin(), around.end(), [&](uint32_t k) { return used[k / 4]; }))
        continue;
      const Vec3 rest = mesh.node[node];
      Vec3 face = Vec3::Zero();
      for (uint32_t other : mesh.tet[tet].node) face += other == node ? Vec3(Vec3::Zero()) : Vec3(mesh.node[other] / 3);
      double low = 0, high = 1;  // share of the height that remains
      for (int pass = 0; pass < 40; ++pass) {
        const double middle = 0.5 * (low + high);
        mesh.node[node] = face + float(middle) * (rest - face);
        (quality(mesh, tet) > worst ? high : low) = middle;
      }
      mesh.node[node] = face + float(high) * (rest - face);
      const bool fits =
          std::all_of(around.begin(), around.end(), [&](uint32_t k) { return quality(mesh, k / 4) >= 0.5 * worst; });
      if (!fits) {
        mesh.node[node] = rest;
        continue;
      }
      for (uint32_t k : around) used[k / 4] = true;
      ++made;
    }
  }
  if (made == 0) throw std::runtime_error(car.name + ": no tet of it can be flattened to a sliver; take a finer car.");
  const Constraints constraints = build_constraints(mesh);
  const Masses masses = lump_masses(mesh, constraints.tet_rest, double(model.mass));
  return changed_car(car, [&](const auto& writable) {
    std::copy(mesh.node.begin(), mesh.node.end(), writable(model.node).begin());
    std::copy(constraints.gradients.begin(), constraints.gradients.end(), writable(model.gradients).begin());
    std::copy(constraints.tet_rest.begin(), constraints.tet_rest.end(), writable(model.tet_rest).begin());
    std::copy(constraints.edge_rest.begin(), constraints.edge_rest.end(), writable(model.edge_rest).begin());
    std::copy(masses.node.begin(), masses.node.end(), writable(model.node_mass).begin());
  });
}

// Gives nodes masses from 1 to 10^6, with the same sum as before.
std::shared_ptr<const Car> unequal_car(const Car& car, uint64_t seed) {
  return changed_car(car, [&](const auto& writable) {
    Random random{std::mt19937_64(seed)};
    double sum = 0;
    std::vector<double> mass(car.model.node.size());
    for (double& each : mass) sum += each = random.logarithmic(1, 1e6);
    const auto stored = writable(car.model.node_mass);
    for (size_t i = 0; i < mass.size(); ++i) stored[i] = float(mass[i] / sum * double(car.model.mass));
  });
}

// Puts every other tet into region 1, so that two materials alternate through the body.
std::shared_ptr<const Car> mixed_car(const Car& car) {
  return changed_car(car, [&](const auto& writable) {
    const auto region = writable(car.model.tet_region);
    for (size_t t = 0; t < region.size(); ++t) region[t] = uint8_t(t % 2 && car.regions.size() > 1);
  });
}

void hostile_meshes_and_materials(const Car& car, uint64_t seed, std::vector<Scene>& out) {
  constexpr double depth = 0.2;
  const auto returns = [](Run& run) { run.push_in(depth); };
  const auto stays_dented = [](Run& run) {
    run.limit = depth;
    run.push_in(depth);
  };
  const Parameters elastic = elastic_car(), plastic;
  const auto sliver = sliver_car(car, 1e-4);
  out.push_back({"slivers of 1e-4, elastic", elastic, returns, sliver});
  out.push_back({"slivers of 1e-4, plastic", plastic, stays_dented, sliver});
  const auto modulus = [](const Parameters& from, float low, float high) {
    return with(from, [=](int region, Material& m) { m.young_modulus = region % 2 ? high : low; });
  };
  out.push_back({"modulus 1e4 Pa, elastic", modulus(elastic, 1e4f, 1e4f), returns, nullptr});
  out.push_back({"modulus 1e10 Pa, elastic", modulus(elastic, 1e10f, 1e10f), returns, nullptr});
  out.push_back({"modulus 1e4 beside 1e10 Pa, elastic", modulus(elastic, 1e4f, 1e10f), returns, mixed_car(car)});
  out.push_back({"stiffness 0 or Poisson 0, elastic",
                 with(elastic,
                      [](int, Material& m) {
                        m.distance_stiffness = m.volume_stiffness = 0;
                        m.poisson_ratio = 0;
                      }),
                 returns, nullptr});
  out.push_back({"Poisson 0.45, elastic", with(elastic, [](int, Material& m) { m.poisson_ratio = 0.45f; }), returns, nullptr});
  const auto flowing = [](float yield, float hardening, float limit, float kept) {
    return [=](int, Material& m) {
      m.yield_strain = yield;
      m.hardening = hardening;
      m.hardening_strain = 1000;
      m.densification = 0;
      m.plastic_limit = limit;
      m.plasticity = kept;
    };
  };
  out.push_back({"yield 0, no hardening, limit 3", with(plastic, flowing(0, 0, 3, 0)), stays_dented, nullptr});
  out.push_back({"yield 0, hardening 1", with(plastic, flowing(0, 1, 3, 0)), stays_dented, nullptr});
  const auto folding = [](float hardening_strain, float densification) {
    return [=](int, Material& m) {
      m.yield_strain = 0;
      m.hardening = 1;
      m.hardening_strain = hardening_strain;
      m.densification = densification;
      m.densification_strain = 0;
    };
  };
  out.push_back({"hardening done at a strain of 0.001, never dense", with(plastic, folding(1e-3f, 0)), stays_dented, nullptr});
  out.push_back({"densification 100 from the start", with(plastic, folding(1e3f, 100)), stays_dented, nullptr});
  out.push_back({"yield 0, limit 0", with(plastic, flowing(0, 0, 0, 1)), returns, nullptr});
  out.push_back({"masses 1 to 1e6, elastic", elastic, returns, unequal_car(car, seed)});
  out.push_back({"masses 1 to 1e6, plastic", plastic, stays_dented, unequal_car(car, seed)});
}

void time_steps(std::vector<Scene>& out) {
  constexpr struct {
    const char* name;
    double seconds;
    int ticks;
  } steps[] = {{"ticks of 1e-5 s", 1e-5, 2000}, {"ticks of 1e-4 s", 1e-4, 1000}, {"ticks of 1e-3 s", 1e-3, 300},
               {"ticks of 1e-2 s", 1e-2, 180},  {"ticks of 0.1 s", 0.1, 180},    {"ticks of 1 s", 1, 180}};
  for (const auto& step : steps) {
    out.push_back({std::string(step.name) + ", elastic", elastic_car(),
                   [step](Run& run) {  // stretches the car by half its length and lets go
                     const Vec3 middle = run.box.center();
                     run.displace([&](const Vec3& p) -> Vec3 { return middle + Vec3(1.5f, 1, 1).cwiseProduct(p - middle); });
                     run.release(step.ticks, step.seconds);
                   },
                   nullptr});
  }
}

// Whether a free node lies beyond the face of the plate that should have pushed it.
bool behind(const Run& run, double face) {
  for (size_t i = 0; i < run.body.node.size(); ++i) {
    if (!run.model.node_anchored[i] && run.body.node[i].x() > face + 0.01) return true;
  }
  return false;
}

void hostile_obstacles(std::vector<Scene>& out) {
  // limit: the largest distance from rest, m, that is accepted of a car that stays dented.
  const auto both = [&](const std::string& name, double limit, const std::function<void(Run&)>& play) {
    out.push_back({name + ", elastic", elastic_car(), play, nullptr});
    out.push_back({name + ", plastic", Parameters(),
                   [limit, play](Run& run) {
                     run.limit = limit;
                     play(run);
                   },
                   nullptr});
  };
  both("obstacle born inside", 0.3, [](Run& run) {
    Obstacle& ball = run.obstacles.emplace_back();
    make_sphere(0.3f, ball);
    const Vec3 at = run.box.center() + Vec3(0.4f * run.box.size().x(), 0, 0);
    ball.pose.position = at.cast<double>();
    run.run(30);
    run.release();
  });
  both("two walls to zero gap", 2.5, [](Run& run) {
    const double half = 0.5 * double(run.box.size().x());
    for (const double side : {1.0, -1.0}) {
      Obstacle& wall = run.wall(0);
      wall.pose.position.x() = double(run.box.center().x()) + side * (half + 0.5);
      wall.velocity.x() = -side * half;
    }
    run.run(60);
    for (Obstacle& wall : run.obstacles) wall.velocity *= -1;
    run.run(30);
    run.release();
  });
  both("200 overlapping obstacles", 0.4, [](Run& run) {
    for (int k = 0; k < 200; ++k) {
      Obstacle& each = run.obstacles.emplace_back();
      const float size = float(run.random.uniform(0.05, 0.4));
      if (k % 2)
        make_sphere(size, each);
      else
        make_box({size, size, size}, each);
      each.pose.position = run.random.in(run.box.low, run.box.high).cast<double>();
      each.pose.orientation = Eigen::AngleAxisd(run.random.uniform(0, pi), Eigen::Vector3d::UnitZ());
    }
    run.run(30);
    run.release();
  });
  both("pose jumping 100 m", 0.15, [](Run& run) {
    for (const double at : {0.0, 100.0}) run.wall(0.15).pose.position.x() += at;
    for (int k = 0; k < 20; ++k) {
      run.motion.pose.position.x() = k % 2 ? 0 : 100;
      run.tick();
    }
    run.release();
  });
  // The pole catches a corner of the nose like a hook at 230 m/s and drags it along for 0.8 m in the first pass, because
  // nothing here can tear. Friction and sub-steps of an eighth of the length change nothing. So the car may end far from rest,
  // but no farther than the pole.
  both("spinning 1,000 rpm past a pole", 2.5, [](Run& run) {
    constexpr double radius = 0.15;
    const auto from_axis = [&run](const Vec3& node) { return double((node - run.model.center_of_mass).head<2>().norm()); };
    const auto farthest = [&](const auto& nodes) {
      double most = 0;
      for (const Vec3& node : nodes) most = std::max(most, from_axis(node));
      return most;
    };
    const double reach = farthest(run.model.node);
    Obstacle& pole = run.obstacles.emplace_back();
    make_capsule(float(radius), 2, pole);
    pole.pose.position = run.mass.center + Eigen::Vector3d(0, reach, 0);
    run.motion.angular_velocity.z() = 1000 * 2 * pi / 60;
    run.run(30);
    run.exploded = farthest(run.body.node) > reach + 2 * radius;
    run.release();
  });
  for (const int speed : {50, 100, 150, 300}) {
    both("2 cm plate at " + std::to_string(speed) + " m/s", 0.3, [speed](Run& run) {
      constexpr double depth = 0.3, half = 0.01;  // it arrives within one tick and stops in the nose
      const double from = double(run.box.high.x()) - depth + half;
      run.obstacles.emplace_back();
      make_box({float(half), 5, 5}, run.obstacles[0]);
      run.obstacles[0].pose.position.x() = from + speed * tick_seconds;
      run.obstacles[0].velocity.x() = -speed;
      run.tick();
      run.obstacles[0].velocity.x() = 0;
      run.run(10);
      run.passed = behind(run, from - half);
      run.obstacles[0].velocity.x() = 1;
      run.run(20);
      run.release();
    });
  }
}

// A wall that is 2 mm deep in the nose rubs it to and fro, with strains of a fifth of the yield strain. No dent may stay.
Scene rubbing(int ticks, bool ours) {
  return {"rubbing below yield, 1e" + std::to_string(int(std::lround(std::log10(ticks)))) + " ticks",
          with(Parameters(), [](int, Material& m) { m.plasticity = 0.9f; }),
          [ticks](Run& run) {
            run.parameters.iterations = 5;
            run.limit = 2e-5;  // a hundredth of the push
            Obstacle& wall = run.wall(0.002);
            wall.friction = 1;
            for (int k = 0; k < ticks; ++k) {
              wall.velocity.y() = k % 20 < 10 ? 0.1 : -0.1;
              run.tick(substep_seconds(run.parameters));
            }
            run.release();
          },
          nullptr, ours};
}

Material random_material(Random& random) {
  Material m;
  if (random.chance(0.5)) return m;
  m.young_modulus = float(random.logarithmic(1e4, 1e10));
  m.poisson_ratio = float(random.uniform(0, 0.45));
  m.yield_strain = float(random.uniform(0, 1));
  m.hardening = float(random.uniform(0, 1));
  m.hardening_strain = float(random.logarithmic(1e-3, 1e3));
  m.densification = random.chance(0.5) ? 0 : float(random.logarithmic(1e-3, 100));
  m.densification_strain = float(random.uniform(0, 3));
  m.plastic_limit = float(random.uniform(0, 3));
  m.drag = random.chance(0.1) ? 0 : float(random.logarithmic(1, 1e9));
  m.distance_stiffness = float(random.uniform(0, 1));
  m.volume_stiffness = float(random.uniform(0, 1));
  m.plasticity = float(random.uniform(0, 1));
  return m;
}

Obstacle random_obstacle(Random& random, const Box& box) {
  Obstacle each;
  const float size = float(random.logarithmic(0.01, 2));
  switch (random.engine() % 4) {
    case 0:
      make_sphere(size, each);
      break;
    case 1:
      make_capsule(size, float(random.uniform(0, 2)), each);
      break;
    case 2:
      make_half_space(each);
      break;
    default:
      make_box({size, float(random.logarithmic(0.01, 3)), float(random.logarithmic(0.01, 3))}, each);
  }
  each.friction = float(random.uniform(0, 2));
  each.pose.position = (box.center() + 1.5f * random.in(-box.size(), box.size())).cast<double>();
  each.pose.orientation =
      Eigen::Quaterniond(random.uniform(-1, 1), random.uniform(-1, 1), random.uniform(-1, 1), 0.1).normalized();
  return each;
}

// Draws everything at random within its range, for ten ticks. Nothing travels farther than 3 m, so a car that is 10 m from rest
// has exploded. The obstacles may leave the car no room at all, so it needs to be sound only after they are gone.
Scene random_scene(int number) {
  char name[32];
  std::snprintf(name, sizeof name, "random scene %04d", number);
  return {name, Parameters(),
          [number](Run& run) {
            Random& random = run.random;
            random.engine.seed(random.engine() + uint64_t(number));
            constexpr int ticks = 10;
            const double seconds = random.logarithmic(1.0 / 240, 0.1), duration = ticks * seconds;
            const auto velocity = [&]() -> Eigen::Vector3d {
              return random.in(Vec3::Constant(-1.7f), Vec3::Constant(1.7f)).cast<double>() / duration;
            };
            for (Material& material : run.parameters.region) material = random_material(random);
            run.parameters.iterations = uint16_t(random.uniform(1, 40));
            if (random.chance(0.7))
              run.mass = {double(run.model.mass), run.model.inertia.cast<double>(), run.mass.center, random.chance(0.5)};
            run.motion.velocity = velocity();
            run.motion.angular_velocity = velocity() / 3;
            for (int k = int(random.uniform(1, 7)); k > 0; --k) {
              Obstacle& each = run.obstacles.emplace_back(random_obstacle(random, run.box));
              if (random.chance(0.5)) each.velocity = velocity();
              if (random.chance(0.2)) each.angular_velocity = velocity();
            }
            run.limit = exploded_distance;
            run.run(ticks, seconds);
            run.exploded = run.farthest() > exploded_distance;
            run.release();
          },
          nullptr, number >= 100};
}

}  // namespace

std::vector<Scene> hostile_scenes(const Car& car, uint64_t seed, bool quick) {
  std::vector<Scene> scenes;
  if (!quick) scenes.push_back(rubbing(1'000'000, true));  // first, because it is the longest and runs on one thread
  scenes.push_back(rubbing(quick ? 1'000 : 10'000, false));
  displaced_starts(scenes);
  hostile_meshes_and_materials(car, seed, scenes);
  time_steps(scenes);
  hostile_obstacles(scenes);
  for (int k = 0; k < (quick ? 20 : 1'000); ++k) scenes.push_back(random_scene(k));
  return scenes;
}

}  // namespace crumple

// Measures the error of `nodal` in a crash, compared with the reference minimiser on the same path:
//   crumple_reference CAR [--pole] [--depth METRES] [--friction COEFFICIENT] [--material NAME VALUE] [--sweeps N,N,...]
// in: a baked car, which drives into a wall (or a pole) at 50 km/h to the given depth (0.20 m by default), and is then held
// until 2/60 s are over. out: a table in Markdown. After each 1/240 s it has the distance of nodal's nodes to the reference's
// (RMS over all nodes and the largest, also as a share of the largest displacement) and the contact force of both. The first
// comparison is with the exact law, the second with the law of the sweeps (reference/law.h), which shows whether the solver has
// not converged or solves a different law.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <exception>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <string>

#include "bake/load_car.h"
#include "car/car.h"
#include "reference/newton.h"
#include "sim/deform.h"

namespace {

using namespace crumple;

constexpr int substeps = 32, substeps_a_row = 4;
constexpr double speed = 50 / 3.6;  // m/s

struct Scene {
  std::shared_ptr<const Car> car;
  Parameters parameters;
  Obstacle obstacle;
  std::vector<double> velocity;  // m/s, velocity of the car along x in each sub-step
  std::vector<int> sweeps = {5, 20, 200};
};

// The result of one method after each row.
struct Row {
  std::vector<Eigen::Vector3d> node;
  double force = 0;     // along x, N
  double absorbed = 0;  // J
};

struct Setting {
  const char* name;
  float Material::*field;
};
constexpr Setting settings[] = {{"young_modulus", &Material::young_modulus},
                                {"poisson_ratio", &Material::poisson_ratio},
                                {"yield", &Material::yield_strain},
                                {"hardening", &Material::hardening},
                                {"hardening_strain", &Material::hardening_strain},
                                {"densification", &Material::densification},
                                {"densification_strain", &Material::densification_strain},
                                {"plastic_limit", &Material::plastic_limit},
                                {"drag", &Material::drag}};

void set_material(const std::string& name, float value, Parameters& parameters) {
  for (const Setting& setting : settings) {
    if (name != setting.name) continue;
    for (Material& material : parameters.region) material.*setting.field = value;
    if (const auto refusal = out_of_range(parameters)) throw std::runtime_error(*refusal);
    return;
  }
  throw std::runtime_error("--material " + name +
                           " is not known; try young_modulus, poisson_ratio, yield, hardening, hardening_strain, "
                           "densification, densification_strain, plastic_limit or drag");
}

Scene scene_of(int argc, char** argv) {
  if (argc < 2) throw std::runtime_error("name a baked car; one of about 1,000 nodes takes a minute");
  Scene scene;
  scene.car = load_car(argv[1]);
  bool pole = false;
  double depth = 0.2;
  for (int i = 2; i < argc; ++i) {
    const std::string option = argv[i];
    const auto next = [&] {
      if (++i >= argc) throw std::runtime_error(option + " wants a value after it");
      return std::string(argv[i]);
    };
    if (option == "--pole") {
      pole = true;
    } else if (option == "--depth") {
      depth = std::stod(next());
    } else if (option == "--friction") {
      scene.obstacle.friction = std::stof(next());
    } else if (option == "--material") {
      const std::string name = next();
      set_material(name, std::stof(next()), scene.parameters);
    } else if (option == "--sweeps") {
      scene.sweeps.clear();
      std::istringstream list(next());
      for (std::string each; std::getline(list, each, ',');) scene.sweeps.push_back(std::stoi(each));
    } else {
      throw std::runtime_error(option + " is not known; the head of bench/solver_error.cpp lists the options");
    }
  }
  float nose = -1e9f;
  for (const Vec3& node : scene.car->model.node) nose = std::max(nose, node.x());
  if (pole) {
    make_capsule(0.127f, 3, scene.obstacle);  // the pole of the barrier tests: 254 mm
  } else {
    make_box({0.5f, 5, 5}, scene.obstacle);
  }
  scene.obstacle.pose.position.x() = double(nose) + (pole ? 0.127 : 0.5);
  for (int k = 0; k < substeps; ++k) {
    scene.velocity.push_back(std::clamp(depth / substep_seconds(Parameters()) - k * speed, 0.0, speed));
  }
  return scene;
}

std::vector<Row> by_reference(const Scene& scene, FlowLaw law) {
  const Model& model = scene.car->model;
  std::vector<Pose> path(1);
  for (double velocity : scene.velocity) {
    path.push_back(path.back());
    path.back().position.x() += velocity * substep_seconds(Parameters());
  }
  ReferenceOptions options;
  options.law = law;
  ReferenceState state = make_reference(model);
  std::vector<Row> rows;
  double absorbed = 0;
  follow_reference(
      model, scene.parameters, {&scene.obstacle, 1}, path, substep_seconds(Parameters()), options,
      [&](size_t k, const ReferenceStep& step) {
        absorbed += step.plastic_work + step.drag_work;
        std::fprintf(stderr,
                     "reference sub-step %zu/%d: %zu passes, residual %.1e%s, %d held, %d sliding, %d flat tets, %.1f kN\n",
                     k + 1, substeps, step.residual.size(), step.residual.back(), step.converged ? "" : " NOT CONVERGED",
                     step.held, step.sliding, step.inverted, 1e-3 * step.force.x());
        if ((k + 1) % substeps_a_row == 0) rows.push_back({state.node, step.force.x(), absorbed});
      },
      state);
  return rows;
}

std::vector<Row> by_nodal(const Scene& scene, int sweeps) {
  const Model& model = scene.car->model;
  Parameters parameters = scene.parameters;
  parameters.iterations = uint16_t(sweeps);
  parameters.tolerance = 0;
  Mass mass;
  mass.center = model.center_of_mass.cast<double>();
  mass.mass = std::numeric_limits<double>::infinity();
  mass.inertia.setConstant(mass.mass);
  DeformableState body = make_body(model);
  Motion motion;
  const ScratchHandle scratch = make_scratch();
  std::vector<Row> rows;
  for (int k = 0; k < substeps; ++k) {
    motion.velocity.x() = scene.velocity[size_t(k)];
    deform({model, parameters, mass, {&scene.obstacle, 1}, substep_seconds(Parameters())}, *scratch, body, motion);
    if ((k + 1) % substeps_a_row != 0) continue;
    Row& row = rows.emplace_back();
    for (const Vec3& node : body.node) row.node.push_back(node.cast<double>());
    row.force = body.force.x();
    row.absorbed = body.absorbed;
  }
  return rows;
}

struct Distance {
  double rms = 0, most = 0;
};
Distance distance(const std::vector<Eigen::Vector3d>& a, const std::vector<Eigen::Vector3d>& b) {
  Distance out;
  for (size_t i = 0; i < a.size(); ++i) {
    const double squared = (a[i] - b[i]).squaredNorm();
    out.rms += squared / double(a.size());
    out.most = std::max(out.most, std::sqrt(squared));
  }
  out.rms = std::sqrt(out.rms);
  return out;
}

void print(const Scene& scene, const char* name, const std::string& from, const std::vector<Row>& rows,
           const std::vector<Row>& reference) {
  std::vector<Eigen::Vector3d> rest;
  for (const Vec3& node : scene.car->model.node) rest.push_back(node.cast<double>());
  for (size_t k = 0; k < rows.size(); ++k) {
    const double largest = 1e3 * distance(reference[k].node, rest).most;
    const Distance d = distance(rows[k].node, reference[k].node);
    std::printf("| %s | %s | %.1f | %.0f | %.3f | %.3f | %.2f | %.2f | %.1f | %.1f | %.1f | %.1f |\n", name, from.c_str(),
                1e3 * double((k + 1) * substeps_a_row) * substep_seconds(Parameters()), largest, 1e3 * d.rms,
                1e5 * d.rms / largest, 1e3 * d.most, 1e5 * d.most / largest, 1e-3 * rows[k].force, 1e-3 * reference[k].force,
                1e-3 * rows[k].absorbed, 1e-3 * reference[k].absorbed);
  }
}

void compare(const Scene& scene) {
  std::vector<std::vector<Row>> nodal;
  for (int sweeps : scene.sweeps) {
    std::fprintf(stderr, "nodal, %d sweeps\n", sweeps);
    nodal.push_back(by_nodal(scene, sweeps));
  }
  std::printf("%s: %zu nodes, %zu tets\n\n", scene.car->name.c_str(), scene.car->model.node.size(),
              scene.car->model.tet.size());
  std::printf(
      "| reference | method | ms | largest displacement, mm | RMS, mm | %% | largest distance, mm | %% | force, kN | "
      "reference | absorbed, kJ | reference |\n|---|---|---|---|---|---|---|---|---|---|---|---|\n");
  std::vector<Row> exact;
  for (const FlowLaw law : {FlowLaw::mapped, FlowLaw::secant}) {
    const char* name = law == FlowLaw::mapped ? "exact law" : "law of the sweeps";
    const std::vector<Row> reference = by_reference(scene, law);
    for (size_t k = 0; k < nodal.size(); ++k) {
      print(scene, name, "nodal, " + std::to_string(scene.sweeps[k]) + " sweeps", nodal[k], reference);
    }
    if (law == FlowLaw::mapped) exact = reference;
    if (law == FlowLaw::secant) print(scene, "exact law", "law of the sweeps, converged", reference, exact);
    std::fflush(stdout);
  }
}

}  // namespace

int main(int argc, char** argv) {
  try {
    compare(scene_of(argc, argv));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple_reference: %s\n", error.what());
    return 1;
  }
}

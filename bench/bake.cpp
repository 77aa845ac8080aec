// Measures the parts of the thesis's initialization (6.3.2): reading the files, generating the constraints, and mapping the
// surface onto the tets. It also measures loading a baked file, which replaces all of these. The serial and the parallel runs
// call the same functions in arenas of different sizes.
#include "bake/bake.h"

#include <fstream>

#include "bake/build_constraints.h"
#include "bake/load_car.h"
#include "bake/script.h"
#include "car/build_skin.h"
#include "rooms.h"

namespace crumple {
namespace {

struct Meshes {
  Surface surface;
  TetMesh tets;
};

Meshes meshes_of(const Model& model) {
  Meshes out;
  out.surface.vertex.assign(model.vertex.begin(), model.vertex.end());
  for (size_t i = 0; i < model.triangle.size(); i += 3)
    out.surface.triangle.push_back({model.triangle[i], model.triangle[i + 1], model.triangle[i + 2]});
  out.tets.node.assign(model.node.begin(), model.node.end());
  out.tets.tet.assign(model.tet.begin(), model.tet.end());
  return out;
}

void write_obj(const Surface& surface, const std::filesystem::path& file) {
  std::ofstream out(file);
  out.precision(9);
  for (const Vec3& v : surface.vertex) out << "v " << v.x() << ' ' << v.y() << ' ' << v.z() << '\n';
  for (const Triangle& t : surface.triangle) out << "f " << t[0] + 1 << ' ' << t[1] + 1 << ' ' << t[2] + 1 << '\n';
}

// Writes the Medit format, which TetWild also writes.
void write_medit(const TetMesh& mesh, const std::filesystem::path& file) {
  std::ofstream out(file);
  out.precision(9);
  out << "MeshVersionFormatted 1\nDimension 3\nVertices\n" << mesh.node.size() << '\n';
  for (const Vec3& v : mesh.node) out << v.x() << ' ' << v.y() << ' ' << v.z() << " 0\n";
  out << "Tetrahedra\n" << mesh.tet.size() << '\n';
  for (const Tet& t : mesh.tet) {
    for (uint32_t node : t.node) out << node + 1 << ' ';
    out << "0\n";
  }
  out << "End\n";
}

void register_reading(const std::shared_ptr<const Bench>& bench) {
  register_room("read_surface/" + bench->name, [bench](benchmark::State& state) {
    const TemporaryFolder folder;
    const std::filesystem::path file = folder.path / "surface.obj";
    write_obj(meshes_of(bench->car->model).surface, file);
    for (auto _ : state) state.SetIterationTime(seconds_of([&] { benchmark::DoNotOptimize(import_surface(file, {})); }));
  });
  register_room("read_tets/" + bench->name, [bench](benchmark::State& state) {
    const TemporaryFolder folder;
    const std::filesystem::path file = folder.path / "tets.mesh";
    write_medit(meshes_of(bench->car->model).tets, file);
    std::vector<std::string> report;
    for (auto _ : state) {
      state.SetIterationTime(
          seconds_of([&] { benchmark::DoNotOptimize(import_tets(file, Eigen::Affine3d::Identity(), report)); }));
    }
  });
}

void register_mapping(const std::shared_ptr<const Bench>& bench, int threads) {
  const std::string suffix = "/" + bench->name + "/" + std::to_string(threads);
  // Measures single runs with cold memory, because nobody bakes the same car twice in a row.
  register_room("constraints" + suffix, [bench, threads](benchmark::State& state) {
    const Meshes meshes = meshes_of(bench->car->model);
    tbb::task_arena arena(threads);
    for (auto _ : state) {
      state.SetIterationTime(
          seconds_of([&] { arena.execute([&] { benchmark::DoNotOptimize(build_constraints(meshes.tets)); }); }));
    }
  })->Iterations(1);
  register_room("skin" + suffix, [bench, threads](benchmark::State& state) {
    const Meshes meshes = meshes_of(bench->car->model);
    tbb::task_arena arena(threads);
    SkinResult result;
    for (auto _ : state) {
      state.SetIterationTime(
          seconds_of([&] { arena.execute([&] { result = build_skin(meshes.tets, meshes.surface.vertex); }); }));
    }
    state.counters["coincident"] = double(result.coincident);
    state.counters["contained"] = double(result.contained);
  })->Iterations(1);
  register_room("assemble" + suffix, [bench, threads](benchmark::State& state) {
    tbb::task_arena arena(threads);
    BakeOptions options;
    options.input = bench->name;
    for (auto _ : state) {
      Meshes meshes = meshes_of(bench->car->model);
      state.SetIterationTime(seconds_of([&] {
        arena.execute(
            [&] { benchmark::DoNotOptimize(assemble_car(std::move(meshes.surface), std::move(meshes.tets), options)); });
      }));
    }
  })->Iterations(1);
}

}  // namespace

void register_bake(const std::shared_ptr<const Bench>& bench) {
  register_reading(bench);
  register_mapping(bench, 1);
  if (all_threads() > 1) register_mapping(bench, all_threads());
  register_room("load/" + bench->name, [bench](benchmark::State& state) {
    for (auto _ : state) state.SetIterationTime(seconds_of([&] { benchmark::DoNotOptimize(load_car(bench->file)); }));
    const Model& model = bench->car->model;
    state.counters["nodes"] = double(model.node.size());
    state.counters["tets"] = double(model.tet.size());
    state.counters["edges"] = double(model.edge.size());
    state.counters["vertices"] = double(model.vertex.size());
    state.counters["bytes"] = double(bench->car->bytes.size());
  });
}

}  // namespace crumple

// Measures the bytes and the error of a crashing car's surface with our codec, and writes frames for other codecs:
//   crumple_codec CAR... -o FOLDER
// in: baked cars. Each car hits a wall and a pole at 50 km/h. The frames are the ticks in which it touches them, each against a
// keyframe of the undamaged car. out: FOLDER/codec_ours.csv; for bench/codec.py also FOLDER/NAME-SCENE.frames with the vertices
// and nodes of every frame.
// Codecs: `nodes` is the server's; `vertices` packs the vertices of the surface in the same way. Bytes count whole messages.
// Times are the best of several, per 20,000 vertices. Decoding is the client library's, including the hash. skin: the time to
// compute the vertices from the nodes.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <limits>

#include "bake/load_car.h"
#include "car/car.h"
#include "sim/deform.h"
#include "sim/skin.h"
#include "tick/surface_update.h"
#include "viewer/surface.h"

namespace {

using namespace crumple;

constexpr int repetitions = 30;
constexpr double speed = 50 / 3.6;          // m/s
constexpr float default_quantum = 0.5e-3f;  // m; the last quantum below is that of the far surface level

struct Frame {
  std::vector<Vec3> node, vertex;  // displacements, m
};

std::vector<Frame> crash(const Car& car, const std::string& scene) {
  const Model& model = car.model;
  const Mass mass{double(model.mass), model.inertia.cast<double>(), model.center_of_mass.cast<double>(), true};
  double front = -1e9;
  for (const Vec3& node : model.node) front = std::max(front, double(node.x()));
  Obstacle obstacle;
  if (scene == "wall") {
    make_box({0.5f, 5, 5}, obstacle);
    obstacle.pose.position = {front + 0.52, 0, 0};
  } else {
    make_capsule(0.15f, 2, obstacle);
    obstacle.pose.position = {front + 0.17, 0, 0.5};
  }
  const ScratchHandle scratch = make_scratch();
  DeformableState body = make_body(model);
  Motion motion;
  motion.velocity = {speed, 0, 0};
  std::vector<Frame> frames;
  for (int k = 0; k < 30; ++k) {
    const StepResult result = deform({model, Parameters{}, mass, {&obstacle, 1}, 1.0 / 60}, *scratch, body, motion);
    if (result.contacts == 0) continue;
    Frame& frame = frames.emplace_back();
    frame.node.resize(car.skin_node.size());
    displace(model, body, car.skin_node, frame.node);
    frame.vertex.resize(model.vertex.size());
    skin(model, body, frame.vertex);
    for (size_t v = 0; v < frame.vertex.size(); ++v) frame.vertex[v] -= model.vertex[v];
  }
  return frames;
}

// The displacement of the vertices, m, as the client library computes it from the quanta of the nodes.
std::vector<Vec3> skinned(const Car& car, const std::vector<int16_t>& quanta, float quantum) {
  static std::vector<uint32_t> number;
  number.assign(car.model.node.size(), 0);
  for (uint32_t i = 0; i < car.skin_node.size(); ++i) number[car.skin_node[i]] = i;
  std::vector<Vec3> out;
  for (const Skin& skin : car.model.skin) {
    Vec3 sum = Vec3::Zero();
    for (int k = 0; k < 4; ++k) {
      const int16_t* q = &quanta[3 * number[skin.node[k]]];
      sum += skin.weight[k] * Vec3(q[0], q[1], q[2]);
    }
    out.push_back(quantum * sum);
  }
  return out;
}

template <class Work>
double best_seconds(const Work& work) {
  double best = 1e9;
  for (int k = 0; k < repetitions; ++k) {
    const auto start = std::chrono::steady_clock::now();
    work();
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  return best;
}

struct Sums {
  double bits = 0, worst = 0, squares = 0, most = 0, encode = 0, decode = 0, skin = 0;
};

void measure(const Car& car, const std::vector<Vec3>& sent, const std::vector<Vec3>& vertex, bool nodes, float quantum,
             Sums& sums) {
  std::vector<int16_t> quanta(3 * sent.size());
  quantise(sent, quantum, quanta);
  const std::vector<int16_t> rest(quanta.size());
  const SurfaceHead head{2, car.hash, quantum};
  std::vector<Bytes> parts;
  sums.encode += best_seconds([&] {
    quantise(sent, quantum, quanta);
    parts = encode_delta(head, quanta, 1, rest);
  });
  viewer::Surface at_rest, held;
  for (const Bytes& part : encode_keyframe({1, car.hash, quantum}, rest)) {
    if (viewer::apply_keyframe({reinterpret_cast<const uint8_t*>(part.data()), part.size()}, at_rest).applied ==
        viewer::Applied::refused)
      throw std::runtime_error("a keyframe is refused");
  }
  double best = 1e9;
  for (int k = 0; k < repetitions; ++k) {
    held = at_rest;
    const auto start = std::chrono::steady_clock::now();
    for (const Bytes& part : parts) {
      static_cast<void>(viewer::apply_delta({reinterpret_cast<const uint8_t*>(part.data()), part.size()}, held));
    }
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  sums.decode += best;
  if (held.quanta != quanta) throw std::runtime_error("what the viewer holds is not what was sent");
  std::vector<Vec3> shown;
  if (nodes) {
    sums.skin += best_seconds([&] { shown = skinned(car, held.quanta, quantum); });
  } else {
    for (size_t v = 0; v < vertex.size(); ++v) {
      shown.push_back(quantum * Vec3(held.quanta[3 * v], held.quanta[3 * v + 1], held.quanta[3 * v + 2]));
    }
  }
  for (size_t v = 0; v < vertex.size(); ++v) {
    const double error = double((shown[v] - vertex[v]).norm());
    sums.squares += error * error / double(vertex.size());
    sums.most = std::max(sums.most, error);
  }
  double bytes = 0;
  for (const Bytes& part : parts) bytes += double(part.size());
  sums.bits += 8 * bytes / double(vertex.size());
  sums.worst = std::max(sums.worst, 8 * bytes / double(vertex.size()));
}

template <class List>
void write(std::ofstream& file, const List& list) {
  file.write(reinterpret_cast<const char*>(list.data()), std::streamsize(list.size() * sizeof(list[0])));
}

void play(const std::string& path, const std::string& scene, const std::filesystem::path& folder, std::FILE* csv) {
  const auto car = load_car(path);
  const std::vector<Frame> frames = crash(*car, scene);
  if (frames.empty()) throw std::runtime_error(path + ": it does not touch the " + scene);
  const std::string name = std::filesystem::path(path).stem().string();
  std::ofstream file(folder / (name + "-" + scene + ".frames"), std::ios::binary);
  const uint32_t counts[] = {uint32_t(frames.size()), uint32_t(car->model.vertex.size()), uint32_t(car->skin_node.size())};
  file.write(reinterpret_cast<const char*>(counts), sizeof counts);
  for (const Frame& frame : frames) write(file, frame.vertex), write(file, frame.node);
  if (!file.flush()) throw std::runtime_error((folder / name).string() + ": cannot be written");
  const double each = double(frames.size()), to_20k = 1e3 * 20'000 / double(car->model.vertex.size()) / each;
  for (const bool nodes : {true, false}) {
    for (const float quantum : {0.25e-3f, default_quantum, 1e-3f, float(surface_levels[1].quanta) * default_quantum}) {
      Sums sums;
      for (const Frame& frame : frames) {
        measure(*car, nodes ? frame.node : frame.vertex, frame.vertex, nodes, quantum, sums);
      }
      std::fprintf(csv, "%s,%s,\"%s\",%.3g,%zu,%u,%.4g,%.4g,%.4g,%.4g,%.4g,%.4g,%.4g\n", name.c_str(), scene.c_str(),
                   nodes ? "nodes, packed" : "vertices, packed", 1e3 * double(quantum), frames.size(), counts[1],
                   sums.bits / each, sums.worst, 1e3 * std::sqrt(sums.squares / each), 1e3 * sums.most, sums.encode * to_20k,
                   sums.decode * to_20k, sums.skin * to_20k);
    }
  }
}

}  // namespace

int main(int count, char** arguments) {
  std::vector<std::string> cars;
  std::string folder;
  for (int k = 1; k < count; ++k) {
    const std::string argument = arguments[k];
    if (argument == "-o" && k + 1 < count) {
      folder = arguments[++k];
    } else {
      cars.push_back(argument);
    }
  }
  if (cars.empty() || folder.empty() || cars[0][0] == '-') {
    std::fprintf(stderr, "crumple_codec CAR... -o FOLDER\nBits and errors of the surface of crashing cars on the wire.\n");
    return 2;
  }
  try {
    std::FILE* csv = std::fopen((std::filesystem::path(folder) / "codec_ours.csv").c_str(), "w");
    if (!csv) throw std::runtime_error(folder + ": cannot be written; name a folder that exists");
    std::fprintf(csv,
                 "car,scene,codec,quantum_mm,frames,vertices,bits,worst_bits,rms_mm,most_mm,encode_ms,decode_ms,skin_ms\n");
    for (const std::string& car : cars) {
      for (const char* scene : {"wall", "pole"}) play(car, scene, folder, csv);
    }
    std::fclose(csv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "crumple_codec: %s\n", error.what());
    return 1;
  }
}

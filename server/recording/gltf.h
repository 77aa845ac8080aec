// Writes one body with changing shape and pose as a film in one GLB file (glTF 2.0): a mesh with a morph target per shape, a
// moving node, and one animation of both. Our own writer, because assimp's exporter omits animations of morph targets.
#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "protocol/parts.h"
#include "sim/model.h"
#include "sim/obstacle.h"

namespace crumple {

struct Animation {
  struct Key {
    double time = 0;  // s; ascending
    Pose pose;
    size_t shape = 0;  // 0: rest; i: displacement(i - 1)
  };
  // Triangles that look alike: those from `first` up to the next.
  struct Group {
    size_t first = 0;  // index into triangle, a multiple of 3
    Look look;
  };
  std::string name;
  std::string copyright;
  std::span<const Vec3> vertex;        // at rest, m, car's frame
  std::span<const uint32_t> triangle;  // 3 indices each
  std::vector<Group> groups;           // the first begins at 0
  size_t shapes = 0;
  std::function<std::vector<Vec3>(size_t)> displacement;  // of every vertex from rest, m; argument: number of the shape
  std::vector<Key> keys;
};

// Shapes and poses are interpolated linearly between keys. Throws std::runtime_error with one sentence if the file cannot be
// written or would exceed the 4 GiB of the format.
void write_glb(const std::string& path, const Animation&);

}  // namespace crumple

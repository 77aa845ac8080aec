// Any triangles become a solid: a grid of voxels with, at each, how deep it lies inside or how far outside. The triangles may
// be open, overlap, fall apart or be turned the wrong way round: nothing here looks at their orientation. Solid is
//   - what the surface closes off: what a flood from outside does not reach;
//   - what a ball of 8 % of the longest side cannot roll into from outside (doors, windows and wheel arches are smaller);
//   - what sees the sky in at most 2 of 17 directions, none of which points down: a car without a floor is full.
// If the surface alone closes off 95 % of that, it holds water, and nothing is sealed.
#pragma once

#include <span>
#include <string>

#include "bake/voxels.h"
#include "car/mesh.h"

namespace crumple {

struct FilledSurface {
  Voxels voxels;
  Mask inside;                          // 1 is solid
  std::vector<float> depth;             // m, at a voxel's centre: above zero inside, below zero outside
  std::vector<Eigen::Vector3d> sample;  // points of the triangles, in every half voxel that they cross
  double volume = 0;                    // m^3 of solid
  double closed_share = 0;              // of the solid: what the surface alone closes off
  bool sealed = true;                   // false: the surface holds water, and the solid is what it closes off
};

// Triangles name finite vertices; z is up. `name` stands for them in messages. Throws std::runtime_error with a sentence.
FilledSurface fill_surface(std::span<const Vec3> vertices, std::span<const Triangle>, const std::string& name);

}  // namespace crumple

// Where the parts of a car are now. Each part has a frame, which moves rigidly: as the nodes of the skin around it move on
// average. A viewer knows these nodes, so the server sends nothing for parts. Positions are in the car's frame, m.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "protocol/parts.h"
#include "viewer/mapping.h"

namespace crumple::viewer {

// The nodes around a part, by their number in keyframes, and their weights.
struct NodesAround {
  std::vector<uint32_t> node;
  std::vector<double> weight;
};

// rest: of the nodes of the skin; there is at least one, and all are finite.
NodesAround nodes_around(const Part&, std::span<const Point> rest);

using Turn4 = std::array<double, 4>;  // a unit quaternion: x, y, z, w

// A rigid motion away from rest.
struct Motion {
  Turn4 orientation{0, 0, 0, 1};
  std::array<double, 3> center{}, shift{};  // it turns about `center`, then moves by `shift`
  Point displacement(const Point& rest) const;
  Point turned(const Point& direction) const;
};

// The motion with the least sum of weighted squared distances to the nodes now (Horn 1987). displacement: 3 for each node of
// the skin, in quanta. If no node around has moved, the part has not either, to the last bit.
Motion motion_of(const NodesAround&, std::span<const Point> rest, std::span<const float> displacement, float quantum);

struct Place {
  std::array<double, 3> position;
  Turn4 orientation;
};
// The frame of the part after the motion.
Place place_of(const Part&, const Motion&);

}  // namespace crumple::viewer

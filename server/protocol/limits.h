// Limits of a message, so that no sender can make a tick long or a number meaningless. A message beyond a limit is refused
// whole. Health shows each count with its limit, and the number of refusals per reason.
#pragma once

#include <cstdint>

#include "protocol/key.h"

namespace crumple {

struct Limits {
  // Of a scene:
  uint32_t cars = 1'000;  // with more, nobody could look through health or a recording
  uint32_t hosts = 64;
  uint32_t obstacles_per_host = 1'000;   // each costs a coarse test per car and tick
  uint32_t hull_points_per_host = 4096;  // make_hull() tries every three points of a hull as a face
  // Of a message:
  uint32_t message_size = 64u << 20;     // bytes; a car of 50,000 nodes has 20 MB; the transport receives no more
  uint32_t id_length = id_length_limit;  // characters of a host's or car's id: a-z A-Z 0-9 _ -
  // Of numbers:
  double farthest = 1e6;          // m from the origin; farther away the floats of a viewer are off by over 6 cm
  double fastest = 500;           // m/s
  double fastest_turn = 1'000;    // rad/s
  double thinnest = 1e-3;         // m: no obstacle is thinner,
  double widest = 1e4;            // m: nor wider; use half-spaces for that
  double roughest = 10;           // Coulomb coefficient
  double heaviest = 1e6;          // kg; beyond it no crash changes a car's motion
  double greatest_inertia = 1e9;  // kg m^2
  double farthest_center = 10;    // m from the car's origin to its centre of mass
};

}  // namespace crumple

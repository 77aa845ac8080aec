// Makes the order in which `nodal` visits a car (sim/sweep_order.h) from its tets, anchors and the corners around each node.
// That takes milliseconds, so the file does not contain it. Returns an empty order if a node has 255 neighbours of as many
// colours: sound meshes need about ten colours.
#pragma once

#include "sim/model.h"

namespace crumple {

SweepOrder make_sweep_order(const Model&);

}  // namespace crumple

// The order in which `nodal` visits a car (sim/blocks.h), from its tets, anchors and the corners around each node.
// Milliseconds, so it is made when a car is loaded and not kept in its file. Empty if a node has 255 neighbours of as many
// colours: sound meshes need about ten.
#pragma once

#include "sim/model.h"

namespace crumple {

Blocks make_blocks(const Model&);

}  // namespace crumple

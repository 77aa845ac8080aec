// Makes the order in which `nodal` visits a car (sim/blocks.h) from its tets, anchors and the corners around each node. That
// takes milliseconds, so the file does not contain it. Returns empty blocks if a node has 255 neighbours of as many colours:
// sound meshes need about ten colours.
#pragma once

#include "sim/model.h"

namespace crumple {

Blocks make_blocks(const Model&);

}  // namespace crumple

// Decides the region of each node, and which nodes are held on the car's pose (the safety cell). In this order: everything is
// "body"; vertex colours paint; a regions file paints; and unless that file anchors something, the default cell is anchored:
// the core between the axles, deep under the skin, as in a real car. Without anchors a body slides through its own pose instead
// of crushing.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "car/mesh.h"

namespace crumple {

struct Regions {
  std::vector<std::string> name;       // region 0 is "body"
  std::vector<uint8_t> node_region;    // n
  std::vector<uint8_t> node_anchored;  // n
  std::vector<uint8_t> tet_region;     // t: the region of most of its corners; of equals the lowest
};

// JSON as in schema/regions.fbs. source: names it in messages.
struct RegionsText {
  std::string source, text;
};
// Throws std::runtime_error with a sentence.
RegionsText read_regions(const std::filesystem::path& file);

// name: names the car in messages. Appends what it did to `report`. Throws std::runtime_error with a sentence if the text is
// wrong or no node can be anchored.
Regions paint_regions(const TetMesh&, const Surface&, const std::optional<RegionsText>&, const std::string& name,
                      std::vector<std::string>& report);

}  // namespace crumple

// Scenes and presets for `crumple drive`: JSON in the form of schema/scene.fbs, read by FlatBuffers' own parser.
#pragma once

#include <memory>
#include <string>

#include "schema/scene_generated.h"

namespace crumple::client {

// They throw std::runtime_error with file, line and what is wrong there, or with the value that is out of its range.
// A scene of one car comes as one of a list with one car, whose id is empty.
schema::SceneT read_scene(const std::string& file);
schema::PresetT read_preset(const std::string& file);

}  // namespace crumple::client

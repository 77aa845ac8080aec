// `crumple render FILE`: draws pictures of a recording or a baked car with the Python package (crumple.render), which explains
// its own options.
#pragma once

#include <string>
#include <vector>

#include "recording/export.h"

namespace crumple {

// Returns the exit code. Throws std::runtime_error with one sentence: file, fact, remedy.
int render(const std::vector<std::string>& arguments);

// `crumple export --mesh MODEL`: writes {car}.glb again with the vertices, materials and textures of the model from which the
// cars were baked (crumple.export). Likewise.
int export_model(const ExportOptions&, const std::string& model);

}  // namespace crumple

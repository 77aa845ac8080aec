// Loads a baked car from its file.
#pragma once

#include <filesystem>
#include <memory>

#include "car/car.h"

namespace crumple {

// Reads the whole file into memory. It is not mapped, because a program that overwrites or cuts the file while a server runs
// would change checked bytes, or end the server with SIGBUS. Throws std::runtime_error with one sentence: file, fact, remedy.
std::shared_ptr<const Car> load_car(const std::filesystem::path& file);

}  // namespace crumple

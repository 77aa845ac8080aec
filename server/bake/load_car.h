// A baked car from its file.
#pragma once

#include <filesystem>
#include <memory>

#include "car/car.h"

namespace crumple {

// Reads the whole file into memory. It is not mapped: a program that writes over it, or cuts it, while a server runs would
// change bytes that were checked, or end the server by SIGBUS. Throws std::runtime_error with one sentence: file, fact, remedy.
std::shared_ptr<const Car> load_car(const std::filesystem::path& file);

}  // namespace crumple

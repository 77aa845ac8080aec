// Describes the machine, for every row of a measurement.
#pragma once

#include <fstream>
#include <string>
#include <thread>

namespace crumple {

inline std::string machine() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("model name"))
      return line.substr(line.find(':') + 2) + ", " + std::to_string(std::thread::hardware_concurrency()) + " cores";
  }
  return "unknown";
}

}  // namespace crumple

#include "cpp/obj.h"

#include <algorithm>
#include <fstream>
#include <stdexcept>

namespace crumple::client {

void write_obj(const std::string& path, std::string attribution, const std::string& car, uint64_t tick,
               std::span<const float> rest, std::span<const float> displacement, std::span<const uint32_t> triangle) {
  std::replace(attribution.begin(), attribution.end(), '\n', ' ');  // a comment ends with its line
  std::ofstream file(path);
  file << "# " << attribution << "\n# car " << car << ", tick " << tick << "\n";
  for (size_t i = 0; i < rest.size(); i += 3) {
    file << "v";
    for (size_t axis = 0; axis < 3; ++axis) file << ' ' << rest[i + axis] + displacement[i + axis];
    file << '\n';
  }
  for (size_t i = 0; i < triangle.size(); i += 3)
    file << "f " << triangle[i] + 1 << ' ' << triangle[i + 1] + 1 << ' ' << triangle[i + 2] + 1 << '\n';
  if (!file.flush()) throw std::runtime_error(path + ": cannot be written: name a folder that can, with room");
}

}  // namespace crumple::client

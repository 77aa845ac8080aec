#include "io/obj.h"

#include <algorithm>
#include <sstream>

#include "io/files.h"

namespace crumple {

void write_obj(const std::string& path, std::string attribution, const std::string& car, uint64_t tick,
               std::span<const float> rest, std::span<const float> displacement, std::span<const uint32_t> triangle) {
  std::replace(attribution.begin(), attribution.end(), '\n', ' ');  // a comment ends with its line
  FileWriter file(path);
  std::ostringstream text;
  text << "# " << attribution << "\n# car " << car << ", tick " << tick << "\n";
  for (size_t i = 0; i < rest.size(); i += 3) {
    text << "v";
    for (size_t axis = 0; axis < 3; ++axis) text << ' ' << rest[i + axis] + displacement[i + axis];
    text << '\n';
  }
  for (size_t i = 0; i < triangle.size(); i += 3)
    text << "f " << triangle[i] + 1 << ' ' << triangle[i + 1] + 1 << ' ' << triangle[i + 2] + 1 << '\n';
  file.put(text.view());
  file.finish();
}

}  // namespace crumple

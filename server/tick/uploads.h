// Baked cars that come by messages while the scene runs.
#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "car/car.h"
#include "tick/state.h"

namespace crumple {

// Bytes of one: a car of 20,000 nodes. A tick that takes one of 5,000 nodes is some 5 ms longer.
inline constexpr size_t largest_upload = size_t{8} << 20;

std::vector<std::shared_ptr<const Car>> uploaded_cars(const World&);
// One more that may be spawned. The oldest that no car is made of make room for it.
[[nodiscard]] std::optional<Refusal> upload(World&, std::shared_ptr<const Car>);
// Levels of an asset; null where it is unknown.
const Levels* find_asset(const World&, const std::string& hash);

}  // namespace crumple

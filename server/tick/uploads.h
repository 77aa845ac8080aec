// Baked cars that arrive in messages while the scene runs.
#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "car/car.h"
#include "tick/state.h"

namespace crumple {

// Bytes of the largest upload: a car of 20,000 nodes. Taking one of 5,000 nodes makes a tick some 5 ms longer.
inline constexpr size_t largest_upload = size_t{8} << 20;

std::vector<std::shared_ptr<const Car>> uploaded_cars(const World&);
// Adds an asset that hosts may spawn. The oldest uploads that no car uses are removed to make room.
[[nodiscard]] std::optional<Refusal> upload(World&, std::shared_ptr<const Car>);
// The levels of an asset; null if the asset is unknown.
const Levels* find_asset(const World&, const std::string& hash);

}  // namespace crumple

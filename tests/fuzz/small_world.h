// A world with cheap ticks: a car of 8 nodes and one of 12 that are levels of each other, few sweeps, one thread.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "fuzz/entries.h"
#include "tick/world.h"
#include "wire/decode.h"

namespace crumple::fuzz {

// In an input these names stand for the hashes of the two cars and of a car that may be uploaded, because the hashes change
// whenever baking changes.
inline constexpr char fine_asset[] = "0000000000000000", coarse_asset[] = "1111111111111111",
                      uploaded_asset[] = "2222222222222222";
Bytes with_assets(Input);
std::vector<uint8_t> without_assets(std::span<const std::byte>);

const std::shared_ptr<const Car>& fine_car();
const std::shared_ptr<const Car>& coarse_car();
const std::shared_ptr<const Car>& uploaded_car();

WorldHandle small_world();
// Makes one tick. Expects that readers accept its messages, that its numbers are finite, and that its counts agree.
void advance(World&, Inbox);
// Expects that the world can be saved and loaded.
void expect_saved(const World&);

}  // namespace crumple::fuzz

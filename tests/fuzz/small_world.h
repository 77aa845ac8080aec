// A world that a tick of costs little: a car of 8 nodes and one of 12 that are levels of each other, few sweeps, one thread.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "fuzz/entries.h"
#include "tick/world.h"
#include "wire/decode.h"

namespace crumple::fuzz {

// In an input these stand for the hashes of the two cars and of one that may be given, which are other ones after a change of
// how cars are baked.
inline constexpr char fine_asset[] = "0000000000000000", coarse_asset[] = "1111111111111111",
                      uploaded_asset[] = "2222222222222222";
Bytes with_assets(Input);
std::vector<uint8_t> without_assets(std::span<const std::byte>);

const std::shared_ptr<const Car>& fine_car();
const std::shared_ptr<const Car>& coarse_car();
const std::shared_ptr<const Car>& uploaded_car();

WorldHandle small_world();
// One tick; its messages are what readers take, its numbers are finite, its counts agree.
void advance(World&, Inbox);
// What it is can be saved and loaded.
void expect_saved(const World&);

}  // namespace crumple::fuzz

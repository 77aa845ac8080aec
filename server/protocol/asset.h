// Baked cars on the wire: named by their hash, asked for in pieces.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace crumple {

// Bytes of a baked car: a car at all limits of car/car.h has 165 MB.
inline constexpr size_t asset_limit = size_t{256} << 20;

// A query for a baked car gets at most so many bytes of it, from the offset that its payload states (8 bytes, little endian; no
// payload: 0). A shorter answer is the last. With 256 KiB the 10 s that a client waits are enough on a line of 210 kbit/s, and
// a car of 20 MB takes 80 queries.
inline constexpr size_t asset_piece = size_t{256} << 10;

// 16 hexadecimal digits, lower case: XXH64 of the bytes, seed 0. A baked car's name.
std::string hash_of(const void* bytes, size_t size);

}  // namespace crumple

// Baked cars on the wire: their hash names them, and clients ask for them in pieces.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

namespace crumple {

// Most bytes of a baked car. A car that reaches all limits of car/car.h has 165 MB.
inline constexpr size_t asset_limit = size_t{256} << 20;

// An answer to a query for a baked car holds at most this many of its bytes, from the offset in the query's payload on (8
// bytes, little endian; no payload: 0). A shorter answer is the last one. 256 KiB pass a link of 210 kbit/s within the 10 s
// that a client waits, and a car of 20 MB takes 80 queries.
inline constexpr size_t asset_piece = size_t{256} << 10;

// The name of a baked car: 16 hexadecimal digits, lower case, the XXH64 of its bytes with seed 0.
std::string hash_of(const void* bytes, size_t size);

}  // namespace crumple

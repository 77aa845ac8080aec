// How this room asks the server. It has no network and no clock of its own: its user puts the questions, brings the answers,
// and says what time it is. So the client library, the gateway and the tests share every decision.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <span>
#include <string>

namespace crumple::viewer {

using Time = std::chrono::steady_clock::time_point;

// Puts a question, which the server has to answer within `patience`. Returns the ticket under which answers and their end come,
// or 0 if the question could not be put.
using Ask =
    std::function<uint64_t(const std::string& key, std::span<const uint8_t> payload, std::chrono::milliseconds patience)>;

// The pause after a question that brought nothing, before the next one for the same thing: so a viewer does not ask a server in
// trouble at each message.
inline constexpr std::chrono::milliseconds ask_again{500};

}  // namespace crumple::viewer

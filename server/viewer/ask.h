// How the viewer asks the server. It has no network and no clock of its own: its user sends the questions, passes the answers
// in, and supplies the time. So the client library, the gateway and the tests share every decision.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <span>
#include <string>

namespace crumple::viewer {

using Time = std::chrono::steady_clock::time_point;

// Sends a question, which the server must answer within `patience`. Returns the ticket of the answers and of their end, or 0 if
// the question could not be sent.
using Ask =
    std::function<uint64_t(const std::string& key, std::span<const uint8_t> payload, std::chrono::milliseconds patience)>;

// The pause between a question without result and the next one for the same thing, so that a viewer does not ask a server in
// trouble at each message.
inline constexpr std::chrono::milliseconds ask_again{500};

}  // namespace crumple::viewer

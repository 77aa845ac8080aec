// `crumple drive` and `crumple watch` are clients: another program runs them, crumple-client beside this one.
#pragma once

#include <string>
#include <vector>

namespace crumple {

// Replaces this process by that program. Throws std::runtime_error with one sentence if the program is not there.
int run_client(const std::string& verb, const std::vector<std::string>& arguments);

}  // namespace crumple

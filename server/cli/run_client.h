// `crumple drive` and `crumple watch`: clients, and so another program, crumple-client beside this one.
#pragma once

#include <string>
#include <vector>

namespace crumple {

// Becomes that program. Throws std::runtime_error with one sentence if it is not there.
int run_client(const std::string& verb, const std::vector<std::string>& arguments);

}  // namespace crumple

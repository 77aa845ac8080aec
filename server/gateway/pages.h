// Pages that the gateway serves by themselves: the one that browsers open, and two recordings that it compares.
#pragma once

#include <atomic>
#include <string>
#include <string_view>
#include <vector>

#include "io/web.h"

namespace crumple {

// The page in this file; empty: web/index.html beside the program.
std::string read_page(std::string file);
// Whether other machines reach this address.
bool is_public(std::string_view address);
// Gives the page two recordings, which it reads and compares by itself, until `stop`: no server, no zenoh.
void hand_out(Web*, const std::vector<std::string>& files, const std::atomic<bool>& stop);

// Says once on stderr that browsers are refused: who runs the gateway sees that it is crowded, or attacked.
class RefusalNotice {
 public:
  void tell(const Web*);

 private:
  bool told_ = false;
};

}  // namespace crumple

// Pages that need no hub: the page that browsers open, and two recordings that it compares.
#pragma once

#include <atomic>
#include <string>
#include <string_view>
#include <vector>

#include "io/web.h"

namespace crumple {

// Reads the page from this file; empty: web/index.html beside the program.
std::string read_page(std::string file);
// Whether other machines can reach this address.
bool is_public(std::string_view address);
// Serves two recordings, which the page reads and compares by itself, until `stop`. Uses no server and no zenoh.
void hand_out(Web*, const std::vector<std::string>& files, const std::atomic<bool>& stop);

// Reports once on stderr that browsers are refused, so that the operator sees that the gateway is crowded or attacked.
class RefusalNotice {
 public:
  void tell(const Web*);

 private:
  bool told_ = false;
};

}  // namespace crumple

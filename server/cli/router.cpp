#include "cli/router.h"

#include <chrono>
#include <cstdio>
#include <memory>
#include <stdexcept>
#include <thread>

#include "io/net.h"

namespace crumple {

int router(const RouterOptions& options, const std::atomic<bool>& stop) {
  const auto given = [](const std::string& text) { return text.empty() ? nullptr : text.c_str(); };
  Net* opened = nullptr;
  if (net_open("router", options.listen.c_str(), given(options.connect), given(options.network), 0, &opened) != 0)
    throw std::runtime_error(transport_error());
  const std::unique_ptr<Net, void (*)(Net*)> net(opened, net_close);
  std::printf("routes at %s\n", net_endpoint(net.get()));
  std::fflush(stdout);
  while (!stop) std::this_thread::sleep_for(std::chrono::milliseconds(50));  // the session's own threads route
  return 0;
}

}  // namespace crumple

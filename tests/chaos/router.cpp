// crumple_router ENDPOINT [FILE]: the router of the chaos run, with a configuration of Zenoh (JSON5). Zenoh is built here as
// server/router.json5 requires for zenohd. PyPI's Zenoh blocks its receiving thread for 10 s whenever it drops a silent peer.
#include <unistd.h>

#include <cstdio>
#include <fstream>
#include <iterator>
#include <string>

#include "io/net.h"

int main(int count, char** arguments) {
  std::string network;
  if (count > 2) {
    std::ifstream file(arguments[2]);
    network.assign(std::istreambuf_iterator<char>(file), {});
  }
  Net* net = nullptr;
  if (count < 2 || net_open("router", arguments[1], nullptr, network.empty() ? nullptr : network.c_str(), 0, &net) != 0) {
    std::fprintf(stderr, "crumple_router: %s\n", count < 2 ? "give an endpoint" : transport_error());
    return 1;
  }
  std::printf("{\"router\": \"%s\"}\n", net_endpoint(net));
  std::fflush(stdout);
  pause();
}

// crumple_router ENDPOINT [FILE]: a router of the chaos run, with a configuration of zenoh's (JSON5). Its zenoh is built as
// server/router.json5 wants it of zenohd; that of PyPI waits 10 s on the thread that receives whenever it lets go of who is
// silent.
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

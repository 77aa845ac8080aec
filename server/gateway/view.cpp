// Opens the gateway: the page, the scene's server or the player of a recording, and the control for browsers.
#include "gateway/view.h"

#include <chrono>
#include <csignal>
#include <cstdio>
#include <optional>

#include "gateway/control.h"
#include "gateway/hub.h"
#include "gateway/need.h"
#include "gateway/pages.h"
#include "gateway/playback_loop.h"
#include "io/net.h"
#include "io/web.h"

namespace crumple {
namespace {

constexpr uint32_t connect_ms = 5'000;

struct Doors {
  Net* net = nullptr;
  Web* web = nullptr;

  ~Doors() {
    if (net) net_close(net);
    web_close(web);
  }
};

void run(Doors& doors, Hub& hub, Control* control, const std::atomic<bool>& stop) {
  NetEvent events[64];
  RefusalNotice notice;
  while (!stop) {
    const int got = net_poll(doors.net, events, 64, control ? 10'000 : 50'000);
    need(got);
    const auto now = std::chrono::steady_clock::now();
    for (int i = 0; i < got; ++i)
      if (!control || !control->take_reply(events[i])) hub.take(events[i], now);
    hub.ask(now);
    if (control) control->work();
    notice.tell(doors.web);
  }
}

}  // namespace

int view(const ViewOptions& options, const std::atomic<bool>& stop) {
  std::signal(SIGPIPE, SIG_IGN);  // a connection that breaks during a write must not end the gateway
  const std::string page = read_page(options.page);
  PlaybackLoop playback;
  Doors doors;
  need(web_open(options.listen.c_str(), &doors.web));
  need(web_page(doors.web, "/", "text/html; charset=utf-8", page.data(), page.size()));
  const std::string parameters = parameters_json(options.control);
  need(web_page(doors.web, "/parameters", "application/json", parameters.data(), parameters.size()));
  need(web_set(doors.web, "alive", "", 0));  // no server, no cars
  const std::string address = web_address(doors.web);
  if (is_public(address))
    std::fprintf(
        stderr, "crumple view: every browser that reaches %s %s this scene; --listen 127.0.0.1:8080 admits only this machine\n",
        address.c_str(), options.control ? "commands" : "sees");
  if (options.files.size() > 1) return hand_out(doors.web, options.files, stop), 0;
  std::string scene = options.scene, connect = options.connect;
  if (!options.files.empty()) {
    playback.start(options.files[0], options.speed);
    scene = playback.scene();
    connect = playback.endpoint();
  }
  const char* network = options.network.empty() ? nullptr : options.network.c_str();
  need(net_open("client", nullptr, connect.c_str(), network, connect_ms, &doors.net));
  Hub hub(doors.net, doors.web, root_of(scene), options.control);
  std::optional<Control> control;
  if (options.control)
    control.emplace(
        doors.net, doors.web, root_of(scene), [&hub](const std::string& hash) { return hub.assets().bytes(hash); },
        [&hub](const Car& car) { hub.assets().add_painted(car); });
  hub.begin();
  std::printf("scene %s of %s: open http://%s/ in a browser\n", scene.c_str(),
              options.files.empty() ? connect.c_str() : options.files[0].c_str(), address.c_str());
  std::fflush(stdout);
  run(doors, hub, control ? &*control : nullptr, stop);
  return 0;
}

}  // namespace crumple

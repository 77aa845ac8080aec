// What browsers know of a scene. The hub passes zenoh's messages on unchanged, under keys of which only the latest bytes count
// (clients/web/src/scene.ts reads them): keyframes and deltas that count, reactions by car, poses and obstacles by host.
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <span>
#include <string>
#include <string_view>

#include "gateway/assets.h"
#include "io/net.h"
#include "io/web.h"
#include "protocol/key.h"
#include "viewer/follow.h"

namespace crumple {

class Hub {
 public:
  // keeps_assets: ShownAssets keeps the bytes of assets.
  Hub(Net*, Web*, std::string root, bool keeps_assets);
  Hub(const Hub&) = delete;  // callbacks refer to this object
  // Subscribes to the scene. Throws std::runtime_error if it cannot.
  void begin();
  void take(const NetEvent&, viewer::Time now);
  // Asks for what is missing. Call it after each poll.
  void ask(viewer::Time now);
  ShownAssets& assets() { return assets_; }

 private:
  struct ShownCar {
    uint64_t life = 0;              // tells browsers this car from the next one with its id
    uint64_t key_tick = 0;          // of the last whole keyframe passed on
    std::string asset = {};         // of its surface
    std::set<uint32_t> parts = {};  // first nodes of the surface's parts: browsers keep the latest message of each
    float peak = 0;                 // largest impulse of a tick in the last hit, N s
    viewer::Time hit = {};          // when the last contact was reported
  };
  uint64_t get(const std::string& key, std::span<const uint8_t> payload, std::chrono::milliseconds patience) const;
  void set(const std::string& key, std::span<const uint8_t>);
  void tell_alive();
  void take_token(const Key&, bool alive, viewer::Time now);
  void take_sample(const Key&, std::string_view below, std::span<const uint8_t>, viewer::Time now);
  void take_surface(const viewer::SurfaceNews&, bool keyframe, std::span<const uint8_t>, viewer::Time now);
  void take_reactions(std::span<const uint8_t>, viewer::Time now);
  void take_health(std::span<const uint8_t>, viewer::Time now);
  void take_told(Channel, std::string_view below, std::span<const uint8_t>);
  void take_latest(std::span<const uint8_t>);
  void take_reply(const NetEvent&, viewer::Time now);

  Net* net_;
  Web* web_;
  std::string root_;
  bool server_ = false;
  uint64_t lives_;  // the last life given; starts from the time, because pages stay open when a gateway restarts
  viewer::Following following_;
  ShownAssets assets_;
  std::map<std::string, ShownCar, std::less<>> cars_;  // living cars
  viewer::Time looked_{};                              // when it last asked for assets that did not come
  std::set<std::string, std::less<>> hosts_;           // keys of the hosts' messages
  bool late_ = false;                                  // the hosts' earlier messages are wanted
  uint64_t asking_ = 0;                                // ticket of the question for them; 0: none
  viewer::Time asked_{};
};

}  // namespace crumple

// What browsers know of a scene. The hub passes on what zenoh brings, as it is, under keys of which the latest bytes tell all
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
  // keeps_assets: ShownAssets gives their bytes.
  Hub(Net*, Web*, std::string root, bool keeps_assets);
  Hub(const Hub&) = delete;  // what it asks comes back to it
  // Subscribes to the scene. Throws std::runtime_error if it cannot.
  void begin();
  void take(const NetEvent&, viewer::Time now);
  // Asks for what is missing. To be called after each poll.
  void ask(viewer::Time now);
  ShownAssets& assets() { return assets_; }

 private:
  struct ShownCar {
    uint64_t life = 0;              // so that browsers know it from the next of its id
    uint64_t key_tick = 0;          // of the last whole keyframe that was passed on
    std::string asset = {};         // of its surface
    std::set<uint32_t> parts = {};  // of the surface, by their first nodes: browsers keep the latest of each
    float peak = 0;                 // impulse of the last hit, N s: the greatest of a tick
    viewer::Time hit = {};          // when the last contact was told
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
  uint64_t lives_;  // the last one; browsers stay when a gateway is started again, so it counts from the time
  viewer::Following following_;
  ShownAssets assets_;
  std::map<std::string, ShownCar, std::less<>> cars_;  // those that live
  viewer::Time looked_{};                              // for cars whose asset did not come
  std::set<std::string, std::less<>> hosts_;           // keys of what they told
  bool late_ = false;                                  // what hosts told before is wanted
  uint64_t asking_ = 0;                                // ticket of the question for it; 0: none
  viewer::Time asked_{};
};

}  // namespace crumple

// crumple_client.h for C++. A session closes itself, its functions throw errors, and its commands wait for their answer. You
// need only this header and the library. A session converts to its handle: pass it to the functions of crumple_client.h that
// have no member here. crumple_client.h explains lifetimes, units and threads.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <fstream>
#include <iterator>
#include <memory>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "crumple_client.h"

namespace crumple::client {

// The sentence of crumple_error(), or the server's reason for a refusal.
struct Error : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// Returns the status, or throws an Error if it is negative.
inline int need(int status) {
  if (status < 0) throw Error(crumple_error());
  return status;
}

// See CrumpleOptions.
struct SessionOptions {
  std::string connect = "tcp/127.0.0.1:7447";  // empty: no network, crumple_feed gives all messages
  std::string scene = "main";
  std::string host{};     // empty: a viewer only
  std::string network{};  // empty: none
  std::chrono::milliseconds timeout{2000};
};

class Session {
 public:
  explicit Session(const SessionOptions& options) : timeout_(options.timeout) {
    const CrumpleOptions open{CRUMPLE_CLIENT_VERSION,
                              uint32_t(options.timeout.count()),
                              options.connect.empty() ? nullptr : options.connect.c_str(),
                              options.scene.c_str(),
                              options.host.empty() ? nullptr : options.host.c_str(),
                              options.network.c_str()};
    Crumple* handle = nullptr;
    need(crumple_open(&open, &handle));
    handle_.reset(handle);
  }
  operator Crumple*() const { return handle_.get(); }

  // Returns the number of messages.
  int poll(std::chrono::microseconds wait = {}) {
    return need(crumple_poll(*this, uint64_t(std::max<int64_t>(0, wait.count()))));
  }

  // Commands. Each returns the tick in which the server executed it, and throws the server's sentence if the server refuses.
  uint64_t spawn(const std::string& car, const std::string& asset, const CrumpleSpawn& spawn) {
    uint64_t ticket = 0;
    need(crumple_spawn(*this, car.c_str(), asset.c_str(), &spawn, &ticket));
    return settle(ticket).tick;
  }
  uint64_t despawn(const std::string& car) {
    uint64_t ticket = 0;
    need(crumple_despawn(*this, car.c_str(), &ticket));
    return settle(ticket).tick;
  }
  uint64_t repair(const std::string& car, float amount) {
    uint64_t ticket = 0;
    need(crumple_repair(*this, car.c_str(), amount, &ticket));
    return settle(ticket).tick;
  }
  uint64_t set_parameters(const std::string& car, const CrumpleParameters& parameters) {
    uint64_t ticket = 0;
    need(crumple_set_parameters(*this, car.c_str(), &parameters, &ticket));
    return settle(ticket).tick;
  }
  std::vector<uint8_t> save(const std::string& car) {
    uint64_t ticket = 0;
    need(crumple_save(*this, car.c_str(), &ticket));
    const CrumpleAnswer answer = settle(ticket);
    return {answer.state, answer.state + answer.state_size};
  }
  uint64_t load(const std::string& car, std::span<const uint8_t> state) {
    uint64_t ticket = 0;
    need(crumple_load(*this, car.c_str(), state.data(), state.size(), &ticket));
    return settle(ticket).tick;
  }
  // Waits for the answer to a ticket of crumple_spawn or another command. So you can send many commands before you wait.
  CrumpleAnswer settle(uint64_t ticket) {
    CrumpleAnswer answer;
    need(crumple_wait(*this, ticket, &answer));
    if (!answer.ok) throw Error(answer.sentence);
    return answer;
  }

  // Host.
  // Takes a baked car from its file, so that the server need not send it. Returns its name for spawn().
  std::string add_asset(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    const std::string bytes{std::istreambuf_iterator<char>(file), {}};
    if (!file) throw Error(path + ": cannot be read: give the file that `crumple bake` wrote");
    char hash[17];
    need(crumple_add_asset(*this, bytes.data(), bytes.size(), hash));
    return hash;
  }
  void publish(double time, std::span<const CrumpleCarPose> poses) {
    need(crumple_publish_poses(*this, time, poses.data(), poses.size()));
  }
  void publish(std::span<const CrumpleObstacle> obstacles) {
    need(crumple_publish_obstacles(*this, obstacles.data(), obstacles.size()));
  }
  std::optional<CrumpleReaction> next_reaction() {
    CrumpleReaction reaction;
    return crumple_take_reactions(*this, &reaction, 1) == 1 ? std::optional(reaction) : std::nullopt;
  }

  // Viewer.
  void follow(const std::string& car, int level = 0) { need(crumple_follow(*this, car.c_str(), level)); }
  void follow_all(int level = 0) { need(crumple_follow(*this, nullptr, level)); }
  std::vector<std::string> cars() const {
    std::vector<const char*> ids(crumple_cars(*this, nullptr, 0));
    crumple_cars(*this, ids.data(), ids.size());
    return {ids.begin(), ids.end()};
  }
  // Empty while the session holds no surface that is whole and current.
  std::optional<CrumpleSurface> surface(const std::string& car) {
    CrumpleSurface surface;
    return need(crumple_surface(*this, car.c_str(), &surface)) == CRUMPLE_OK ? std::optional(surface) : std::nullopt;
  }
  // Returns false while the surface or its mesh is missing.
  bool copy(const std::string& car, CrumpleVertices& out) { return need(crumple_copy(*this, car.c_str(), &out)) == CRUMPLE_OK; }
  // Maps a mesh of your own, for CrumpleVertices.mapping. Waits until the asset has come.
  uint32_t map(const std::string& asset, CrumpleOwnMesh& own) {
    uint32_t mapping = 0;
    mesh(asset);
    need(crumple_map(*this, asset.c_str(), &own, &mapping));
    return mapping;
  }
  // Waits until the mesh has come.
  CrumpleMesh mesh(const std::string& asset) {
    CrumpleMesh mesh;
    const auto deadline = std::chrono::steady_clock::now() + std::max(timeout_, std::chrono::milliseconds(10'000));
    while (need(crumple_mesh(*this, asset.c_str(), &mesh)) == CRUMPLE_PENDING) {
      if (std::chrono::steady_clock::now() > deadline) throw Error("the server does not send asset " + asset);
      poll(std::chrono::milliseconds(100));
    }
    return mesh;
  }

  // Waits until the asset has come. Empty: the car has only a body.
  std::span<const CrumplePart> parts(const std::string& asset) {
    mesh(asset);
    CrumpleParts parts;
    need(crumple_parts(*this, asset.c_str(), &parts));
    return {parts.part, parts.count};
  }
  // Where a part is now, in the car's frame. Empty while the surface or its mesh is missing.
  std::optional<CrumplePose> part_pose(const std::string& car, uint32_t part, double time = 0) {
    CrumplePose pose;
    return need(crumple_part_pose(*this, car.c_str(), part, time, &pose)) == CRUMPLE_OK ? std::optional(pose) : std::nullopt;
  }

  // Simulates a bad link, to test a game on it; {} makes the link good again.
  void impair(const CrumpleImpairment& line) { need(crumple_impair(*this, &line)); }

  // The server's time now, s; 0 while the session does not know it.
  double time() const { return crumple_time(*this); }
  // Empty until the first message of health, which comes within a second.
  std::optional<CrumpleHealth> health() const {
    CrumpleHealth health;
    return crumple_health(*this, &health) == CRUMPLE_OK ? std::optional(health) : std::nullopt;
  }
  CrumpleStatistics statistics() const {
    CrumpleStatistics statistics;
    crumple_statistics(*this, &statistics);
    return statistics;
  }

 private:
  struct Close {
    void operator()(Crumple* handle) const { crumple_close(handle); }
  };
  std::unique_ptr<Crumple, Close> handle_;
  std::chrono::milliseconds timeout_;
};

}  // namespace crumple::client

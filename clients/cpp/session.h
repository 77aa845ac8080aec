// The inside of a session (crumple_client.h): messages that the caller has not taken yet, and answers that the session waits
// for.
#pragma once

#include <crumple_client.h>

#include <chrono>
#include <deque>
#include <exception>
#include <initializer_list>
#include <limits>
#include <map>
#include <memory>
#include <random>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "io/net.h"
#include "viewer/fetch.h"
#include "viewer/follow.h"
#include "viewer/mapping.h"
#include "viewer/parts.h"

namespace crumple::client {

using namespace viewer;
using Clock = std::chrono::steady_clock;

// A session that was not polled for this long may hold an old surface, and more old messages may still be waiting for it.
inline constexpr std::chrono::milliseconds unpolled{500};
inline constexpr size_t reactions_kept = 4096;
inline constexpr size_t partners_most = 64;  // of a reaction: twice as many as a server names
inline constexpr double past_kept = 0.5;     // s: how long ago crumple_copy can show a car
inline constexpr size_t answers_kept = 256;
// Limits of what a caller gives in one call, so that the library refuses a wild count and does not read it.
inline constexpr size_t message_limit = size_t{64} << 20;  // bytes: the transport carries no more in one message
inline constexpr size_t list_limit = 10'000;               // poses or obstacles: a server takes 1 MiB of them, which is fewer
inline constexpr size_t point_limit = 100'000;             // of all hulls together: likewise
inline constexpr size_t mapped_limit = 4'000'000;          // vertices of a mesh: twenty times the largest baked car
inline constexpr size_t mapping_limit = 1024;              // mappings of a session: a hundred cars with ten meshes each
inline constexpr size_t stride_limit = 4096;               // bytes of a vertex: engines use some 100; refuses -1

// Computes the server's time from the delay of messages: the time of arrival minus the time of the tick. The least delay of the
// last one or two seconds is nearest to the truth, because other messages were held up.
struct ServerClock {
  double rate = 60;                                                        // ticks a second
  double least = std::numeric_limits<double>::infinity(), before = least;  // s, of this second and of the one before
  Clock::time_point begun{};                                               // this second
  uint64_t tick = 0;                                                       // newest

  void take(uint64_t at);
  double now() const;
};

// A reaction that waits, and the list to which it will point.
struct Told {
  CrumpleReaction reaction{};
  std::vector<CrumplePartner> partners;
};

struct Past {
  uint64_t tick;
  float quantum;
  Quanta quanta;
};

// What crumple_copy and crumple_surface remember of a car.
struct ShownCar {
  std::deque<Past> past;  // earlier surfaces and the newest, oldest first; empty: nobody asked for them
  bool dirty = false;
  // What the last crumple_copy gave, by its mapping: displacements of the skin's nodes, in quanta.
  struct Copied {
    std::string asset;
    float quantum = 0;
    std::vector<float> node;
  };
  std::map<uint32_t, Copied> copied;
};

// A mesh of the game, bound to an asset.
struct OwnMesh {
  std::string asset;
  Mapping mapping;
  std::vector<Point> position;         // at rest, in the mesh's coordinates
  std::vector<Point> normal, tangent;  // at rest, in the car's frame; empty: it has none
  Rows to_car, from_car;               // the linear part of the mesh's matrix, and its inverse
  // Vertices on wheels, which move rigidly.
  struct OnWheel {
    size_t vertex;
    uint8_t part;
    Point at;  // at rest, in the car's frame
  };
  std::vector<OnWheel> on_wheel;
};

// A simulated bad line, with its messages by time of arrival. They go to the session, or with a whole key to the server.
struct Impaired {
  struct Message {
    bool outgoing;
    std::string key;
    std::vector<uint64_t> words;  // the bytes, aligned
    size_t size;
  };
  CrumpleImpairment line{};
  std::mt19937 draw;
  std::multimap<Clock::time_point, Message> under_way;
};

struct CommandAnswer {
  bool arrived = false, ok = false;
  uint64_t tick = 0;
  std::string sentence;
  std::vector<uint8_t> state;
};

// The nodes of the skin that a vertex moves with, and their weights.
struct SkinVertex {
  uint32_t at[4];
  float weight[4];
};

struct Asset {
  bool whole = false;
  std::string trouble;
  Baked baked;
  CrumpleMesh mesh{};  // views of it
  uint32_t skin_nodes = 0;
  std::vector<SkinVertex> skin;  // per vertex
  Parts parts;
  std::vector<CrumplePart> part;    // views of `parts`
  std::vector<Point> rest;          // of the nodes of the skin; these two are empty if there are no parts
  std::vector<NodesAround> around;  // per part
};

// Keeps the sentence for crumple_error and returns the status.
int fail(int status, std::string sentence);
inline constexpr const char* no_network = "this session has no network: give options.connect to crumple_open";
// Whether this can be the id of a scene, host or car: 1 to 32 characters of a-z A-Z 0-9 _ -.
bool is_id(const char*);

}  // namespace crumple::client

struct Crumple {
  explicit Crumple(std::string scene_root);
  ~Crumple();
  Crumple(const Crumple&) = delete;
  Crumple& operator=(const Crumple&) = delete;

  Net* net = nullptr;  // NULL: crumple_feed gives all messages
  std::string root;    // "crumple/1/{scene}/"
  std::string host;
  std::chrono::milliseconds timeout{2000};
  bool server_alive = false;
  crumple::client::Clock::time_point polled = crumple::client::Clock::now();
  std::map<std::string, int, std::less<>> subscribed;  // level, by id of a car or "*"
  uint64_t sequence = 0;
  std::vector<uint8_t> obstacles;  // the last message of obstacles
  crumple::client::Following following;
  crumple::client::Fetching fetching;
  std::map<std::string, crumple::client::ShownCar, std::less<>> shown;
  std::map<std::string, crumple::client::Asset, std::less<>> assets;
  std::map<uint64_t, crumple::client::CommandAnswer> answers;  // by ticket, oldest first
  std::deque<crumple::client::Told> reactions;
  std::vector<std::vector<CrumplePartner>> partners;  // of the reactions that were taken last
  std::set<std::string, std::less<>> names;           // of cars and hosts in reactions
  CrumpleHealth health{};
  crumple::client::ServerClock clock;
  CrumpleStatistics statistics{};
  crumple::client::Impaired impaired;
  std::vector<crumple::client::OwnMesh> own;                // mapping k + 1 is own[k]
  std::vector<float> node, displacement, position, normal;  // scratch of crumple_copy
  std::vector<crumple::client::Point> cross;
  std::vector<crumple::client::Motion> motion;  // by part; of other parts than wheels that at rest
  std::vector<uint8_t> moved;
};

namespace crumple::client {
// Returns the session of a handle, or NULL with the error set. A handle is a number that is never reused, instead of an
// address. So a closed handle is recognised even if another session has the address of its session.
Crumple* find(const Crumple* handle);
// Gives a session its handle.
Crumple* keep(std::unique_ptr<Crumple>);

struct Argument {
  const char* name;
  const void* value;
};
// Whether no pointer is NULL. Otherwise sets the error.
bool not_null(std::initializer_list<Argument>);
// Sets the error to the sentence of an exception; NULL: it is no std::exception.
int fail_by(const std::exception*) noexcept;

// Runs a function of the header. Checks the session and all arguments that the function needs, and lets no exception out of the
// library, because callers in C or another language cannot catch it.
template <class Function>
int guarded(std::initializer_list<Argument> needed, Function body) noexcept {
  try {
    return not_null(needed) ? static_cast<int>(body()) : CRUMPLE_BAD_ARGUMENT;
  } catch (const std::exception& thrown) {
    return fail_by(&thrown);
  } catch (...) {
    return fail_by(nullptr);
  }
}
template <class Function>
int with(const Crumple* handle, std::initializer_list<Argument> needed, Function body) noexcept {
  return guarded({}, [&] {
    Crumple* session = find(handle);
    return session && not_null(needed) ? static_cast<int>(body(session)) : CRUMPLE_BAD_ARGUMENT;
  });
}

// crumple_poll and crumple_mesh.
int poll(Crumple*, uint64_t timeout_us);
int mesh_of(Crumple*, const char* hash, CrumpleMesh* out);

// Takes in what arrived.
void take(Crumple&, const NetEvent&);
// Whether the message goes through the simulated bad line; false: it is delivered directly.
bool impair(Impaired&, bool outgoing, std::string_view key, std::span<const uint8_t> bytes);
// Takes the messages that have come to the end of a bad line. Returns how many came to the session.
int take_impaired(Crumple&);
// How long to wait for new messages: at most until the next message leaves the simulated bad line.
uint64_t until_next(const Impaired&, uint64_t timeout_us);
// Takes a baked car from the server, or the sentence that refuses it.
void take_asset(Crumple&, AssetNews);
// Whether the car has a surface that may be shown.
bool held(const FollowedCar&);
// Keeps the present surface, so that it can still be shown when it is no longer the newest.
void remember(const Surface&, ShownCar&, double rate);
}  // namespace crumple::client

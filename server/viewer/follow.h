// Follows cars. It takes samples, tokens, answers, and what `health` says that the server told. It gives the surfaces, and asks
// for keyframes that are missing. While a car has its token, and its surface is not known to be the newest, the viewer asks for
// the keyframe again and again. What an earlier car of this id, another owner or another level told does not count.
#pragma once

#include <cstddef>
#include <map>
#include <string>
#include <string_view>

#include "protocol/key.h"
#include "viewer/ask.h"
#include "viewer/surface.h"

namespace crumple::schema {
struct Health;
}

namespace crumple::viewer {

// After this long without a keyframe the viewer asks for it again.
inline constexpr std::chrono::milliseconds keyframe_patience{3000};
// After this long without a message of a car the viewer asks for its keyframe, once: the last delta or keyframe may have been
// lost, and an idle car sends nothing.
inline constexpr std::chrono::milliseconds silence{500};
// If a car sent something less than this before a message of health, that may still be on its way.
inline constexpr std::chrono::milliseconds on_its_way{100};
// Anyone who may publish can invent cars. A viewer that follows all cars follows so many: four scenes have as many.
inline constexpr size_t cars_limit = 4'096;
// A subscription to surfaces or reactions keeps so many samples until they are polled, of so many bytes each: a part of a
// surface has 64,000 at most, reactions of 1,000 cars have 200,000.
inline constexpr uint32_t samples_waiting = 4'096;
inline constexpr size_t sample_limit = size_t{1} << 20;
inline constexpr int none = -1;  // of the surface levels

struct FollowedCar {
  Surface surface;
  Surface coming;  // while `fresh`: the parts that have come of the surface that will replace it
  int level = 0;
  bool alive = false;     // the car has a token
  bool gone = false;      // the car had a token, which went; a keyframe may come before a token
  bool unsure = false;    // a message came after the viewer last asked for a keyframe
  bool doubtful = false;  // after a pause: the surface counts only after the answer to `asking`
  bool owed = false;      // the viewer asked for a keyframe, which has not come
  bool fresh = true;      // the car, its owner or its level is a new one: the next keyframe counts whatever its tick
  Time asked{};           // when the viewer last asked for its keyframe
  uint64_t asking = 0;    // ticket of the question for the keyframe; 0: none
  Time last{};            // of its last message
};

// What a keyframe or a delta did.
struct SurfaceNews {
  const std::string* id = nullptr;  // null: the viewer does not follow the car, or not on this level
  FollowedCar* car = nullptr;
  Outcome outcome{};
  bool asked_for = false;
  bool counts = false;  // later messages build on it, so whoever else follows the car needs it
};

struct Following {
  std::string root;  // of the scene's keys
  Ask ask;
  int level = none;  // of all cars, also of those to come; none: the viewer follows only those in `cars`
  std::map<std::string, FollowedCar, std::less<>> cars = {};
  std::map<uint64_t, std::string> tickets = {};  // of questions: the id of the car

  // Follows one car, or all, on this level.
  void follow(const std::string& id, int level, Time now);
  void follow_all(int level, Time now);
  void forget(std::string_view id);

  SurfaceNews take_sample(const Key&, std::span<const uint8_t>, Time now);
  void take_token(const Key&, bool alive, Time now);
  void take_health(const schema::Health&, Time now);
  SurfaceNews take_reply(uint64_t ticket, std::span<const uint8_t>, bool failed, Time now);
  void end(uint64_t ticket);  // no more answers come
  // After a pause, seconds of old messages wait. The answer to a question that is put now comes after all of them.
  void doubt(Time now);
  // Asks again where no answer came, and where a car is silent. To be called after each poll.
  void ask_due(Time now);
};

}  // namespace crumple::viewer

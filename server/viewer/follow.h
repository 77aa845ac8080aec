// Follows cars. In: samples, tokens, answers, and the list in `health` of what the server has sent. Out: the surfaces, and
// questions for missing keyframes. While a car has its token and its surface may not be the newest, the viewer asks for the
// keyframe again and again. Messages of an earlier car with this id, another owner or another level do not count.
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
// After this long without a message about a car the viewer asks for its keyframe, once: the last delta or keyframe may have
// been lost, and an idle car sends nothing.
inline constexpr std::chrono::milliseconds silence{500};
// A message that the server sent less than this before a health message may still be on its way.
inline constexpr std::chrono::milliseconds on_its_way{100};
// Anyone who may publish can invent cars, so a viewer that follows all cars follows at most this many: as many as four scenes
// have. Beyond it the viewer forgets cars without tokens, the longest silent first.
inline constexpr size_t cars_limit = 4'096;
// Bytes of all surfaces: the largest has 1.2 MB, and the viewer holds it four times at most. A forged part of 192 bytes can
// state such a size. Beyond the limit the viewer forgets cars without tokens; then the car of the message loses its surface.
inline constexpr size_t surfaces_limit = size_t{1} << 30;
// Invented cars also make each viewer ask for cars that are not there: eight viewers and 4,000 invented cars deafened a router
// for 26 s. So a viewer waits for the answers to at most this many questions, and asks less and less often for a keyframe that
// does not come.
inline constexpr size_t questions_limit = 64;
inline constexpr std::chrono::milliseconds longest_pause{8000};
// The viewer believes another owner at once if the last one appeared longer ago.
inline constexpr std::chrono::milliseconds owners_settle{60'000};
// A subscription to surfaces or reactions keeps at most this many samples until they are polled, of at most this many bytes
// each: a part of a surface has at most 64,000, reactions of 1,000 cars have 200,000.
inline constexpr uint32_t samples_waiting = 4'096;
inline constexpr size_t sample_limit = size_t{1} << 20;
inline constexpr int none = -1;  // no surface level

struct FollowedCar {
  Surface surface;
  Surface coming;  // while `fresh`: the received parts of the surface that will replace `surface`
  int level = 0;
  bool named = false;     // the viewer follows it by its id
  bool alive = false;     // the car has its token
  bool gone = false;      // the car had its token and lost it; a keyframe may come before a token
  bool unsure = false;    // a message came after the viewer last asked for a keyframe
  bool doubtful = false;  // after a pause: the surface does not count before the answer to `asking`
  bool owed = false;      // the viewer asked for a keyframe that has not come
  bool fresh = true;      // the car, its owner or its level is new: the next keyframe counts, whatever its tick
  Time asked{};           // when the viewer last asked for its keyframe
  int tries = 0;          // questions since a keyframe came; the pause before the next one follows from them
  uint64_t asking = 0;    // ticket of the question for the keyframe; 0: none
  Time last{};            // when its last message came
  size_t held = 0;        // bytes of its surfaces
};

// The effect of a keyframe or a delta.
struct SurfaceNews {
  const std::string* id = nullptr;  // null: the viewer does not follow this car, or not at this level
  FollowedCar* car = nullptr;
  Outcome outcome{};
  bool asked_for = false;
  bool counts = false;  // later messages refer to it, so everybody else who follows the car needs it
};

struct Question {
  std::string id;    // of the car; empty: its answer does not count any more
  bool open = true;  // no answer has come, so the question takes a slot
};

using Cars = std::map<std::string, FollowedCar, std::less<>>;  // by id

struct Following {
  std::string root;  // of the scene's keys
  Ask ask;
  int level = none;  // of all cars, present and future; none: the viewer follows only those in `cars`
  Cars cars = {};
  std::map<uint64_t, Question> questions = {};  // by ticket
  size_t open = 0;                              // number of open questions
  size_t held = 0;                              // bytes of the surfaces of all cars
  Time renewed{};                               // when the viewer last asked for all keyframes again
  Time renew_at = Time::max();                  // when it will do so next
  std::chrono::milliseconds renew_pause{0};     // least time between two of these

  // Follows one car, or all cars, at this level.
  void follow(const std::string& id, int level, Time now);
  void follow_all(int level, Time now);
  void forget(std::string_view id);

  SurfaceNews take_sample(const Key&, std::span<const uint8_t>, Time now);
  void take_token(const Key&, bool alive, Time now);
  void take_health(const schema::Health&, Time now);
  SurfaceNews take_reply(uint64_t ticket, std::span<const uint8_t>, bool failed, Time now);
  void end(uint64_t ticket);  // no more answers come
  // Call it after a pause, when seconds of old messages wait. Asks for every keyframe now: that answer comes after all of them.
  void doubt(Time now);
  // Repeats unanswered questions, and asks about silent cars. Call it after each poll.
  void ask_due(Time now);
};

}  // namespace crumple::viewer

// A recorded session: one MCAP file that holds everything its ticks were computed from, so that they can be computed again.
//
//   attachments   each car that could be spawned from the start: name = its hash, the bytes of the baked file
//                 the world that the first tick began with, if it was not empty (server/tick/snapshot.h)
//   metadata      "crumple": program, scene, started, rate, quantum, and each limit under its name
//                 "crumple end", written when it is closed: how many ticks and messages it has; a file that was recovered says
//                 so
//   messages      topic = the key on the wire, "crumple/1/{scene}/...", schema = the FlatBuffers table, sequence = the tick
//     .../host/{host}/poses, .../obstacles, .../car/{car} (Command), .../asset, .../budget    inputs, in the order in which the
//                                                                       tick takes them
//     .../host/{host}/reactions, .../car/{car}/key/{level}, .../delta/{level}, .../health    outputs
//     .../car/{car}/answer                                              output: Answer to the Command
//     .../tick                                                          TickEnd
//
// Law: the inputs of a tick are written before it runs; its outputs and then its TickEnd after it. So a file that was cut off
// is whole up to its last TickEnd. What stands in front with an earlier tick is for who looks at it: what the world shows and
// what hosts told last, when the file begins with a world. Queries for keyframes and assets change nothing and are not
// recorded.
#pragma once

#include <chrono>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "io/mcap.h"
#include "protocol/key.h"
#include "tick/world.h"

namespace crumple {

// "crumple 0.1.0+1a2b3c4d": what follows the + is the hash of the sources that a tick is computed by, so that two programs of
// one name give the same bits, and a recording names the one that it can be verified with.
extern const char* const program_name;
inline constexpr const char* car_media_type = "application/vnd.crumple.car";
inline constexpr const char* uploaded_media_type = "application/vnd.crumple.given.car";  // given to that world before
inline constexpr const char* world_media_type = "application/vnd.crumple.world";

// What a fresh world is made of.
struct RecordingHead {
  std::string program = program_name;
  std::string scene;
  std::string started;  // UTC
  double rate = 60;
  float quantum = 0.0005f;
  Limits limits;
  std::vector<std::shared_ptr<const Car>> cars;
  std::vector<std::byte> world;                      // load_world; empty: a new one
  std::vector<std::shared_ptr<const Car>> uploaded;  // in it
};

// Of a key below the scene's root; `other` is none of ours.
inline Channel channel_of(std::string_view key) { return parse_key(key).value_or(Key{}).channel; }
// Its table's name in the schema; "" for other.
const char* table_of(Channel);
// Under which key a recording has a message that a tick gives; "": it has none of its kind.
std::string recorded_key(const Message&);

// Of an input, for TickEnd.inputs.
uint64_t hash_of_input(std::string_view key, const void* data, size_t size);

// What a recording says of itself when it is closed.
struct RecordingEnd {
  uint64_t ticks = 0, messages = 0;
  bool recovered = false;  // from a file that had lost more
  bool there = false;
  bool expected = false;  // by its head; older programs wrote none
};
inline constexpr const char* end_name = "crumple end";
RecordingEnd end_of(Reader*);
// What is wrong with the end of a whole file that has so many: one sentence, or "".
std::string trouble_at_end(const RecordingEnd&, uint64_t ticks, uint64_t messages);
void write_end(Recorder*, const RecordingEnd&);

// Runs a step until the recorder's queue has room for it, for those that have the time; returns its status.
template <class Step>
int when_there_is_room(Step step) {
  for (;;) {
    const int status = step();
    if (status != TRANSPORT_DROPPED) return status;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

// What a file takes of memory until it is closed: a channel for each key, of which every car that ever lived has six, and an
// index that names those that each chunk has messages of. From `next` on the recording is full, and to go on in another file.
// Beyond `most` it loses what would need more: MCAP numbers channels with 16 bits, and who cannot begin another file must not
// fill the memory.
struct RecordingBounds {
  size_t next_channels = 32'768, most_channels = 60'000;
  uint64_t next_index = uint64_t{32} << 20, most_index = uint64_t{64} << 20;  // bytes, channels included
  uint64_t next_bytes = UINT64_MAX;                                           // of messages, before they are packed
};

struct CloseRecorder {
  void operator()(Recorder* recorder) const { recorder_close(recorder); }
};
using RecorderHandle = std::unique_ptr<Recorder, CloseRecorder>;
// Creates the file, for which it waits for the disk. Throws std::runtime_error if it cannot be created.
RecorderHandle open_recorder(const std::string& path);

// Writes one. Never waits but when it is closed: what the writer's queue cannot take is counted as lost.
class Recording {
 public:
  Recording(RecorderHandle, const RecordingHead&, const RecordingBounds& = {});
  ~Recording();
  Recording(const Recording&) = delete;
  Recording& operator=(const Recording&) = delete;

  void input(uint64_t tick, const Message&, uint64_t time_ns);
  void output(uint64_t tick, const Message&, uint64_t time_ns);
  void end_tick(uint64_t tick, uint64_t hash, uint64_t time_ns);
  bool full() const;
  uint64_t lost() const { return recorder_lost(recorder_.get()) + refused_; }
  // The reason why a message was lost first, or "".
  const std::string& why_lost() const { return why_lost_; }
  // The sentence of the trouble that ended the recording early, or "".
  std::string trouble() const { return recorder_trouble(recorder_.get()); }
  // Writes what waits, and its end. Gives the sentence of the first trouble, or "".
  std::string close();

 private:
  void write_head(const RecordingHead&);
  int id_of(const std::string& key, Channel);  // of the channel in the file; negative: it could not be declared now
  bool write(const std::string& key, Channel, uint64_t tick, uint64_t time_ns, const void* data, size_t size);
  int refuse(const std::string& why);

  RecorderHandle recorder_;
  std::string root_;
  RecordingBounds bounds_;
  RecordingEnd end_;
  std::map<std::string, int, std::less<>> channels_;  // by key
  std::map<std::string, int, std::less<>> schemas_;   // by table
  uint64_t bytes_ = 0;                                // of messages
  uint64_t refused_ = 0;                              // messages lost before they came to the recorder
  uint64_t lost_inputs_ = 0, lost_outputs_ = 0;       // of the tick being recorded
  uint64_t inputs_ = 0;                               // of it: the sum of their hashes
  std::string why_lost_;
};

// Reads one, whole or cut.
class RecordingReader {
 public:
  // Throws std::runtime_error: not a recording, damaged, or of another format.
  explicit RecordingReader(const std::string& path);
  ~RecordingReader();
  RecordingReader(const RecordingReader&) = delete;
  RecordingReader& operator=(const RecordingReader&) = delete;

  const RecordingHead& head() const { return head_; }
  // Those of the head, and those that were given until the message that was read last.
  std::vector<std::shared_ptr<const Car>> cars() const;
  bool cut() const { return reader_cut(reader_) == 1; }
  RecordingEnd end() const { return end_of(reader_); }

  struct Item {
    Channel channel = Channel::other;
    size_t level = 0;      // of a keyframe or delta
    std::string_view key;  // below the scene's root
    std::span<const uint8_t> bytes;
    uint32_t tick = 0;
    uint64_t time_ns = 0;
  };
  // The next message; false at the end. Throws if the file is damaged there.
  bool next(Item&);
  void rewind();

 private:
  void read_metadata();
  void take_asset(std::span<const uint8_t>);

  std::string path_;
  Reader* reader_ = nullptr;
  RecordingHead head_;
  std::map<std::string, std::shared_ptr<const Car>> given_;  // by hash
  std::string root_;
};

}  // namespace crumple

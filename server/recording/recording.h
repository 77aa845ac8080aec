// A recorded session: one MCAP file that holds all inputs of its ticks, so that the ticks can be computed again.
//
//   attachments   each car that could be spawned from the start: name = its hash, the bytes of the baked file
//                 the world before the first tick, if it was not empty (server/tick/snapshot.h)
//   metadata      "crumple": program, scene, started, rate, quantum, and each limit under its name
//                 "crumple end", written when the file is closed: its number of ticks and messages, and whether it was
//                 recovered
//   messages      topic = the key on the wire, "crumple/1/{scene}/...", schema = the FlatBuffers table, sequence = the tick
//     .../host/{host}/poses, .../obstacles, .../car/{car} (Command), .../asset, .../budget    inputs, in the order in which the
//                                                                       tick takes them
//     .../host/{host}/reactions, .../car/{car}/key/{level}, .../delta/{level}, .../health    outputs
//     .../car/{car}/answer                                              output: Answer to the Command
//     .../tick                                                          TickEnd
//
// Law: the inputs of a tick are written before it runs; its outputs and then its TickEnd after it. So a file that was cut off
// is whole up to its last TickEnd. If the file begins with a world, messages with an earlier tick come first: the world's
// keyframes and the hosts' latest messages. They are for viewers, not inputs. Queries for keyframes and assets change nothing
// and are not recorded.
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

// "crumple 0.1.0+1a2b3c4d": the digits after the + are a hash of the sources that compute a tick. Programs with the same name
// compute the same bits, and a recording names the program that can verify it.
extern const char* const program_name;
inline constexpr const char* car_media_type = "application/vnd.crumple.car";
inline constexpr const char* uploaded_media_type = "application/vnd.crumple.given.car";  // uploaded to the saved world
inline constexpr const char* world_media_type = "application/vnd.crumple.world";

// The properties of a recording from which a fresh world is made.
struct RecordingHead {
  std::string program = program_name;
  std::string scene;
  std::string started;  // UTC
  double rate = 60;
  float quantum = 0.0005f;
  Limits limits;
  std::vector<std::shared_ptr<const Car>> cars;
  std::vector<std::byte> world;                      // bytes for load_world; empty: begin with a new world
  std::vector<std::shared_ptr<const Car>> uploaded;  // uploaded cars of the saved world
};

// The channel of a key below the scene's root; `other` if the key is none of ours.
inline Channel channel_of(std::string_view key) { return parse_key(key).value_or(Key{}).channel; }
// The name of the channel's table in the schema; "" if it has none.
const char* table_of(Channel);
// The key under which a recording keeps an output; "" if it does not keep such messages.
std::string recorded_key(const Message&);

// Hash of one input, for TickEnd.inputs.
uint64_t hash_of_input(std::string_view key, const void* data, size_t size);

// What a recording states about itself when it is closed.
struct RecordingEnd {
  uint64_t ticks = 0, messages = 0;
  bool recovered = false;  // copied from a file that had lost some messages
  bool there = false;
  bool expected = false;  // the head announces it; older programs wrote no end
};
inline constexpr const char* end_name = "crumple end";
RecordingEnd end_of(Reader*);
// Compares the end with the ticks and messages that were found. Returns one sentence about what is wrong, or "".
std::string trouble_at_end(const RecordingEnd&, uint64_t ticks, uint64_t messages);
void write_end(Recorder*, const RecordingEnd&);

// Repeats a step until the recorder's queue has room for it, for callers that may wait. Returns its status.
template <class Step>
int when_there_is_room(Step step) {
  for (;;) {
    const int status = step();
    if (status != TRANSPORT_DROPPED) return status;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

// Bounds of the memory that an open file takes: a channel per key (six for every car that ever lived) and an index of the
// channels in each chunk. From the `next_` bounds on the recording is full and should go on in another file. At the `most_`
// bounds it loses messages that would need more: MCAP numbers channels with 16 bits, and without another file the memory must
// not fill.
struct RecordingBounds {
  size_t next_channels = 32'768, most_channels = 60'000;
  uint64_t next_index = uint64_t{32} << 20, most_index = uint64_t{64} << 20;  // bytes, channels included
  uint64_t next_bytes = UINT64_MAX;                                           // size of messages before compression
};

struct CloseRecorder {
  void operator()(Recorder* recorder) const { recorder_close(recorder); }
};
using RecorderHandle = std::unique_ptr<Recorder, CloseRecorder>;
// Creates the file and waits for the disk. Throws std::runtime_error if it cannot be created.
RecorderHandle open_recorder(const std::string& path);

// Writes one recording. Only close() waits; a message for which the writer's queue has no room is counted as lost.
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
  // The reason for the first loss, or "".
  const std::string& why_lost() const { return why_lost_; }
  // The sentence about the failure that ended the recording early, or "".
  std::string trouble() const { return recorder_trouble(recorder_.get()); }
  // Writes what waits, then the end. Returns the sentence about the first failure, or "".
  std::string close();

 private:
  void write_head(const RecordingHead&);
  int id_of(const std::string& key, Channel);  // id of the channel in the file; negative: it cannot be declared now
  bool write(const std::string& key, Channel, uint64_t tick, uint64_t time_ns, const void* data, size_t size);
  int refuse(const std::string& why);

  RecorderHandle recorder_;
  std::string root_;
  RecordingBounds bounds_;
  RecordingEnd end_;
  std::map<std::string, int, std::less<>> channels_;  // by key
  std::map<std::string, int, std::less<>> schemas_;   // by table
  uint64_t bytes_ = 0;                                // of all messages
  uint64_t refused_ = 0;                              // messages lost before they reached the recorder
  uint64_t lost_inputs_ = 0, lost_outputs_ = 0;       // in the tick being recorded
  uint64_t inputs_ = 0;                               // sum of the hashes of its inputs
  std::string why_lost_;
};

// Reads a recording, whole or cut off.
class RecordingReader {
 public:
  // Throws std::runtime_error if the file is no recording, is damaged, or has another format.
  explicit RecordingReader(const std::string& path);
  ~RecordingReader();
  RecordingReader(const RecordingReader&) = delete;
  RecordingReader& operator=(const RecordingReader&) = delete;

  const RecordingHead& head() const { return head_; }
  // The cars of the head, and those uploaded up to the message that was read last.
  std::vector<std::shared_ptr<const Car>> cars() const;
  bool cut() const { return reader_cut(reader_) == 1; }
  RecordingEnd end() const { return end_of(reader_); }

  struct Item {
    Channel channel = Channel::other;
    size_t level = 0;      // of a keyframe or delta
    std::string_view key;  // key below the scene's root
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

// The recordings of a server, one file after another: none of them grows without end. A file ends when its time is over, or
// when what it takes of the server's memory comes to a bound; the next one begins with the whole world, and no tick is lost
// between them.
#pragma once

#include <chrono>
#include <deque>
#include <functional>
#include <future>
#include <memory>
#include <string>
#include <vector>

#include "recording/answer.h"
#include "recording/recording.h"

namespace crumple {

// How long the end of a server waits for the disk: a file's end is written in milliseconds, 64 MiB that wait for it in a second
// or two.
inline constexpr std::chrono::seconds longest_end{5};

struct SeriesOptions {
  std::string pattern;         // of the files' names: strftime, UTC
  double minutes = 0;          // that a file lasts; 0: until it is full
  RecordingHead head;          // of each of them, but for what the world holds when it begins
  uint64_t most = UINT64_MAX;  // bytes of all its files; beyond it the oldest go
  RecordingBounds bounds = {};
  // A file lasts so long at least, also where somebody invents cars and hosts to fill it: it begins with the whole world.
  std::chrono::seconds shortest{10};
  std::function<void(const std::string&)> tell = [](const std::string&) {};  // takes sentences about what is wrong
};

class Series {
 public:
  using Clock = std::chrono::steady_clock;
  // Opens the first file, in the place of one that had its name. Throws std::runtime_error if it cannot be created.
  Series(SeriesOptions, const World&, const LatestInputs&);
  ~Series();
  Series(const Series&) = delete;
  Series& operator=(const Series&) = delete;

  // From here on it records; what the world holds already goes in front.
  void begin(Clock::time_point now);
  void input(uint64_t tick, const Message& message, uint64_t time_ns) { recording_->input(tick, message, time_ns); }
  void output(uint64_t tick, const Message& message, uint64_t time_ns) { recording_->output(tick, message, time_ns); }
  void end_tick(uint64_t tick, uint64_t hash, uint64_t time_ns) { recording_->end_tick(tick, hash, time_ns); }

  // To be called between two ticks. No tick waits for the disk: a thread opens the next file and then closes the one before.
  // Until the next one is open, and where there can be none, the recording goes on in the one that it has. A file that somebody
  // else has is never written over.
  void go_on(Clock::time_point now);
  // Whether the next file is being opened; whether it is, or the one before is still written: until then no other is opened.
  bool is_opening() const;
  bool is_closing() const;
  // Tells once of each trouble.
  void tell();

  uint64_t lost() const { return lost_before_ + recording_->lost(); }
  const std::string& file() const { return file_; }
  // Waits for `longest_end`. Returns false if some file is not whole, and has told so.
  bool close();

 private:
  struct Opened {
    std::string file, plain;  // its name, with and without a number
    int number = 1;           // of the file among those of one plain name
    RecorderHandle recorder;
  };
  // Those that are closed, the oldest first, which only the thread that closes them knows.
  struct Written {
    std::string file;
    uint64_t inode = 0, bytes = 0;
  };
  // For the thread that opened a file: that one if nothing begins in it, else the one before.
  struct Done {
    RecorderHandle empty;
    std::unique_ptr<Recording> before;
    std::string file;  // of it
  };
  static void keep_within(uint64_t most, const std::string& closed, std::deque<Written>&);
  static Opened open_another(const std::string& pattern, const std::string& plain, int number);
  void open_next();
  void take_next();
  std::unique_ptr<Recording> begin(RecorderHandle&) const;
  void wait_for_end(const std::string& file, std::future<std::string>&, Clock::time_point until);
  void tell_once(const std::string&);
  void tell_closed(const std::string& trouble);

  SeriesOptions options_;
  const World& world_;
  const LatestInputs& latest_;
  Opened first_;  // until it begins
  std::unique_ptr<Recording> recording_;
  std::string file_, plain_;  // of it
  int number_ = 1;
  Clock::time_point until_ = Clock::time_point::max(), not_before_;
  std::future<Opened> opening_;
  std::promise<Done> done_;
  std::future<std::string> closing_;  // the thread that opens a file and closes the one before: what is wrong with that
  std::string file_before_;
  std::shared_ptr<std::deque<Written>> written_ = std::make_shared<std::deque<Written>>();
  uint64_t lost_before_ = 0;  // by recordings that are closed
  bool closed_badly_ = false;
  std::string told_;  // the last sentence about this file
};

}  // namespace crumple

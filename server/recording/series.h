// A server's recordings: a series of files, so that none grows without end. A file ends when its time is over, or when it takes
// too much of the server's memory. The next file begins with the whole world. No tick is lost between the two.
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

// How long a closing server waits for the disk. The end of a file takes milliseconds; 64 MiB in its queue take a second or two.
inline constexpr std::chrono::seconds longest_end{5};

struct SeriesOptions {
  std::string pattern;         // file name for strftime, UTC
  double minutes = 0;          // how long a file lasts; 0: until it is full
  RecordingHead head;          // head of each file, without the world and its time
  uint64_t most = UINT64_MAX;  // bytes of all its files; beyond it the oldest are deleted
  RecordingBounds bounds = {};
  // A file lasts at least this long, even if somebody invents cars and hosts to fill it: each file begins with the whole world.
  std::chrono::seconds shortest{10};
  std::function<void(const std::string&)> tell = [](const std::string&) {};  // receives sentences about failures
};

class Series {
 public:
  using Clock = std::chrono::steady_clock;
  // Opens the first file; replaces a file of that name. Throws std::runtime_error if the file cannot be created.
  Series(SeriesOptions, const World&, const LatestInputs&);
  ~Series();
  Series(const Series&) = delete;
  Series& operator=(const Series&) = delete;

  // Starts recording. The file begins with the world's present state.
  void begin(Clock::time_point now);
  void input(uint64_t tick, const Message& message, uint64_t time_ns) { recording_->input(tick, message, time_ns); }
  void output(uint64_t tick, const Message& message, uint64_t time_ns) { recording_->output(tick, message, time_ns); }
  void end_tick(uint64_t tick, uint64_t hash, uint64_t time_ns) { recording_->end_tick(tick, hash, time_ns); }

  // Call it between two ticks. No tick waits for the disk: a thread opens the next file, then closes the one before. Until the
  // next file is open, and if none can be opened, the recording goes on in its present file. The series never overwrites a file
  // that somebody else has made.
  void go_on(Clock::time_point now);
  // is_opening: the next file is being opened. is_closing: that, or the previous file is still being written; until it is done
  // no other file is opened.
  bool is_opening() const;
  bool is_closing() const;
  // Reports each failure once.
  void tell();

  uint64_t lost() const { return lost_before_ + recording_->lost(); }
  const std::string& file() const { return file_; }
  // Waits at most `longest_end`. Returns false if some file is not whole; it has reported that.
  bool close();

 private:
  struct Opened {
    std::string file, plain;  // file name with and without a number
    int number = 1;           // number of the file among those with this plain name
    RecorderHandle recorder;
  };
  // Closed files, the oldest first. Only the thread that closes files uses them.
  struct Written {
    std::string file;
    uint64_t inode = 0, bytes = 0;
  };
  // Sent to the thread that opened a file: the new file if nothing is recorded in it, otherwise the previous recording.
  struct Done {
    RecorderHandle empty;
    std::unique_ptr<Recording> before;
    std::string file;  // file name of `before`
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
  Opened first_;  // until begin()
  std::unique_ptr<Recording> recording_;
  std::string file_, plain_;  // of recording_
  int number_ = 1;
  Clock::time_point until_ = Clock::time_point::max(), not_before_;
  std::future<Opened> opening_;
  std::promise<Done> done_;
  std::future<std::string> closing_;  // from the thread that opens a file and closes the one before: what failed in closing
  std::string file_before_;
  std::shared_ptr<std::deque<Written>> written_ = std::make_shared<std::deque<Written>>();
  uint64_t lost_before_ = 0;  // by closed recordings
  bool closed_badly_ = false;
  std::string told_;  // the last sentence reported about this file
};

}  // namespace crumple

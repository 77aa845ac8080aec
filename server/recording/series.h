// The recordings of a server, one file after another: none of them grows without end. A file ends when its time is over, or
// when what it takes of the server's memory comes to a bound; the next one begins with the whole world, and no tick is lost
// between them.
#pragma once

#include <chrono>
#include <functional>
#include <future>
#include <memory>
#include <string>
#include <vector>

#include "recording/answer.h"
#include "recording/recording.h"

namespace crumple {

struct SeriesOptions {
  std::string pattern;  // of the files' names: strftime, UTC
  double minutes = 0;   // that a file lasts; 0: until it is full
  RecordingHead head;   // of each of them, but for what the world holds when it begins
  RecordingBounds bounds = {};
  // A file lasts so long at least, also where somebody invents cars and hosts to fill it: it begins with the whole world.
  std::chrono::seconds shortest{10};
  std::function<void(const std::string&)> tell = [](const std::string&) {};  // takes sentences about what is wrong
};

class Series {
 public:
  using Clock = std::chrono::steady_clock;
  // Begins the first file, in the place of one that had its name. Throws std::runtime_error if it cannot be created.
  Series(SeriesOptions, const World&, const LatestInputs&, Clock::time_point now);

  void input(uint64_t tick, const Message& message, uint64_t time_ns) { recording_->input(tick, message, time_ns); }
  void output(uint64_t tick, const Message& message, uint64_t time_ns) { recording_->output(tick, message, time_ns); }
  void end_tick(uint64_t tick, uint64_t hash, uint64_t time_ns) { recording_->end_tick(tick, hash, time_ns); }

  // To be called between two ticks. That no tick waits for the disk, the file before is closed by a thread of its own; while
  // that lasts, and where there can be no other file, the recording goes on in the one that it has. A file that somebody else
  // has is never written over.
  void go_on(Clock::time_point now);
  // Whether the file before is still written to the disk: until then there is no other.
  bool is_closing() const;
  // Tells once of each trouble.
  void tell();

  uint64_t lost() const { return lost_before_ + recording_->lost(); }
  const std::string& file() const { return file_; }
  // Returns false if some file is not whole, and has told so.
  bool close();

 private:
  std::string another_file();
  std::unique_ptr<Recording> begin(const std::string& file) const;
  void tell_closed();

  SeriesOptions options_;
  const World& world_;
  const LatestInputs& latest_;
  std::string file_, plain_;  // with and without a number
  int number_ = 1;            // of the file among those of one plain name
  std::unique_ptr<Recording> recording_;
  Clock::time_point until_ = Clock::time_point::max(), not_before_;
  std::future<std::string> closing_;  // the file before: what is wrong with it
  uint64_t lost_before_ = 0;          // by recordings that are closed
  bool closed_badly_ = false;
  std::string told_;  // the last sentence about this file
};

}  // namespace crumple

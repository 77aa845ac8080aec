#include "recording/series.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <stdexcept>
#include <system_error>
#include <thread>
#include <type_traits>
#include <utility>

#include "tick/snapshot.h"
#include "tick/uploads.h"

namespace crumple {
namespace {

std::chrono::steady_clock::duration minutes(double count) {
  return std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double, std::ratio<60>>(count));
}

uint64_t wall_ns() {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::system_clock::now().time_since_epoch()).count());
}

// Fills in the time with strftime, UTC.
std::string with_time(const std::string& pattern) {
  char text[4096];
  const std::time_t now = std::time(nullptr);
  std::tm utc;
  const size_t size = gmtime_r(&now, &utc) ? std::strftime(text, sizeof text, pattern.c_str(), &utc) : 0;
  return size > 0 ? std::string(text, size) : pattern;
}

// Runs work that may wait for a disk, perhaps for ever, on a thread that nobody has to wait for.
template <class Work>
auto aside(Work work) {
  std::packaged_task<std::invoke_result_t<Work>()> task(std::move(work));
  auto result = task.get_future();
  std::thread(std::move(task)).detach();
  return result;
}

template <class Result>
bool is_ready(const std::future<Result>& result) {
  return result.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
}

// Removes a recording without content. Leaves pipes and devices alone: they are not ours to remove.
void remove_empty(const std::string& file) {
  std::error_code none;
  if (std::filesystem::is_regular_file(file, none)) std::filesystem::remove(file, none);
}

}  // namespace

Series::Series(SeriesOptions options, const World& world, const LatestInputs& latest)
    : options_(std::move(options)), world_(world), latest_(latest) {
  if (options_.most < UINT64_MAX) options_.bounds.next_bytes = options_.most / 4;
  file_ = plain_ = with_time(options_.pattern);
  first_ = {file_, plain_, 1, open_recorder(file_)};
}

Series::~Series() { close(); }

void Series::begin(Clock::time_point now) {
  recording_ = begin(first_.recorder);
  not_before_ = now + options_.shortest;
  if (options_.minutes > 0) until_ = now + minutes(options_.minutes);
}

// Takes the recorder only when nothing can fail any more.
std::unique_ptr<Recording> Series::begin(RecorderHandle& recorder) const {
  RecordingHead head = options_.head;
  if (tick_count(world_) > 0) {
    head.world = save_world(world_);
    head.uploaded = uploaded_cars(world_);
  }
  head.started = with_time("%Y-%m-%dT%H:%M:%SZ");
  Outbox outbox;
  shown(world_, outbox);
  auto recording = std::make_unique<Recording>(std::move(recorder), head, options_.bounds);
  // For viewers of the recording: what was visible at the start. The world already contains these inputs.
  for (const Message& message : outbox) recording->output(tick_count(world_), message, wall_ns());
  for (const auto& [key, message] : latest_.messages) recording->input(tick_count(world_), message, wall_ns());
  return recording;
}

// A quarter of the limit is reserved for the open file. A file that was moved, or another file that now has its name, is not
// ours to remove.
void Series::keep_within(uint64_t most, const std::string& closed, std::deque<Written>& written) {
  struct stat info {};
  if (stat(closed.c_str(), &info) == 0 && S_ISREG(info.st_mode))
    written.push_back({closed, info.st_ino, static_cast<uint64_t>(info.st_size)});
  uint64_t bytes = 0;
  for (const Written& each : written) bytes += each.bytes;
  for (; bytes > most - most / 4; written.pop_front()) {
    const Written& oldest = written.front();
    if (stat(oldest.file.c_str(), &info) == 0 && info.st_ino == oldest.inode) unlink(oldest.file.c_str());
    bytes -= oldest.bytes;
  }
}

// Creates a file named after the time; adds -2, -3, ... if that name is taken. Creates it here so that no other server takes
// the name.
Series::Opened Series::open_another(const std::string& pattern, const std::string& plain, int number) {
  Opened next{"", with_time(pattern), 0, nullptr};
  if (next.plain == plain) next.number = number;
  for (;;) {
    std::filesystem::path path = next.plain;
    if (++next.number > 1)
      path.replace_filename(path.stem().string() + "-" + std::to_string(next.number) + path.extension().string());
    const int made = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (made < 0 && errno == EEXIST) continue;
    if (made < 0) throw std::runtime_error(path.string() + ": it cannot be made (" + std::strerror(errno) + ")");
    ::close(made);
    next.file = path.string();
    try {
      next.recorder = open_recorder(next.file);
    } catch (const std::runtime_error&) {
      remove_empty(next.file);
      throw;
    }
    return next;
  }
}

bool Series::is_opening() const { return opening_.valid() && !is_ready(opening_); }
bool Series::is_closing() const { return closing_.valid() && !is_ready(closing_); }

void Series::open_next() {
  std::promise<Opened> opened;
  std::promise<Done> done;
  opening_ = opened.get_future();
  closing_ = aside([pattern = options_.pattern, plain = plain_, number = number_, most = options_.most, written = written_,
                    opened = std::move(opened), done = done.get_future()]() mutable -> std::string {
    std::string file;
    try {
      Opened next = open_another(pattern, plain, number);
      file = next.file;
      opened.set_value(std::move(next));
    } catch (...) {
      opened.set_exception(std::current_exception());
      return "";
    }
    try {
      Done last = done.get();
      if (last.before) {
        const std::string trouble = last.before->close();
        keep_within(most, last.file, *written);
        return trouble;
      }
    } catch (const std::future_error&) {  // the series ended meanwhile
    }
    remove_empty(file);
    return "";
  });
  done_ = std::move(done);
}

void Series::take_next() {
  Opened next;
  std::unique_ptr<Recording> recording;
  try {
    next = opening_.get();
    recording = begin(next.recorder);
  } catch (const std::exception& error) {
    done_.set_value({std::move(next.recorder), nullptr, ""});
    return options_.tell(std::string(error.what()) + "; the server goes on in " + file_);
  }
  tell();
  lost_before_ = lost();
  done_.set_value({nullptr, std::exchange(recording_, std::move(recording)), file_});
  file_before_ = std::exchange(file_, next.file);
  plain_ = next.plain;
  number_ = next.number;
  told_.clear();
}

void Series::go_on(Clock::time_point now) {
  if (opening_.valid() && is_ready(opening_)) return take_next();
  if (now < until_ && (now < not_before_ || !recording_->full())) return;
  not_before_ = now + options_.shortest;
  if (is_closing())
    return tell_once((is_opening() ? options_.pattern + ": the disk has not opened the next file yet"
                                   : file_before_ + ": the disk has not written its end yet") +
                     "; the server goes on in " + file_);
  if (closing_.valid()) tell_closed(closing_.get());
  if (options_.minutes > 0) until_ = now + minutes(options_.minutes);
  try {
    open_next();
  } catch (const std::system_error& error) {
    opening_ = {};
    options_.tell(std::string("no thread can be started to open the next file (") + error.what() + "); the server goes on in " +
                  file_);
  }
}

void Series::tell() {
  std::string trouble = recording_->trouble();
  if (trouble.empty() && !recording_->why_lost().empty())
    trouble = file_ + ": loses messages: " + recording_->why_lost() + "; the server goes on, replay --verify names the tick";
  if (!trouble.empty()) tell_once(trouble);
}

void Series::tell_once(const std::string& trouble) {
  if (trouble != told_) options_.tell(trouble);
  told_ = trouble;
}

void Series::tell_closed(const std::string& trouble) {
  if (trouble.empty()) return;
  closed_badly_ = true;
  tell_once(trouble);
}

void Series::wait_for_end(const std::string& file, std::future<std::string>& closing, Clock::time_point until) {
  if (!closing.valid()) return;
  tell_closed(closing.wait_until(until) == std::future_status::ready
                  ? closing.get()
                  : file + ": the disk has not written its end within " + std::to_string(longest_end.count()) +
                        " s: `crumple recover` makes a whole recording of the part that it has");
}

bool Series::close() {
  if (!recording_ && !first_.recorder) return !closed_badly_;
  const auto until = Clock::now() + longest_end;
  const uint64_t missing = recording_ ? lost() : 0;
  if (is_opening()) closing_ = {};  // that thread ends by itself, or hangs
  done_ = {};
  std::future<std::string> closing;
  try {
    closing = aside([recording = std::move(recording_), first = std::move(first_), opening = std::move(opening_)]() mutable {
      if (recording) return recording->close();
      first.recorder.reset();
      remove_empty(first.file);
      return std::string();
    });
  } catch (const std::system_error& error) {  // no thread: the recording was closed here
    tell_closed(file_ + ": the server could not check whether it is whole (" + error.what() + "): `crumple info` does");
  }
  wait_for_end(file_before_, closing_, until);
  wait_for_end(file_, closing, until);
  if (missing > 0) options_.tell("the recording lost " + std::to_string(missing) + " messages");
  return missing == 0 && !closed_badly_;
}

}  // namespace crumple

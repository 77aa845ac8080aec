#include "recording/series.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "tick/given.h"
#include "tick/snapshot.h"

namespace crumple {
namespace {

std::chrono::steady_clock::duration minutes(double count) {
  return std::chrono::duration_cast<std::chrono::steady_clock::duration>(std::chrono::duration<double, std::ratio<60>>(count));
}

uint64_t wall_ns() {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::system_clock::now().time_since_epoch()).count());
}

// strftime, UTC.
std::string with_time(const std::string& pattern) {
  char text[4096];
  const std::time_t now = std::time(nullptr);
  const size_t size = std::strftime(text, sizeof text, pattern.c_str(), std::gmtime(&now));
  return size > 0 ? std::string(text, size) : pattern;
}

}  // namespace

Series::Series(SeriesOptions options, const World& world, const LatestInputs& latest, Clock::time_point now)
    : options_(std::move(options)), world_(world), latest_(latest), not_before_(now + options_.shortest) {
  file_ = plain_ = with_time(options_.pattern);
  recording_ = begin(file_);
  if (options_.minutes > 0) until_ = now + minutes(options_.minutes);
}

std::unique_ptr<Recording> Series::begin(const std::string& file) const {
  RecordingHead head = options_.head;
  if (tick_count(world_) > 0) {
    head.world = save_world(world_);
    head.given = given_cars(world_);
  }
  head.started = with_time("%Y-%m-%dT%H:%M:%SZ");
  auto recording = std::make_unique<Recording>(file, head, options_.bounds);
  // For who looks at it: what is seen at the start. The world has these inputs already.
  Outbox outbox;
  shown(world_, outbox);
  for (const Message& message : outbox) recording->output(tick_count(world_), message, wall_ns());
  for (const auto& [key, message] : latest_.messages) recording->input(tick_count(world_), message, wall_ns());
  return recording;
}

// The name with the time, or with -2, -3, ... where there is such a file; made here, so that no other server takes it.
std::string Series::another_file() {
  const std::string plain = with_time(options_.pattern);
  number_ = plain == plain_ ? number_ : 0;
  plain_ = plain;
  for (;;) {
    std::filesystem::path path = plain;
    if (++number_ > 1) path.replace_filename(path.stem().string() + "-" + std::to_string(number_) + path.extension().string());
    const int made = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (made < 0 && errno == EEXIST) continue;
    if (made < 0) throw std::runtime_error(path.string() + ": it cannot be made (" + std::strerror(errno) + ")");
    ::close(made);
    return path.string();
  }
}

bool Series::is_closing() const {
  return closing_.valid() && closing_.wait_for(std::chrono::seconds(0)) != std::future_status::ready;
}

void Series::go_on(Clock::time_point now) {
  if (now < until_ && (now < not_before_ || !recording_->full())) return;
  not_before_ = now + options_.shortest;
  if (is_closing()) return;
  if (options_.minutes > 0) until_ = now + minutes(options_.minutes);
  std::string file;
  std::unique_ptr<Recording> next;
  try {
    file = another_file();
    next = begin(file);
  } catch (const std::exception& error) {
    std::error_code none;
    if (!file.empty()) std::filesystem::remove(file, none);
    return options_.tell(std::string(error.what()) + "; goes on in " + file_);
  }
  tell();
  tell_closed();
  lost_before_ = lost();
  const std::shared_ptr<Recording> before = std::exchange(recording_, std::move(next));
  file_ = file;
  told_.clear();
  try {
    closing_ = std::async(std::launch::async, [before] { return before->close(); });
  } catch (const std::system_error&) {  // there is no thread for it: the tick waits
    const std::string trouble = before->close();
    if (!trouble.empty()) options_.tell(trouble);
    closed_badly_ |= !trouble.empty();
  }
}

void Series::tell() {
  std::string trouble = recording_->trouble();
  if (trouble.empty() && !recording_->why_lost().empty())
    trouble = file_ + ": loses messages: " + recording_->why_lost() + "; the server goes on, replay --verify names the tick";
  if (trouble.empty() || trouble == told_) return;
  options_.tell(trouble);
  told_ = trouble;
}

void Series::tell_closed() {
  if (!closing_.valid()) return;
  const std::string trouble = closing_.get();
  if (!trouble.empty()) options_.tell(trouble);
  closed_badly_ |= !trouble.empty();
}

bool Series::close() {
  const uint64_t missing = lost();
  tell_closed();
  const std::string trouble = recording_->close();
  if (!trouble.empty() && trouble != told_) options_.tell(trouble);
  if (missing > 0) options_.tell("the recording lost " + std::to_string(missing) + " messages");
  return missing == 0 && trouble.empty() && !closed_badly_;
}

}  // namespace crumple

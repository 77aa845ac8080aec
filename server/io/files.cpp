#include "io/files.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <stdexcept>
#include <system_error>
#include <utility>

namespace crumple {
namespace {

struct Descriptor {
  int number;
  ~Descriptor() {
    if (number >= 0) close(number);
  }
};

std::string with_unit(size_t bytes) {
  return bytes % (size_t{1} << 20) == 0 ? std::to_string(bytes >> 20) + " MiB" : std::to_string(bytes) + " bytes";
}

}  // namespace

std::string read_file(const std::filesystem::path& path, size_t most, const std::string& remedy) {
  const auto refuse = [&](const std::string& fact) {
    throw std::runtime_error(path.string() + ": " + fact + "; " + remedy + ".");
  };
  // O_NONBLOCK, because opening a pipe without a writer would wait.
  const Descriptor file{open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK)};
  struct stat info {};
  if (file.number < 0 || fstat(file.number, &info) != 0)
    refuse(std::string("it cannot be opened (") + std::strerror(errno) + ")");
  if (!S_ISREG(info.st_mode)) refuse("this is not a file but a folder, a pipe or a device");
  const auto too_large = [&] { refuse("it is larger than the " + with_unit(most) + " that it may have"); };
  if (static_cast<size_t>(info.st_size) > most) too_large();
  std::string bytes;
  size_t size = 0;
  for (;;) {
    if (size == bytes.size()) bytes.resize(std::min(most + 1, std::max(static_cast<size_t>(info.st_size) + 1, 2 * size)));
    const ssize_t got = read(file.number, bytes.data() + size, bytes.size() - size);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) refuse(std::string("it cannot be read (") + std::strerror(errno) + ")");
    size += static_cast<size_t>(got);
    if (size > most) too_large();
    if (got == 0) break;
  }
  bytes.resize(size);
  return bytes;
}

std::optional<std::string> read_pipe(int from, size_t most) {
  std::string bytes(std::min(most + 1, size_t{1} << 16), '\0');
  for (size_t size = 0;;) {
    const ssize_t got = read(from, bytes.data() + size, bytes.size() - size);
    if (got < 0 && errno == EINTR) continue;
    size += static_cast<size_t>(std::max<ssize_t>(0, got));
    if (size > most) return std::nullopt;
    if (got <= 0) {
      bytes.resize(size);
      return bytes;
    }
    if (size == bytes.size()) bytes.resize(std::min(most + 1, 2 * size));
  }
}

FileWriter::FileWriter(std::filesystem::path path) : path_(std::move(path)), beside_(path_) {
  std::error_code none;
  const auto there = std::filesystem::status(path_, none).type();
  using Type = std::filesystem::file_type;
  if (there == Type::regular || there == Type::not_found) beside_ += ".part";
  file_ = std::fopen(beside_.c_str(), "wbe");
  if (!file_) fail();
}

FileWriter::~FileWriter() {
  if (!file_) return;
  std::fclose(file_);
  std::error_code none;
  if (beside_ != path_) std::filesystem::remove(beside_, none);
}

void FileWriter::put(std::string_view bytes) {
  if (!bytes.empty() && std::fwrite(bytes.data(), 1, bytes.size(), file_) != bytes.size()) fail();
}

void FileWriter::finish() {
  if (std::fflush(file_) != 0) fail();
  if (beside_ != path_ && ::fsync(fileno(file_)) != 0) fail();
  if (std::fclose(std::exchange(file_, nullptr)) != 0 ||
      (beside_ != path_ && std::rename(beside_.c_str(), path_.c_str()) != 0)) {
    const int error = errno;
    std::error_code none;
    if (beside_ != path_) std::filesystem::remove(beside_, none);
    errno = error;
    fail();
  }
}

void FileWriter::fail() {
  const int error = errno;
  const std::string remedy = error == ENOSPC || error == EFBIG || error == EDQUOT
                                 ? "make room there, or name a place with more"
                                 : "name a folder that exists and can be written";
  throw std::runtime_error(path_.string() + ": it cannot be written (" + std::strerror(error) + "); " + remedy + ".");
}

}  // namespace crumple

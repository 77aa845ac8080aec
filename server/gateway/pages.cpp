#include "gateway/pages.h"

#include <cctype>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <thread>

#include "gateway/need.h"
#include "io/files.h"
#include "recording/recording.h"

namespace crumple {
namespace {

constexpr size_t recording_limit = size_t{1} << 30;  // bytes: the page holds all of it

// Escapes text for a URL.
std::string encoded(const std::string& text) {
  std::string out;
  for (const char c : text) {
    char digits[4];
    std::snprintf(digits, sizeof digits, "%%%02X", static_cast<unsigned char>(c));
    out += std::isalnum(static_cast<unsigned char>(c)) || std::strchr("-._", c) ? std::string(1, c) : digits;
  }
  return out;
}

}  // namespace

std::string read_page(std::string file) {
  if (file.empty()) file = std::filesystem::read_symlink("/proc/self/exe").parent_path() / "web" / "index.html";
  return read_file(file, text_limit, "`server/setup web` makes the page in build/web; --page FILE names another");
}

bool is_public(std::string_view address) {
  return !address.starts_with("127.") && !address.starts_with("localhost:") && !address.starts_with("[::1]");
}

void hand_out(Web* web, const std::vector<std::string>& files, const std::atomic<bool>& stop) {
  std::string query;
  for (size_t i = 0; i < files.size(); ++i) {
    RecordingReader{files[i]};  // throws if it is no recording
    const std::string bytes = read_file(files[i], recording_limit, "a page shows shorter ones"),
                      path = "/recording/" + std::to_string(i);
    need(web_page(web, path.c_str(), "application/octet-stream", reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()));
    query += (i ? "&recording=" : "?recording=") + encoded(std::filesystem::path(files[i]).filename());
  }
  std::printf("%s and %s: open http://%s/%s in a browser\n", files[0].c_str(), files[1].c_str(), web_address(web),
              query.c_str());
  std::fflush(stdout);
  for (RefusalNotice notice; !stop; std::this_thread::sleep_for(std::chrono::milliseconds(50))) notice.tell(web);
}

void RefusalNotice::tell(const Web* web) {
  if (told_ || web_refused(web) == 0) return;
  told_ = true;
  std::fprintf(stderr,
               "crumple view: connections are refused: the page accepts at most 512 at a time, and 256 from one address\n");
}

}  // namespace crumple

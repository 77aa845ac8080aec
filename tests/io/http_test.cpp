// Attacks both HTTP servers (--metrics and the gateway for browsers) with raw sockets on loopback. Under every attack memory
// must stay flat, another reader must get its answer at once, and the server must close when its owner says so.
#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/socket.h>

#include <cstdlib>
#include <random>
#include <set>
#include <sstream>

#include "io/metrics.h"
#include "io/web.h"
#include "paths.h"
#include "program.h"

namespace crumple {
namespace {

using std::chrono::seconds;

constexpr seconds promptly{3};  // for an answer under attack: it takes milliseconds, also on a loaded machine
#ifdef CRUMPLE_SANITIZE
constexpr size_t flat = size_t{1} << 30;  // the sanitizer keeps freed memory
#else
constexpr size_t flat = size_t{64} << 20;  // bytes by which a server may grow under any attack
#endif

// Memory of a process, in bytes: "VmRSS" is its present memory, "VmHWM" its largest since forget_most().
size_t memory(const char* what, const std::string& process = "self") {
  std::ifstream file("/proc/" + process + "/status");
  for (std::string word; file >> word;) {
    size_t kilobytes = 0;
    if (word == std::string(what) + ":" && file >> kilobytes) return kilobytes << 10;
  }
  ADD_FAILURE() << "no " << what << " of process " << process;
  return 0;
}
void forget_most() { std::ofstream("/proc/self/clear_refs") << "5"; }

// One end of a connection that breaks all rules.
class Line {
 public:
  explicit Line(const std::string& address, const char* from = "127.0.0.1", int receive_buffer = 0) {
    sockaddr_in to{}, here{};
    to.sin_family = here.sin_family = AF_INET;
    const size_t colon = address.find(':');
    to.sin_port = htons(static_cast<uint16_t>(std::stoi(address.substr(colon + 1))));
    EXPECT_EQ(inet_pton(AF_INET, address.substr(0, colon).c_str(), &to.sin_addr), 1) << address;
    EXPECT_EQ(inet_pton(AF_INET, from, &here.sin_addr), 1) << from;
    socket_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    EXPECT_GE(socket_, 0) << std::strerror(errno);
    if (receive_buffer) setsockopt(socket_, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
    EXPECT_EQ(bind(socket_, reinterpret_cast<const sockaddr*>(&here), sizeof here), 0) << std::strerror(errno);
    fcntl(socket_, F_SETFL, O_NONBLOCK);
    if (connect(socket_, reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0) waits_for(POLLOUT, Clock::now() + promptly);
  }
  ~Line() {
    if (socket_ >= 0) close(socket_);
  }
  Line(Line&& other) noexcept : socket_(std::exchange(other.socket_, -1)) {}
  Line& operator=(Line&& other) noexcept {
    std::swap(socket_, other.socket_);
    return *this;
  }

  // Returns how much the other end took: less than all if it is gone, or took nothing for the time `each`.
  size_t send(std::string_view bytes, std::chrono::milliseconds each = promptly) {
    size_t sent = 0;
    while (sent < bytes.size()) {
      const ssize_t size = ::send(socket_, bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
      if (size > 0)
        sent += static_cast<size_t>(size);
      else if (size < 0 && errno != EAGAIN)
        break;
      else if (!waits_for(POLLOUT, Clock::now() + each))
        break;
    }
    return sent;
  }
  void ends_sending() const { shutdown(socket_, SHUT_WR); }

  // Reads until `wanted` has come, the connection ends, or the deadline passes.
  std::string read(const std::string& wanted = std::string(1, '\0'), seconds within = promptly) {
    const auto deadline = Clock::now() + within;
    std::string text;
    char chunk[65536];
    while (text.find(wanted, text.size() < (1 << 20) ? 0 : text.size() - (1 << 20)) == text.npos) {
      const ssize_t size = recv(socket_, chunk, sizeof chunk, 0);
      if (size > 0)
        text.append(chunk, static_cast<size_t>(size));
      else if (size == 0 || errno != EAGAIN || !waits_for(POLLIN, deadline))
        break;
    }
    return text;
  }
  // Returns true once the other end is gone. Drops data that still arrives.
  bool ended(Clock::time_point deadline) {
    char chunk[65536];
    for (;;) {
      const ssize_t size = recv(socket_, chunk, sizeof chunk, 0);
      if (size == 0 || (size < 0 && errno != EAGAIN)) return true;
      if (size < 0 && !waits_for(POLLIN, deadline)) return false;
    }
  }
  // The same without reading: asks the kernel.
  bool was_reset(Clock::time_point deadline) {
    while (Clock::now() < deadline) {
      pollfd waiting{socket_, POLLRDHUP, 0};
      ::poll(&waiting, 1, 100);
      if (waiting.revents & (POLLHUP | POLLERR | POLLRDHUP)) return true;
    }
    return false;
  }

 private:
  bool waits_for(short what, Clock::time_point deadline) const {
    const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(deadline - Clock::now());
    pollfd waiting{socket_, what, 0};
    return ::poll(&waiting, 1, std::max(0, static_cast<int>(left.count()))) > 0;
  }
  int socket_ = -1;
};

std::string head(const std::string& path, const std::string& more = "") {
  return "GET " + path + " HTTP/1.1\r\nHost: 127.0.0.1\r\n" + more + "\r\n";
}

// Returns the whole answer, or the part of it that came until the deadline.
std::string get(const std::string& address, const std::string& path, const char* from = "127.0.0.1") {
  Line line(address, from);
  line.send(head(path, "Connection: close\r\n"));
  return line.read();
}

const std::string upgrade = head("/live",
                                 "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
                                 "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n");

// A WebSocket at /live; `answer` is the head of the server's answer.
Line open_live(const std::string& address, std::string& answer, const char* from = "127.0.0.1") {
  Line line(address, from);
  line.send(upgrade);
  answer = line.read("\r\n\r\n");
  return line;
}

// A frame with a payload, whose length may differ from the announced one. Browsers mask frames; this one masks with zeros.
std::string frame(int first, uint64_t announced, const std::string& payload, bool masked = true) {
  const int mask = masked ? 0x80 : 0;
  std::string bytes(1, static_cast<char>(first));
  const auto put = [&](int digits) {
    for (int i = digits - 1; i >= 0; --i) bytes += static_cast<char>(announced >> (8 * i));
  };
  if (announced < 126) {
    bytes += static_cast<char>(mask | static_cast<int>(announced));
  } else {
    bytes += static_cast<char>(mask | (announced < 65'536 ? 126 : 127));
    put(announced < 65'536 ? 2 : 8);
  }
  return bytes + (masked ? std::string(4, '\0') : "") + payload;
}

double shown(const std::string& page, const std::string& metric) {
  const size_t at = page.find("\n" + metric + " ");
  return at == page.npos ? -1 : std::stod(page.substr(at + metric.size() + 2));
}

// Both servers, in this process.
class Http : public testing::Test {
 protected:
  void SetUp() override {
    getrlimit(RLIMIT_NOFILE, &descriptors_);
    const rlimit more{std::min<rlim_t>(descriptors_.rlim_max, 8'192), descriptors_.rlim_max};
    setrlimit(RLIMIT_NOFILE, &more);
    ASSERT_EQ(metrics_open("127.0.0.1:0", &metrics_), 0) << transport_error();
    ASSERT_EQ(metrics_set(metrics_, "# one page\ncrumple_cars 1\n"), 0);
    ASSERT_EQ(web_open("127.0.0.1:0", &web_), 0) << transport_error();
    ASSERT_EQ(web_page(web_, "/", "text/html", "<p>a page", 9), 0);
    ASSERT_EQ(web_set(web_, "key", "bytes", 5), 0);
    metrics = metrics_address(metrics_), web = web_address(web_);
    answers();  // from here on it has its threads and buffers
    forget_most();
    before_ = memory("VmRSS");
  }
  void TearDown() override {
    metrics_close(metrics_);
    web_close(web_);
    setrlimit(RLIMIT_NOFILE, &descriptors_);
  }

  size_t grown() const {
    const size_t most = memory("VmHWM");
    return most > before_ ? most - before_ : 0;
  }
  // The law of every test: another reader gets a prompt answer, and memory is flat.
  void answers(const char* from = "127.0.0.1") const {
    for (const auto& [address, path] : {std::pair{metrics, "/metrics"}, {web, "/"}}) {
      const auto asked = Clock::now();
      const std::string answer = get(address, path, from);
      const auto took = std::chrono::duration<double>(Clock::now() - asked);
      EXPECT_TRUE(answer.starts_with("HTTP/1.1 200 OK\r\n")) << path << " after " << took.count() << " s: \"" << answer << '"';
    }
  }
  void holds() const {
    answers();
    EXPECT_LT(grown(), flat) << (grown() >> 20) << " MiB more";
  }

  Metrics* metrics_ = nullptr;
  Web* web_ = nullptr;
  std::string metrics, web;

 private:
  rlimit descriptors_{};
  size_t before_ = 0;
};

// ---- heads ------------------------------------------------------------------------------------------------------------------

TEST_F(Http, ALineOfAHeadThatDoesNotEndIsRefusedBeforeItFillsTheMemory) {
  for (const std::string& address : {metrics, web}) {
    Line line(address);
    line.send("GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: ");
    const std::string piece(1 << 20, 'x');
    size_t sent = 0;
    for (; sent < 256 * piece.size(); sent += piece.size())
      if (line.send(piece) < piece.size()) break;
    EXPECT_LT(sent, size_t{32} << 20) << address << " takes a line without end";
  }
  holds();
}

TEST_F(Http, AThousandHalfRequestsCostLittleAndLockNobodyOut) {
  for (const std::string& address : {metrics, web}) {
    std::vector<Line> lines;
    const std::string half = "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + std::string(200'000, 'x');
    for (int i = 0; i < 1'024; ++i) lines.emplace_back(address).send(half, std::chrono::milliseconds(20));
    answers();
    lines.clear();
    for (int i = 0; i < 1'024; ++i) lines.emplace_back(address).send("GET / HT");
    holds();
  }
}

TEST_F(Http, AHalfRequestAndAnIdleConnectionAreLetGoAndADownloadIsNot) {
  const std::string large(24 << 20, 'l');
  ASSERT_EQ(web_page(web_, "/large", "application/octet-stream", large.data(), large.size()), 0);
  Line download(web, "127.0.0.1", 65'536), half(web), idle(web), unread(metrics);
  download.send(head("/large", "Connection: close\r\n"));
  half.send("GET / HT");
  idle.send(head("/"));
  EXPECT_TRUE(idle.read("a page").starts_with("HTTP/1.1 200 OK"));
  unread.send("GET /met");
  const auto begun = Clock::now();
  EXPECT_TRUE(half.ended(begun + seconds(20)));
  EXPECT_TRUE(idle.ended(begun + seconds(20)));
  EXPECT_TRUE(unread.ended(begun + seconds(20)));
  EXPECT_GT(Clock::now() - begun, seconds(5)) << "a slow line is given no time";
  const std::string all = download.read(std::string(1, '\0'), patience);
  EXPECT_EQ(all.size() - all.find("\r\n\r\n") - 4, large.size()) << "the download was cut with the idle ones";
}

TEST_F(Http, OneAddressLeavesPlacesForOthers) {
  std::vector<Line> lines;
  std::set<std::string> got;
  for (int i = 0; i < 300; ++i) {
    std::string answer;
    lines.push_back(open_live(web, answer, "127.0.0.2"));
    got.insert(answer.substr(0, 12));
  }
  EXPECT_TRUE(got.contains("HTTP/1.1 101"));
  EXPECT_TRUE(got.contains("HTTP/1.1 503")) << "no bound on the browsers of one address";
  std::string answer;
  const Line other = open_live(web, answer);
  EXPECT_TRUE(answer.starts_with("HTTP/1.1 101")) << answer;
  holds();
}

TEST_F(Http, ACrowdOfOneAddressCostsAnotherNoConnection) {
  for (const auto& [address, path] : {std::pair{metrics, "/metrics"}, {web, "/"}}) {
    Line idle(address);
    idle.send(head(path));
    EXPECT_TRUE(idle.read("\r\n\r\n").starts_with("HTTP/1.1 200"));
    std::vector<Line> lines;
    for (int i = 0; i < 600; ++i) lines.emplace_back(address, "127.0.0.2").send("GET / HT");
    answers();
    answers("127.0.0.2");
    idle.send(head(path));
    const std::string again = idle.read("HTTP/1.1 200");
    EXPECT_NE(again.find("HTTP/1.1 200"), again.npos)
        << address << " let go of an idle connection for a crowd of another address";
    EXPECT_TRUE(lines.front().ended(Clock::now() + promptly)) << "the oldest of the crowd is still there";
  }
}

TEST_F(Http, WhatIsRefusedForALimitIsCounted) {
  EXPECT_EQ(shown(get(metrics, "/metrics"), "crumple_http_refused_total"), 0);
  EXPECT_EQ(web_refused(web_), 0u);
  std::vector<Line> lines;
  for (int i = 0; i < 600; ++i) lines.emplace_back(metrics), lines.emplace_back(web);
  answers();
  EXPECT_GT(shown(get(metrics, "/metrics"), "crumple_http_refused_total"), 400);
  EXPECT_GT(web_refused(web_), 200u);
}

TEST_F(Http, EveryAnswerTellsBrowsersWhatItsPageMayDo) {
  for (const auto& [address, path] :
       {std::pair{web, "/"}, {web, "/nothing"}, {web, "/live"}, {metrics, "/metrics"}, {metrics, "/"}}) {
    std::string answer = get(address, path);
    std::transform(answer.begin(), answer.end(), answer.begin(), [](char c) { return std::tolower(c); });
    for (const char* wanted : {"frame-ancestors 'none'", "default-src 'self'", "\r\nx-frame-options: deny\r\n",
                               "\r\nx-content-type-options: nosniff\r\n", "\r\nreferrer-policy: no-referrer\r\n"})
      EXPECT_NE(answer.find(wanted), answer.npos) << wanted << " of " << path << ":\n" << answer;
  }
  Line stranger(web);
  stranger.send("GET / HTTP/1.1\r\nHost: another.example\r\n\r\n");
  const std::string answer = stranger.read("\r\n\r\n");
  EXPECT_TRUE(answer.starts_with("HTTP/1.1 403")) << answer;
  EXPECT_NE(answer.find("frame-ancestors"), answer.npos) << answer;
}

// ---- readers that do not read -----------------------------------------------------------------------------------------------

TEST_F(Http, AReaderThatAsksOnAndNeverReadsHoldsUpNobodyNorTheEnd) {
  std::vector<Line> lines;
  std::string many;
  while (many.size() < 4 << 20) many += head("/metrics");
  for (const std::string& address : {metrics, web, metrics, web})
    lines.emplace_back(address).send(many, std::chrono::seconds(1));
  holds();
  const auto begun = Clock::now();
  web_close(std::exchange(web_, nullptr));
  EXPECT_LT(Clock::now() - begun, promptly);
}

TEST_F(Http, AReaderThatTakesNothingIsLetGo) {
  const std::string large(24 << 20, 'l');
  ASSERT_EQ(web_page(web_, "/large", "application/octet-stream", large.data(), large.size()), 0);
  Line download(web, "127.0.0.1", 65'536), many(metrics, "127.0.0.1", 65'536);
  download.send(head("/large"));
  std::string heads;
  while (heads.size() < 16 << 20) heads += head("/metrics");
  many.send(heads, std::chrono::seconds(1));
  // Sends only pings and never answers a batch.
  std::string answer;
  Line pings = open_live(web, answer);
  const auto begun = Clock::now();
  while (pings.send(frame(0x89, 4, "ping")) > 0 && Clock::now() < begun + seconds(45))
    if (pings.ended(Clock::now() + std::chrono::milliseconds(500))) break;
  EXPECT_LT(Clock::now(), begun + seconds(45)) << "pings pass for answers";
  EXPECT_TRUE(download.was_reset(begun + seconds(45))) << "an answer that nobody reads is kept";
  EXPECT_TRUE(many.was_reset(begun + seconds(45))) << "answers that nobody reads are kept";
}

TEST_F(Http, PingsWhosePongsNobodyReadsDoNotGather) {
  std::vector<Line> lines;
  std::string pings;
  while (pings.size() < 8 << 20) pings += frame(0x89, 125, std::string(125, 'p'));
  std::string answer;
  for (int i = 0; i < 4; ++i) {
    lines.push_back(open_live(web, answer));
    lines.back().send(frame(0x82, 0, ""));  // the answer to the first batch
    for (int k = 0; k < 8; ++k)
      if (lines.back().send(pings, std::chrono::seconds(1)) < pings.size()) break;
  }
  holds();
}

// ---- bodies and frames ------------------------------------------------------------------------------------------------------

TEST_F(Http, UnfinishedFramesAreRefusedByWhatTheyAnnounce) {
  std::vector<Line> lines;
  std::string answer;
  const std::string part(4 << 20, 'f');
  for (int i = 0; i < 50; ++i) {
    lines.push_back(open_live(web, answer));
    ASSERT_TRUE(answer.starts_with("HTTP/1.1 101")) << answer;
    lines.back().send(frame(0x82, 16 << 20, part), std::chrono::milliseconds(200));
  }
  holds();
}

TEST_F(Http, UnfinishedBodiesAreBoundedTogether) {
  ASSERT_EQ(web_take_requests(web_), 0);
  std::vector<Line> lines;
  const std::string body((1 << 20) - 1, 'b');
  const std::string post = "POST /regions HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 1048576\r\n\r\n";
  for (int i = 0; i < 250; ++i) lines.emplace_back(web).send(post + body, std::chrono::milliseconds(200));
  answers();
  EXPECT_LT(grown(), flat + flat / 2) << (grown() >> 20) << " MiB more: 64 bodies may be so long";
  EXPECT_TRUE(lines.back().read("\n", seconds(1)).starts_with("HTTP/1.1 503"));
  WebRequest request;
  EXPECT_EQ(web_next(web_, &request), 0) << "a request that did not arrive is handed on";
}

TEST_F(Http, OneAddressLeavesRequestsForOthers) {
  ASSERT_EQ(web_take_requests(web_), 0);
  std::vector<Line> lines;
  const std::string post = "POST /regions HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 4\r\n\r\n";
  for (int i = 0; i < 100; ++i) lines.emplace_back(web, "127.0.0.2").send(post);
  size_t refused = 0;
  for (const auto end = Clock::now() + promptly; refused < 68 && Clock::now() < end;)
    for (Line& line : lines) refused += line.read("\n", seconds(0)).starts_with("HTTP/1.1 503");
  EXPECT_EQ(refused, 68u) << "half of 64 may be of one address";
  Line other(web);
  other.send(post + "dabs");
  WebRequest request;
  const auto deadline = Clock::now() + promptly;
  while (web_next(web_, &request) == 0 && Clock::now() < deadline) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  ASSERT_EQ(web_answer(web_, request.ticket, 200, "text/plain", "painted", 7), 0) << transport_error();
  EXPECT_NE(other.read("painted").find("HTTP/1.1 200"), std::string::npos) << "one address has all requests";
}

TEST_F(Http, ALargeStateReachesManyBrowsersInPieces) {
  const std::string slot(64 << 10, 's');
  for (int i = 0; i < 512; ++i) web_set(web_, std::to_string(i).c_str(), slot.data(), slot.size());  // 32 MiB
  forget_most();
  const size_t before = memory("VmRSS");
  std::vector<Line> lines;
  std::string answer;
  for (int i = 0; i < 50; ++i) lines.push_back(open_live(web, answer));
  for (Line& line : lines) line.was_reset(Clock::now());  // nobody reads
  answers();
  const size_t most = memory("VmHWM");
  EXPECT_LT(most - before, flat) << ((most - before) >> 20) << " MiB more for 50 who read nothing";
  // A browser that answers gets everything once.
  Line reader = open_live(web, answer);
  size_t came = 0;
  for (std::string got = answer.substr(answer.find("\r\n\r\n") + 4);;) {
    came += got.size();
    if (came > 512 * slot.size()) break;
    reader.send(frame(0x82, 0, ""));
    got = reader.read("s", seconds(10));
    if (got.empty()) break;
  }
  EXPECT_GT(came, 512 * slot.size());
  EXPECT_LT(came, 513 * slot.size());
}

// ---- descriptors ------------------------------------------------------------------------------------------------------------

class HttpProgram : public Program {
 protected:
  // Returns the exit code if the process ends in time; else kills it and returns -9.
  int ends(Process& process) {
    const std::string stat = "/proc/" + std::to_string(process.id()) + "/stat";
    const auto deadline = Clock::now() + promptly;
    for (;;) {
      std::ifstream file(stat);
      std::string text((std::istreambuf_iterator<char>(file)), {});
      if (text.empty() || text.find(") Z ") != text.npos) break;
      pollfd none{-1, 0, 0};
      ::poll(&none, 1, 10);
      if (Clock::now() > deadline) {
        process.send(SIGKILL);
        break;
      }
    }
    return process.wait();
  }
  // Processor time in the threads of a server.
  double http_seconds(const Process& process) {
    double ticks = 0;
    for (const auto& task : std::filesystem::directory_iterator("/proc/" + std::to_string(process.id()) + "/task")) {
      std::ifstream file(task.path() / "stat");
      const std::string text((std::istreambuf_iterator<char>(file)), {});
      const size_t at = text.find("(http) ");
      if (at == text.npos) continue;
      std::istringstream fields(text.substr(at + 7));
      std::string skipped;
      for (int i = 0; i < 11; ++i) fields >> skipped;
      double user = 0, system = 0;
      fields >> user >> system;
      ticks += user + system;
    }
    return ticks / static_cast<double>(sysconf(_SC_CLK_TCK));
  }
  std::string serve_metrics() {
    start_server(path("http.mcap"), {"--metrics", "127.0.0.1:0"});
    EXPECT_TRUE(server->read_until("/metrics\n")) << server->text;
    const size_t at = server->text.find("http://") + 7;
    return server->text.substr(at, server->text.find("/metrics", at) - at);
  }
};

TEST_F(HttpProgram, ConnectionsThatTakeEveryDescriptorEndNothing) {
#ifdef CRUMPLE_SANITIZE
  GTEST_SKIP() << "the sanitizers' own checks need descriptors";
#endif
  const std::string metrics = serve_metrics();
  EXPECT_TRUE(get(metrics, "/metrics").starts_with("HTTP/1.1 200 OK"));
  const std::string process = "/proc/" + std::to_string(server->id());
  const auto files = std::filesystem::directory_iterator(process + "/fd");
  const auto open = static_cast<rlim_t>(std::distance(begin(files), end(files)));
  rlimit limit{};
  ASSERT_EQ(prlimit(server->id(), RLIMIT_NOFILE, nullptr, &limit), 0);
  limit.rlim_cur = open + 8;
  ASSERT_EQ(prlimit(server->id(), RLIMIT_NOFILE, &limit, nullptr), 0);
  std::vector<Line> lines;
  for (int i = 0; i < 100; ++i) lines.emplace_back(metrics).send("GET / HT");
  const double busy = http_seconds(*server);
  get(metrics, "/metrics");  // waits for a descriptor
  EXPECT_LT(http_seconds(*server) - busy, 0.5) << "the door spins while there is none";
  lines.clear();
  EXPECT_TRUE(get(metrics, "/metrics").starts_with("HTTP/1.1 200 OK")) << "descriptors are free again, and nobody is answered";
  server->send(SIGTERM);
  EXPECT_EQ(ends(*server), 0) << server->text;
}

TEST_F(HttpProgram, SigtermEndsAServerWhoseMetricsAreAskedForAndNeverRead) {
  const std::string metrics = serve_metrics();
  Line line(metrics);
  std::string many;
  while (many.size() < 16 << 20) many += head("/metrics");
  line.send(many, std::chrono::seconds(1));
  EXPECT_TRUE(get(metrics, "/metrics").starts_with("HTTP/1.1 200 OK"));
  server->send(SIGTERM);
  EXPECT_EQ(ends(*server), 0) << server->text;
}

TEST_F(HttpProgram, AGatewayOutlivesBrowsersThatHangUpInTheMiddle) {
  const std::string film = in_repository("recordings/built_in_pole.mcap");
  Process gateway({"view", film, film, "--page", write("page.html", "<p>a page"), "--listen", "127.0.0.1:0"});
  ASSERT_TRUE(gateway.read_until("in a browser\n")) << gateway.text;
  const size_t at = gateway.text.find("http://") + 7;
  const std::string web = gateway.text.substr(at, gateway.text.find('/', at) - at);
  std::string many;
  while (many.size() < 1 << 14) many += head("/");
  for (int i = 0; i < 1'000; ++i) {
    Line line(web);
    line.send(many);
    if (i % 2) line.read("\n");  // unread data then resets the connection
  }
  EXPECT_TRUE(get(web, "/").starts_with("HTTP/1.1 200 OK"));
  gateway.send(SIGTERM);
  EXPECT_EQ(ends(gateway), 0) << gateway.text;
}

TEST_F(HttpProgram, AGatewaySaysOnceThatItRefusesBrowsers) {
  const std::string film = in_repository("recordings/built_in_pole.mcap");
  Process gateway({"view", film, film, "--page", write("page.html", "<p>a page"), "--listen", "127.0.0.1:0"});
  ASSERT_TRUE(gateway.read_until("in a browser\n")) << gateway.text;
  const size_t at = gateway.text.find("http://") + 7;
  const std::string web = gateway.text.substr(at, gateway.text.find('/', at) - at);
  std::vector<Line> lines;
  for (int i = 0; i < 600; ++i) lines.emplace_back(web);
  EXPECT_TRUE(get(web, "/").starts_with("HTTP/1.1 200 OK"));
  EXPECT_TRUE(gateway.read_until("at a time")) << gateway.text;
  gateway.send(SIGTERM);
  EXPECT_EQ(ends(gateway), 0) << gateway.text;
}

// ---- whatever comes ---------------------------------------------------------------------------------------------------------

// The test prints its seed; CRUMPLE_HTTP_SEED sets it.
uint64_t seed_of_today() {
  const char* given = std::getenv("CRUMPLE_HTTP_SEED");
  const uint64_t seed = given ? std::strtoull(given, nullptr, 10) : std::random_device{}();
  std::printf("CRUMPLE_HTTP_SEED=%llu\n", static_cast<unsigned long long>(seed));
  return seed;
}

struct Random {
  std::mt19937_64 engine{seed_of_today()};
  size_t below(size_t n) { return engine() % n; }
  template <class T>
  const T& of(const std::vector<T>& all) {
    return all[below(all.size())];
  }
  std::string bytes(size_t size) {
    std::string text(size, '\0');
    for (char& c : text) c = static_cast<char>(below(256));
    return text;
  }
};

std::string changed_request(Random& random) {
  static const std::vector<std::string> methods = {"GET",     "POST", "HEAD", "PUT",  "OPTIONS",
                                                   "CONNECT", "get",  "",     "G\0T", "PRI"};
  static const std::vector<std::string> paths = {"/",  "/metrics", "/live", "/regions", "*", "http://127.0.0.1/",
                                                 "//", "/%00",     "/\x80", ""};
  static const std::vector<std::string> versions = {"HTTP/1.1", "HTTP/1.0", "HTTP/2.0", "HTTP/9", "", "HTTP/1.1 "};
  static const std::vector<std::string> fields = {"Content-Length: 5",
                                                  "Content-Length: 18446744073709551616",
                                                  "Content-Length: -1",
                                                  "Content-Length: 99999999",
                                                  "Content-Length: 3\r\nContent-Length: 4",
                                                  "Transfer-Encoding: chunked",
                                                  "Transfer-Encoding: chunked, chunked",
                                                  "Transfer-Encoding: gzip",
                                                  "Expect: 100-continue",
                                                  "Connection: Upgrade",
                                                  "Upgrade: websocket",
                                                  "Upgrade: h2c",
                                                  "Sec-WebSocket-Version: 13",
                                                  "Sec-WebSocket-Version: 12",
                                                  "Sec-WebSocket-Key: x",
                                                  "Connection: close",
                                                  "Host: another",
                                                  "Host: [::1",
                                                  "Origin: null",
                                                  "Origin: http://127.0.0.1",
                                                  " folded: x",
                                                  "No colon",
                                                  ": no name",
                                                  "Cookie: \x01\x02"};
  static const std::vector<std::string> bodies = {"",
                                                  "hello",
                                                  "5\r\nhello\r\n0\r\n\r\n",
                                                  "FFFFFFFFFFFFFFFFF\r\nx",
                                                  "5\r\nhel",
                                                  "-1\r\n",
                                                  "5;" + std::string(100'000, 'e') + "\r\nhello",
                                                  "zz\r\n\r\n",
                                                  "0\r\nTrailer: x\r\n",
                                                  "5\nhello\n0\n\n"};
  const bool good = random.below(3) == 0;
  std::string text =
      (good ? "POST /regions HTTP/1.1" : random.of(methods) + " " + random.of(paths) + " " + random.of(versions)) + "\r\n";
  if (random.below(8) > 0) text += "Host: 127.0.0.1\r\n";
  for (size_t i = random.below(5); i > 0; --i) text += random.of(fields) + "\r\n";
  switch (random.below(12)) {
    case 0:
      for (size_t i = random.below(5'000); i > 0; --i) text += "X" + std::to_string(i) + ": y\r\n";
      break;
    case 1:
      text += "X: " + std::string(random.below(1 << 20), 'x') + "\r\n";
      break;
    case 2:
      text += std::string(random.below(1 << 16), 'n') + ": x\r\n";
      break;
  }
  text += "\r\n" + random.of(bodies);
  switch (random.below(8)) {
    case 0:
      return text.substr(0, random.below(text.size() + 1));
    case 1:
      return random.bytes(random.below(300)) + text;
    case 2:
      for (size_t i = random.below(8); i > 0; --i) text[random.below(text.size())] = static_cast<char>(random.below(256));
      return text;
    case 3: {
      std::string many;
      for (size_t i = random.below(50); i > 0 && many.size() < 1 << 20; --i) many += text;
      return many + text;
    }
  }
  return text;
}

// Sends many random requests, leaves some connections open, and ends others in every way that a reader can.
void pester(Random& random, int times, const std::function<Line()>& open, const std::function<std::string()>& bytes,
            const std::function<void()>& check) {
  std::vector<Line> kept;
  for (int i = 0; i < times; ++i) {
    Line line = open();
    line.send(bytes(), std::chrono::milliseconds(5));
    const size_t how = random.below(4);
    if (how == 0) line.ends_sending();
    if (how <= 1) line.ended(Clock::now() + std::chrono::milliseconds(2));
    if (how == 2 && kept.size() < 500) kept.push_back(std::move(line));
    if (i % 250 == 0) check();
    if (testing::Test::HasFailure()) break;
  }
  check();
}

TEST_F(Http, NoRequestStopsADoor) {
  ASSERT_EQ(web_take_requests(web_), 0);
  Random random;
  for (const std::string& address : {metrics, web})
    pester(
        random, 3'000, [&] { return Line(address); }, [&] { return changed_request(random); }, [this] { answers(); });
  EXPECT_LT(grown(), 2 * flat) << (grown() >> 20) << " MiB more";
}

TEST_F(Http, NoFrameStopsADoor) {
  Random random;
  const auto frames = [&] {
    std::string text;
    if (random.below(4) == 0) text = frame(0x82, 1 << 24, std::string(random.below(2 << 20), 'p'));  // a large one, unfinished
    for (size_t i = random.below(6); i < 6; ++i) {
      const std::string payload = random.below(20) ? random.bytes(random.below(200)) : std::string(random.below(1 << 18), 'p');
      static const std::vector<int> firsts = {0x82, 0x81, 0x80, 0x00, 0x01, 0x02, 0x88, 0x89, 0x8a, 0x08, 0x09};
      const int first = random.below(4) ? random.of(firsts) : static_cast<int>(random.below(256));
      static const std::vector<uint64_t> lengths = {0, 125, 126, 65'535, 65'536, 1 << 24, 1ull << 32, 1ull << 63, ~0ull};
      text += frame(first, random.below(3) ? payload.size() : random.of(lengths), payload, random.below(8) > 0);
    }
    if (random.below(30) == 0)
      for (int k = 0; k < 50'000; ++k) text += frame(k ? 0x00 : 0x02, 1, "x");  // fragments without end
    return random.below(4) ? text : text.substr(0, random.below(text.size() + 1));
  };
  const auto open = [&] {
    std::string answer;
    return open_live(web, answer);
  };
  pester(random, 2'000, open, frames, [this] { answers(); });
  EXPECT_LT(grown(), flat) << (grown() >> 20) << " MiB more";
}

}  // namespace
}  // namespace crumple
